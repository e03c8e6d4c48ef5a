//! What `If-Match` and `If-None-Match` say (RFC 9110, sections 13.1.1 and 13.1.2).

use axum::http::{HeaderMap, header};

/// Whether `If-Match` allows a change of what has this ETag; `None` without the header.
pub(super) fn if_match(headers: &HeaderMap, tag: &str) -> Option<bool> {
    let wanted = headers.get(header::IF_MATCH)?;
    Some(is_among(wanted.to_str().unwrap_or_default(), tag))
}

/// Whether `If-None-Match` says that the client has what has this ETag; by weak comparison.
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

/// Whether a list of ETags has this one, or is `*`.
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
