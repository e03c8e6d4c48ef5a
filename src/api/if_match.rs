//! Conditional requests: `If-Match` and `If-None-Match` (RFC 9110, sections 13.1.1 and 13.1.2).

use axum::http::{HeaderMap, header};

use super::problem::{Problem, ProblemKind};

/// Whether `If-Match` allows something with this ETag to be changed; `None` without the header.
pub(super) fn if_match(headers: &HeaderMap, tag: &str) -> Option<bool> {
    let wanted = headers.get(header::IF_MATCH)?;
    Some(is_among(wanted.to_str().unwrap_or_default(), tag))
}

/// The revision that an edit is bound to by `If-Match`; `None` without the header.
///
/// # Errors
/// 412 if the thing has another ETag.
pub(super) fn bound_revision(
    headers: &HeaderMap,
    tag: &str,
    revision: i64,
    what: &str,
) -> Result<Option<i64>, Problem> {
    match if_match(headers, tag) {
        None => Ok(None),
        Some(true) => Ok(Some(revision)),
        Some(false) => Err(stale(what)),
    }
}

/// The problem that something has changed since it was read.
pub(super) fn stale(what: &str) -> Problem {
    let detail = format!("the {what} does not have the ETag in If-Match: read it again");
    Problem::new(ProblemKind::PreconditionFailed, detail).at("If-Match")
}

/// Whether `If-None-Match` has this ETag, by weak comparison: the client's copy is still valid.
pub(super) fn is_known(headers: &HeaderMap, tag: &str) -> bool {
    let weak = |tag: &str| tag.trim().trim_start_matches("W/").to_owned();
    let mut values = headers.get_all(header::IF_NONE_MATCH).iter();
    values.any(|known| {
        let known = known.to_str().unwrap_or_default();
        known
            .split(',')
            .any(|other| other.trim() == "*" || weak(other) == weak(tag))
    })
}

/// Whether a list of ETags contains this one, or `*`.
pub(super) fn is_among(wanted: &str, tag: &str) -> bool {
    let mut tags = wanted.split(',').map(str::trim);
    tags.any(|t| t == "*" || t == tag)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_list_of_tags_is_searched() {
        let asked = |value: &'static str| {
            let mut headers = HeaderMap::new();
            headers.insert(header::IF_MATCH, value.parse().unwrap());
            if_match(&headers, "\"2\"")
        };
        assert_eq!(if_match(&HeaderMap::new(), "\"2\""), None);
        for good in ["\"2\"", "*", "\"1\" , \"2\""] {
            assert_eq!(asked(good), Some(true), "{good}");
        }
        for bad in ["", "2", "\"1\"", "\"22\"", "W/\"2\""] {
            assert_eq!(asked(bad), Some(false), "{bad}");
        }
    }

    #[test]
    fn a_copy_is_known_by_its_tag_weak_or_not() {
        let known = |value: &'static str, tag: &str| {
            let mut headers = HeaderMap::new();
            headers.insert(header::IF_NONE_MATCH, value.parse().unwrap());
            is_known(&headers, tag)
        };
        assert!(!is_known(&HeaderMap::new(), "\"2\""));
        for good in ["\"2\"", "*", "\"1\" , W/\"2\""] {
            assert!(known(good, "\"2\"") && known(good, "W/\"2\""), "{good}");
        }
        for bad in ["", "2", "\"1\"", "\"22\""] {
            assert!(!known(bad, "\"2\""), "{bad}");
        }
    }
}
