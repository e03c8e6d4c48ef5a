//! Which requests are repeated, and when.

use std::time::Duration;

use reqwest::StatusCode;
use reqwest::header::{HeaderMap, RETRY_AFTER};
use sha2::{Digest, Sha256};

/// First wait before a repeat; each further one is twice as long …
const WAIT_FIRST: Duration = Duration::from_secs(1);
/// … up to this.
const WAIT_MAX: Duration = Duration::from_secs(300);

/// Whether the same request may succeed later.
pub(super) fn is_temporary(status: StatusCode) -> bool {
    status.is_server_error()
        || status == StatusCode::REQUEST_TIMEOUT
        || status == StatusCode::TOO_MANY_REQUESTS
}

/// Seconds, as the service states them; the other form, a date, is not used by it.
pub(super) fn retry_after(headers: &HeaderMap) -> Option<Duration> {
    let text = headers.get(RETRY_AFTER)?.to_str().ok()?;
    let seconds: u32 = text.trim().parse().ok()?;
    Some(Duration::from_secs(seconds.into()))
}

/// The stated wait and up to a quarter more, or at least half of 1 s × 2ⁿ up to 5 min. The jitter is derived
/// from the key, so that clients with different keys spread out.
pub(super) fn wait_before_repeat(attempt: u32, stated: Option<Duration>, key: &str) -> Duration {
    let digest = Sha256::digest(format!("{attempt} {key}"));
    let jitter = f64::from(digest[0]) / 255.0;
    match stated {
        Some(stated) => stated.mul_f64(1.0 + 0.25 * jitter),
        None => {
            let doubled = WAIT_FIRST.saturating_mul(2_u32.saturating_pow(attempt));
            doubled.min(WAIT_MAX).mul_f64(0.5 + 0.5 * jitter)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn waits_double_and_obey_what_is_stated() {
        for attempt in 0..40 {
            let doubled = 2_f64.powi(attempt as i32).min(300.0);
            let wait = wait_before_repeat(attempt, None, "a").as_secs_f64();
            assert!(
                (0.5 * doubled..=doubled).contains(&wait),
                "{attempt}: {wait}"
            );
            let stated = Some(Duration::from_secs(8));
            let wait = wait_before_repeat(attempt, stated, "a").as_secs_f64();
            assert!((8.0..=10.0).contains(&wait), "{wait}");
        }
        let spread = |key| wait_before_repeat(3, None, key);
        assert_eq!(spread("a"), spread("a"));
        assert_ne!(spread("a"), spread("b"));
    }
}
