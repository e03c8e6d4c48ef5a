//! Lists in pages: a limit, an opaque cursor, and a link to the next page. What the OpenAPI document says of
//! every list is added to it here.

use axum::extract::Request;
use axum::http::{HeaderValue, Uri, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use axum::{Extension, Json};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use utoipa::IntoParams;

use super::problem::Problem;

const LIMIT_DEFAULT: u32 = 100;
const LIMIT_MAX: u32 = 1_000;

/// Which page of a list to send.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct PageQuery {
    /// The most items to send, 1 to 1,000; 100 by default.
    #[param(minimum = 1, maximum = 1000, nullable = false)]
    pub limit: Option<u32>,
    /// `next_cursor` of the previous page.
    #[param(nullable = false)]
    pub cursor: Option<String>,
}

impl PageQuery {
    /// The page that is asked for, checked.
    ///
    /// # Errors
    /// As [`Wanted::checked`].
    pub(super) fn wanted<K: std::str::FromStr>(&self) -> Result<Wanted<K>, Problem> {
        Wanted::checked(self.limit, self.cursor.as_deref())
    }
}

/// The page of a list that a request asks for: the items after a key.
#[derive(Debug)]
pub(super) struct Wanted<K> {
    /// The key of the last item of the previous page; `None` for the first page.
    pub after: Option<K>,
    limit: u32,
}

impl<K: std::str::FromStr> Wanted<K> {
    /// From the parameters `limit` and `cursor`.
    ///
    /// # Errors
    /// 400 for a limit out of range, or a cursor that no page has given.
    pub(super) fn checked(limit: Option<u32>, cursor: Option<&str>) -> Result<Self, Problem> {
        Ok(Self {
            limit: checked_limit(limit)?,
            after: cursor.map(key_of_cursor).transpose()?,
        })
    }
}

impl<K> Wanted<K> {
    /// How many items to read: one more than are sent shows whether another page follows.
    pub(super) fn to_read(&self) -> u32 {
        self.limit + 1
    }

    /// Of the items read, those to send, and the cursor of the next page.
    pub(super) fn cut<T, D: ToString>(
        &self,
        mut read: Vec<T>,
        key: impl Fn(&T) -> D,
    ) -> (Vec<T>, Option<String>) {
        if read.len() <= self.limit as usize {
            return (read, None);
        }
        read.truncate(self.limit as usize);
        let next_cursor = read.last().map(|last| cursor_after(&key(last).to_string()));
        (read, next_cursor)
    }

    /// The answer with the page, of the items read.
    pub(super) fn page<P: Page, T, D: ToString>(
        &self,
        read: Vec<T>,
        key: impl Fn(&T) -> D,
        body: impl Fn(T) -> P::Item,
    ) -> Listed<P> {
        let (items, next_cursor) = self.cut(read, key);
        let items = items.into_iter().map(body).collect();
        Listed(P::new(items, next_cursor))
    }
}

fn checked_limit(limit: Option<u32>) -> Result<u32, Problem> {
    match limit.unwrap_or(LIMIT_DEFAULT) {
        limit @ 1..=LIMIT_MAX => Ok(limit),
        _ => Err(Problem::parameter(
            "limit",
            format!("limit is 1 to {LIMIT_MAX}"),
        )),
    }
}

/// The cursor that stands after a key. Hexadecimal keeps it opaque and safe in a URL.
fn cursor_after(key: &str) -> String {
    key.bytes().map(|byte| format!("{byte:02x}")).collect()
}

/// The key that a cursor stands after.
fn key_of_cursor<K: std::str::FromStr>(cursor: &str) -> Result<K, Problem> {
    let bytes = (0..cursor.len()).step_by(2).map(|k| {
        let digits = cursor.get(k..k + 2).filter(|d| !d.starts_with('+'))?;
        u8::from_str_radix(digits, 16).ok()
    });
    let key = bytes.collect::<Option<Vec<u8>>>();
    key.and_then(|key| String::from_utf8(key).ok())
        .and_then(|key| key.parse().ok())
        .ok_or_else(|| {
            let detail = "send the next_cursor of the previous page";
            Problem::parameter("cursor", detail)
        })
}

/// A page of a list, as it is answered.
pub(super) trait Page: Serialize {
    /// What is listed.
    type Item;
    /// A page of these items.
    fn new(items: Vec<Self::Item>, next_cursor: Option<String>) -> Self;
    /// The cursor of the next page; `None` at the end of the list.
    fn next_cursor(&self) -> Option<&str>;
}

/// Declares the type of a list's pages: its schema, and that it is a [`Page`].
macro_rules! page {
    ($(#[$about:meta])* $visibility:vis struct $name:ident { $(#[$order:meta])* items: Vec<$item:ty>, }) => {
        #[derive(Debug, serde::Serialize, utoipa::ToSchema)]
        $(#[$about])*
        $visibility struct $name {
            $(#[$order])*
            items: Vec<$item>,
            /// The cursor of the next page; null at the end of the list.
            #[schema(required)]
            next_cursor: Option<String>,
        }

        impl $crate::api::paging::Page for $name {
            type Item = $item;

            fn new(items: Vec<$item>, next_cursor: Option<String>) -> Self {
                Self { items, next_cursor }
            }

            fn next_cursor(&self) -> Option<&str> {
                self.next_cursor.as_deref()
            }
        }
    };
}
pub(super) use page;

/// The answer with a page of a list: JSON, with a link to the next page in the header.
pub(super) struct Listed<P>(pub P);

impl<P: Page> IntoResponse for Listed<P> {
    fn into_response(self) -> Response {
        let next = NextCursor(self.0.next_cursor().map(ToOwned::to_owned));
        (Extension(next), Json(self.0)).into_response()
    }
}

/// The cursor of the page after the one that is answered, for [`link_next`].
#[derive(Debug, Clone)]
pub(super) struct NextCursor(pub Option<String>);

/// Adds the link to the next page of a list (RFC 8288): only a layer knows the address of the request.
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

/// The same address with another cursor; the rest of the query is kept.
fn link_to(uri: &Uri, cursor: &str) -> String {
    let query = uri.query().unwrap_or_default().split('&');
    let mut kept: Vec<&str> = query
        .filter(|pair| !pair.is_empty() && !pair.starts_with("cursor="))
        .collect();
    let cursor = format!("cursor={cursor}");
    kept.push(&cursor);
    format!("<{}?{}>; rel=\"next\"", uri.path(), kept.join("&"))
}

/// Says in the document what cursors look like, and that every list links to its next page.
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
            "description": "`<…>; rel=\"next\"`: the next page, with the query's other parameters (RFC 8288); absent at the end of the list",
            "schema": {"type": "string"},
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ids::RouteId;

    fn wanted<K: std::str::FromStr>(limit: u32) -> Wanted<K> {
        Wanted::checked(Some(limit), None).unwrap()
    }

    #[test]
    fn a_cursor_leads_back_to_its_key() {
        let cursor = cursor_after("line-4");
        let wanted = Wanted::<RouteId>::checked(None, Some(&cursor)).unwrap();
        assert_eq!(wanted.after.unwrap().as_str(), "line-4");
        for bad in ["", "zz", "6", "+1", "c3", "ü", "2f"] {
            assert!(key_of_cursor::<RouteId>(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn a_page_has_a_cursor_if_more_items_follow() {
        let items = vec![1, 2, 3];
        assert_eq!(
            wanted::<i32>(3).cut(items.clone(), |k| *k),
            (items.clone(), None)
        );
        let (cut, cursor) = wanted::<i32>(2).cut(items, |k| *k);
        assert_eq!(cut, [1, 2]);
        assert_eq!(key_of_cursor::<i32>(&cursor.unwrap()).unwrap(), 2);
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
