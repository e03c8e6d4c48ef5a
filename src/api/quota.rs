//! The answer to a client whose address has reached its share: the fields of
//! draft-ietf-httpapi-ratelimit-headers-10.

use axum::http::{HeaderName, HeaderValue};

use super::problem::{Problem, ProblemKind};

/// Seconds after which to try again: most requests under way have ended by then.
const RETRY_AFTER_S: u32 = 2;
const RATE_LIMIT: HeaderName = HeaderName::from_static("ratelimit");
const RATE_LIMIT_POLICY: HeaderName = HeaderName::from_static("ratelimit-policy");

/// How much of something one client address may have under way.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Quota {
    name: &'static str,
    amount: usize,
    unit: &'static str,
}

impl Quota {
    /// Requests or connections at once.
    pub const fn requests(name: &'static str, amount: usize) -> Self {
        let unit = "concurrent-requests";
        Self { name, amount, unit }
    }

    /// Bytes at once.
    pub const fn bytes(name: &'static str, amount: usize) -> Self {
        let unit = "content-bytes";
        Self { name, amount, unit }
    }

    /// The amount.
    pub fn amount(&self) -> usize {
        self.amount
    }

    /// The problem of a client that asks for more.
    pub fn exceeded(&self) -> Problem {
        let Self { name, amount, unit } = self;
        let detail =
            format!("this address already has the {amount} {name} under way that it may have");
        let policy = format!("\"{name}\";q={amount};qu=\"{unit}\"");
        let state = format!("\"{name}\";r=0;t={RETRY_AFTER_S}");
        let mut problem = Problem::new(ProblemKind::TooManyRequests, detail);
        for (field, text) in [(RATE_LIMIT_POLICY, policy), (RATE_LIMIT, state)] {
            // Names are plain words, so this is always a valid value.
            if let Ok(value) = HeaderValue::try_from(text) {
                problem = problem.with_value(field, value);
            }
        }
        problem.retry_after(RETRY_AFTER_S)
    }
}

#[cfg(test)]
mod tests {
    use axum::response::IntoResponse;

    use super::*;

    #[test]
    fn the_fields_are_those_of_the_draft() {
        let response = Quota::requests("uploads", 32).exceeded().into_response();
        let field = |name: &str| response.headers()[name].to_str().unwrap().to_owned();
        assert_eq!(
            field("ratelimit-policy"),
            "\"uploads\";q=32;qu=\"concurrent-requests\""
        );
        assert_eq!(field("ratelimit"), "\"uploads\";r=0;t=2");
        assert_eq!(field("retry-after"), "2");
        assert_eq!(response.status(), 429);
    }
}
