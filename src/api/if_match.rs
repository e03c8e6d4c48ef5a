//! What `If-Match` and `If-None-Match` say (RFC 9110, section 13.1).

use axum::http::{HeaderMap, header};

/// Whether `If-Match` allows a change of what has this ETag; `None` without the header.
pub(super) fn if_match(headers: &HeaderMap, tag: &str) -> Option<bool> {
    let wanted = headers.get(header::IF_MATCH)?;
    Some(is_among(wanted.to_str().unwrap_or_default(), tag))
}

/// Whether `If-None-Match` says that what has this ETag is known already.
pub(super) fn is_known(headers: &HeaderMap, tag: &str) -> bool {
    let known = headers.get(header::IF_NONE_MATCH);
    known.is_some_and(|known| is_among(known.to_str().unwrap_or_default(), tag))
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
}
