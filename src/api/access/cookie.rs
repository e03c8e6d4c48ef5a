//! The cookie of a session.

use axum::http::header::{COOKIE, HOST, ORIGIN};
use axum::http::{HeaderMap, HeaderValue};

use super::hosts::is_loopback;
use crate::store::{SESSION_MAX, Secret};

const NAME: &str = "mapshift_session";

/// The id of the session in a request's cookies. Other services on the same host share its cookies, so values that are
/// not an id are ignored.
pub(in crate::api) fn session_id(headers: &HeaderMap) -> Option<Secret> {
    let lines = headers.get_all(COOKIE).iter();
    let cookies = lines.filter_map(|line| line.to_str().ok());
    let mut cookies = cookies.flat_map(|line| line.split(';'));
    cookies.find_map(|cookie| {
        let (name, value) = cookie.trim().split_once('=')?;
        (name == NAME).then(|| Secret::of_text(value)).flatten()
    })
}

/// The header that gives a browser a session.
///
/// # Errors
/// If the value is not valid in a header, which cannot happen.
pub(in crate::api) fn session_cookie(
    id: &Secret,
    headers: &HeaderMap,
) -> Result<HeaderValue, axum::http::header::InvalidHeaderValue> {
    let (value, age_s) = (id.text(), SESSION_MAX.as_secs());
    let mut header = HeaderValue::try_from(cookie(&value, age_s, headers))?;
    header.set_sensitive(true);
    Ok(header)
}

/// The header that removes the session from a browser.
///
/// # Errors
/// If the value is not valid in a header, which cannot happen.
pub(in crate::api) fn ended_cookie(
    headers: &HeaderMap,
) -> Result<HeaderValue, axum::http::header::InvalidHeaderValue> {
    HeaderValue::try_from(cookie("", 0, headers))
}

fn cookie(value: &str, age_s: i64, headers: &HeaderMap) -> String {
    let secure = if is_secure(headers) { "; Secure" } else { "" };
    format!("{NAME}={value}; Path=/; Max-Age={age_s}; HttpOnly; SameSite=Strict{secure}")
}

/// False for plain http on the same machine, where browsers would drop a secure cookie.
fn is_secure(headers: &HeaderMap) -> bool {
    let text = |name| headers.get(name).and_then(|v| v.to_str().ok());
    let is_https = text(ORIGIN).is_some_and(|origin| origin.starts_with("https://"));
    is_https || !text(HOST).is_some_and(is_loopback)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_session_is_found_among_other_cookies() {
        let id = Secret::random().unwrap();
        let mut headers = HeaderMap::new();
        let line = format!("a=b; {NAME}=other; {NAME}={}", id.text());
        headers.append(COOKIE, "c=d".parse().unwrap());
        headers.append(COOKIE, line.parse().unwrap());
        assert_eq!(session_id(&headers), Some(id));
        headers.clear();
        assert_eq!(session_id(&headers), None);
    }

    #[test]
    fn cookies_are_secure_except_for_plain_http_on_the_same_machine() {
        for (host, origin, secure) in [
            ("localhost:8080", None, false),
            ("127.0.0.1:8080", Some("http://127.0.0.1:8080"), false),
            ("127.0.0.1:8080", Some("https://maps.example.com"), true),
            ("maps.example.com", None, true),
            ("192.0.2.7:8080", None, true),
        ] {
            let mut headers = HeaderMap::new();
            headers.insert(HOST, host.parse().unwrap());
            if let Some(origin) = origin {
                headers.insert(ORIGIN, origin.parse().unwrap());
            }
            let cookie = ended_cookie(&headers).unwrap();
            let cookie = cookie.to_str().unwrap();
            assert_eq!(cookie.contains("Secure"), secure, "{host}");
            assert!(cookie.contains("HttpOnly; SameSite=Strict"));
        }
    }
}
