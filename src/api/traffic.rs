//! What keeps answers short on the wire: an ETag of what has none, so that a client is not sent again
//! what it has, and gzip for text. And what the OpenAPI document says of it.

use std::io::Write;

use axum::body::{Body, BodyDataStream, Bytes, HttpBody, to_bytes};
use axum::extract::Request;
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use flate2::Compression;
use flate2::write::GzEncoder;
use futures::{StreamExt, stream};
use serde_json::{Value, json};
use sha2::{Digest, Sha256};

use super::if_match::is_known;
use super::problem::Problem;
use super::versions::hex;

/// Longer answers are not hashed.
const HASHED_BYTES_MAX: u64 = 4 << 20;
/// Shorter answers are sent as they are.
const COMPRESSED_BYTES_MIN: u64 = 1_024;
/// What is compressed: text but for event streams, which must not wait.
const COMPRESSED: [&str; 7] = [
    "application/json",
    "application/geo+json",
    "application/yaml",
    "image/svg+xml",
    "text/html",
    "text/css",
    "text/javascript",
];

/// Operations that answer with JSON that has no ETag all the same: it is sent as it is read, or not to be
/// kept.
const UNNAMED: [&str; 3] = ["get_graph", "get_trajectory", "get_session"];

/// Says in the document which answers have an ETag from here, and that they need not be sent again.
pub(super) fn document_names(document: &mut Value) {
    let items = document["paths"].as_object_mut().into_iter().flatten();
    let reads = items.filter_map(|(_, item)| item.get_mut("get"));
    for operation in reads.filter(|operation| is_documented_as_named(operation)) {
        operation["responses"]["200"]["headers"]["ETag"] = json!({
            "description": "Changes with the answer; absent if that is longer than 4 MiB",
            "schema": {"type": "string"},
        });
        operation["responses"]["304"] = json!({
            "description": "The answer is what the client has",
        });
        let parameter = json!({
            "name": "If-None-Match",
            "in": "header",
            "description": "Send nothing if the answer still has this ETag",
            "required": false,
            "schema": {"type": "string"},
        });
        match operation["parameters"].as_array_mut() {
            Some(parameters) => parameters.push(parameter),
            None => operation["parameters"] = json!([parameter]),
        }
    }
}

/// Whether an operation answers with JSON and says nothing of ETags itself.
fn is_documented_as_named(operation: &Value) -> bool {
    let id = operation["operationId"].as_str().unwrap_or_default();
    let answer = &operation["responses"]["200"];
    answer["content"].get("application/json").is_some()
        && answer["headers"].get("ETag").is_none()
        && !UNNAMED.contains(&id)
}

/// Gives JSON that has no ETag a weak one of its bytes, and answers 304 to a client that has them. What says
/// `no-store` is left alone.
pub(super) async fn name_answers(request: Request, next: Next) -> Response {
    let is_get = request.method() == Method::GET;
    let known = request.headers().clone();
    let response = next.run(request).await;
    if !is_get || !is_to_be_named(&response) {
        return response;
    }
    let (mut parts, body) = response.into_parts();
    let bytes = match to_bytes(body, HASHED_BYTES_MAX as usize).await {
        Ok(bytes) => bytes,
        Err(error) => return Problem::internal(error).into_response(),
    };
    let hash = hex(&Sha256::digest(&bytes)[..16]);
    let tag = format!("W/\"{hash}\"");
    let unchanged = is_known(&known, &tag);
    if let Ok(tag) = HeaderValue::from_str(&tag) {
        parts.headers.insert(header::ETAG, tag);
    }
    let ask_again = HeaderValue::from_static("no-cache");
    parts
        .headers
        .entry(header::CACHE_CONTROL)
        .or_insert(ask_again);
    if unchanged {
        parts.status = StatusCode::NOT_MODIFIED;
        parts.headers.remove(header::CONTENT_TYPE);
        parts.headers.remove(header::CONTENT_LENGTH);
        return Response::from_parts(parts, Body::empty());
    }
    Response::from_parts(parts, bytes.into())
}

fn is_to_be_named(response: &Response) -> bool {
    let headers = response.headers();
    let caching = headers.get(header::CACHE_CONTROL);
    let size = response.body().size_hint().exact();
    response.status() == StatusCode::OK
        && media_type(headers) == "application/json"
        && !headers.contains_key(header::ETAG)
        && caching.is_none_or(|caching| caching != "no-store")
        && size.is_some_and(|bytes| bytes <= HASHED_BYTES_MAX)
}

/// Compresses text for clients that take gzip. What has a strong ETag that people edit by keeps its bytes.
pub(super) async fn compress(request: Request, next: Next) -> Response {
    let is_get = request.method() == Method::GET;
    let takes_gzip = takes_gzip(request.headers());
    let mut response = next.run(request).await;
    if !is_get || !is_to_be_compressed(&response) {
        return response;
    }
    let varies = HeaderValue::from_static("accept-encoding");
    response.headers_mut().append(header::VARY, varies);
    if !takes_gzip {
        return response;
    }
    let (mut parts, body) = response.into_parts();
    parts.headers.remove(header::CONTENT_LENGTH);
    let gzip = HeaderValue::from_static("gzip");
    parts.headers.insert(header::CONTENT_ENCODING, gzip);
    Response::from_parts(parts, gzipped(body))
}

fn is_to_be_compressed(response: &Response) -> bool {
    let headers = response.headers();
    let strong = headers.get(header::ETAG);
    let strong = strong.is_some_and(|tag| !tag.as_bytes().starts_with(b"W/"));
    let least = response.body().size_hint().exact();
    response.status() == StatusCode::OK
        && COMPRESSED.contains(&media_type(headers))
        && !strong
        && !headers.contains_key(header::CONTENT_ENCODING)
        && least.is_none_or(|bytes| bytes >= COMPRESSED_BYTES_MIN)
}

fn media_type(headers: &HeaderMap) -> &str {
    let stated = headers.get(header::CONTENT_TYPE);
    let stated = stated.and_then(|value| value.to_str().ok());
    let media_type = stated.and_then(|stated| stated.split(';').next());
    media_type.unwrap_or_default().trim()
}

/// Whether `Accept-Encoding` names gzip without a weight of 0 (RFC 9110, section 12.5.3).
fn takes_gzip(headers: &HeaderMap) -> bool {
    let mut values = headers.get_all(header::ACCEPT_ENCODING).iter();
    values.any(|value| {
        let mut codings = value.to_str().unwrap_or_default().split(',');
        codings.any(|coding| {
            let mut parts = coding.split(';').map(str::trim);
            let is_gzip = parts
                .next()
                .is_some_and(|name| name.eq_ignore_ascii_case("gzip"));
            let weight = parts.find_map(|part| part.strip_prefix("q="));
            is_gzip && weight.is_none_or(|q| q.parse().is_ok_and(|q: f64| q > 0.0))
        })
    })
}

/// What of a body is not compressed yet, and the encoder that has the rest.
type Rest = (BodyDataStream, GzEncoder<Vec<u8>>);

fn gzipped(body: Body) -> Body {
    let encoder = GzEncoder::new(Vec::new(), Compression::fast());
    let whole = Some((body.into_data_stream(), encoder));
    Body::from_stream(stream::try_unfold(whole, next_piece))
}

/// The next piece of a compressed body as soon as there is one, and what is left.
async fn next_piece(rest: Option<Rest>) -> Result<Option<(Bytes, Option<Rest>)>, axum::Error> {
    let Some((mut pieces, mut encoder)) = rest else {
        return Ok(None);
    };
    while let Some(piece) = pieces.next().await {
        encoder.write_all(&piece?).map_err(axum::Error::new)?;
        let compressed = std::mem::take(encoder.get_mut());
        if !compressed.is_empty() {
            return Ok(Some((compressed.into(), Some((pieces, encoder)))));
        }
    }
    let last = encoder.finish().map_err(axum::Error::new)?;
    Ok(Some((last.into(), None)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gzip_is_taken_where_it_is_named() {
        let takes = |value: &'static str| {
            let mut headers = HeaderMap::new();
            headers.insert(header::ACCEPT_ENCODING, value.parse().unwrap());
            takes_gzip(&headers)
        };
        assert!(!takes_gzip(&HeaderMap::new()));
        for good in ["gzip", "br, GZIP;q=0.5", "deflate,gzip ; q=1"] {
            assert!(takes(good), "{good}");
        }
        for bad in ["", "br", "gzip;q=0", "gzip;q=0.0, br"] {
            assert!(!takes(bad), "{bad}");
        }
    }
}
