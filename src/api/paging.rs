//! Lists in parts: a limit, an opaque cursor, and a link to the next part. What of it is the same for every
//! list is added to the OpenAPI document here.

use axum::extract::Request;
use axum::http::{HeaderValue, Uri, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use axum::{Extension, Json};
use serde::Serialize;
use serde_json::{Value, json};

use super::problem::Problem;

const LIMIT_DEFAULT: u32 = 100;
const LIMIT_MAX: u32 = 1_000;

/// The `limit` parameter, checked.
pub(super) fn checked_limit(limit: Option<u32>) -> Result<u32, Problem> {
    match limit.unwrap_or(LIMIT_DEFAULT) {
        limit @ 1..=LIMIT_MAX => Ok(limit),
        _ => Err(Problem::parameter(
            "limit",
            format!("limit is 1 to {LIMIT_MAX}"),
        )),
    }
}

/// The cursor that stands after a key. Hexadecimal keeps it opaque and safe in a URL.
pub(super) fn cursor_after(key: &str) -> String {
    key.bytes().map(|byte| format!("{byte:02x}")).collect()
}

/// The key that a cursor stands after.
pub(super) fn key_of_cursor<K: std::str::FromStr>(
    cursor: Option<&str>,
) -> Result<Option<K>, Problem> {
    let Some(cursor) = cursor else {
        return Ok(None);
    };
    let bytes = (0..cursor.len()).step_by(2).map(|k| {
        let digits = cursor.get(k..k + 2).filter(|d| !d.starts_with('+'))?;
        u8::from_str_radix(digits, 16).ok()
    });
    let key = bytes.collect::<Option<Vec<u8>>>();
    key.and_then(|key| String::from_utf8(key).ok())
        .and_then(|key| key.parse().ok())
        .map(Some)
        .ok_or_else(|| Problem::parameter("cursor", "send the next_cursor of the page before"))
}

/// Cuts a list that was read with one item too many, and says where the next part begins.
pub(super) fn cut_page<T>(
    items: &mut Vec<T>,
    limit: u32,
    key: impl Fn(&T) -> String,
) -> Option<String> {
    if items.len() <= limit as usize {
        return None;
    }
    items.truncate(limit as usize);
    items.last().map(|last| cursor_after(&key(last)))
}

/// A part of a list, as it is answered.
pub(super) trait Part: Serialize {
    /// Where the next part begins.
    fn next_cursor(&self) -> Option<&str>;
}

/// The answer with a part of a list: JSON, with a link to the next part in the header.
pub(super) struct Listed<T>(pub T);

impl<T: Part> IntoResponse for Listed<T> {
    fn into_response(self) -> Response {
        let next = NextCursor(self.0.next_cursor().map(ToOwned::to_owned));
        (Extension(next), Json(self.0)).into_response()
    }
}

/// Where the next part of an answered list begins: for [`link_next`].
#[derive(Debug, Clone)]
pub(super) struct NextCursor(pub Option<String>);

/// Adds the link to the next part of a list (RFC 8288), which only the layer can write that knows the
/// request's address.
pub(super) async fn link_next(request: Request, next: Next) -> Response {
    let uri = request.uri().clone();
    let mut response = next.run(request).await;
    if let Some(NextCursor(Some(cursor))) = response.extensions_mut().remove()
        && let Ok(link) = HeaderValue::from_str(&link_to(&uri, &cursor))
    {
        response.headers_mut().insert(header::LINK, link);
    }
    response
}

/// The same address with another cursor; everything else of the query stays.
fn link_to(uri: &Uri, cursor: &str) -> String {
    let query = uri.query().unwrap_or_default().split('&');
    let mut kept: Vec<&str> = query
        .filter(|pair| !pair.is_empty() && !pair.starts_with("cursor="))
        .collect();
    let cursor = format!("cursor={cursor}");
    kept.push(&cursor);
    format!("<{}?{}>; rel=\"next\"", uri.path(), kept.join("&"))
}

/// Says in the document what cursors look like, and that every list links to its next part.
pub(super) fn document_links(document: &mut Value) {
    let items = document["paths"].as_object_mut().into_iter().flatten();
    for operation in items.filter_map(|(_, item)| item.get_mut("get")) {
        let parameters = operation.get_mut("parameters");
        let mut parameters = parameters
            .and_then(Value::as_array_mut)
            .into_iter()
            .flatten();
        let Some(cursor) = parameters.find(|parameter| parameter["name"] == "cursor") else {
            continue;
        };
        cursor["schema"]["pattern"] = json!("^([0-9a-f]{2})+$");
        operation["responses"]["200"]["headers"]["Link"] = json!({
            "description": "`<…>; rel=\"next\"`: the next part, with the query's other parameters (RFC 8288); absent at the end",
            "schema": {"type": "string"},
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ids::RouteId;

    #[test]
    fn a_cursor_comes_back_as_its_key() {
        let cursor = cursor_after("line-4");
        let key: Option<RouteId> = key_of_cursor(Some(&cursor)).unwrap();
        assert_eq!(key.unwrap().as_str(), "line-4");
        for bad in ["", "zz", "6", "+1", "c3", "ü", "2f"] {
            assert!(key_of_cursor::<RouteId>(Some(bad)).is_err(), "{bad}");
        }
    }

    #[test]
    fn pages_are_cut_where_more_follows() {
        let mut items = vec![1, 2, 3];
        assert_eq!(cut_page(&mut items, 3, i32::to_string), None);
        let cursor = cut_page(&mut items, 2, i32::to_string).unwrap();
        assert_eq!(items, [1, 2]);
        assert_eq!(key_of_cursor::<i32>(Some(&cursor)).unwrap(), Some(2));
    }

    #[test]
    fn a_link_keeps_the_rest_of_the_query() {
        for (uri, link) in [
            ("/v1/routes", "</v1/routes?cursor=61>; rel=\"next\""),
            (
                "/v1/a?cursor=62&status=open&since=2026-11-20T06%3A00%3A00Z&limit=2",
                "</v1/a?status=open&since=2026-11-20T06%3A00%3A00Z&limit=2&cursor=61>; rel=\"next\"",
            ),
        ] {
            assert_eq!(link_to(&uri.parse().unwrap(), "61"), link);
        }
    }

    #[test]
    fn limits_are_bounded() {
        assert_eq!(checked_limit(None).unwrap(), LIMIT_DEFAULT);
        assert!(checked_limit(Some(0)).is_err());
        assert!(checked_limit(Some(1_001)).is_err());
    }
}
