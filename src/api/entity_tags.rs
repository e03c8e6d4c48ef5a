//! ETags for JSON answers that have none, so that a client is not sent again what it already has; and what the
//! OpenAPI document says about them.

use axum::body::{Body, HttpBody, to_bytes};
use axum::extract::Request;
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use serde_json::{Value, json};
use sha2::{Digest, Sha256};

use super::if_match::is_known;
use super::problem::Problem;
use super::types::hex;

/// Longer answers are not hashed.
const HASHED_BYTES_MAX: u64 = 4 << 20;
/// Operations that answer with JSON without an ETag: it is sent as it is read, or must not be stored.
const UNTAGGED: [&str; 3] = ["get_graph", "get_trajectory", "get_session"];

/// Says in the document which answers get an ETag here, and that the answer may be 304.
pub(super) fn document_tags(document: &mut Value) {
    let items = document["paths"].as_object_mut().into_iter().flatten();
    let reads = items.filter_map(|(_, item)| item.get_mut("get"));
    for operation in reads.filter(|operation| is_documented_as_tagged(operation)) {
        operation["responses"]["200"]["headers"]["ETag"] = json!({
            "description": "Changes with the answer; absent if that is longer than 4 MiB",
            "schema": {"type": "string"},
        });
        operation["responses"]["304"] = json!({
            "description": "The client's copy is still valid",
        });
        let parameter = json!({
            "name": "If-None-Match",
            "in": "header",
            "description": "Answer 304 without a body if this is still the ETag",
            "required": false,
            "schema": {"type": "string"},
        });
        match operation["parameters"].as_array_mut() {
            Some(parameters) => parameters.push(parameter),
            None => operation["parameters"] = json!([parameter]),
        }
    }
}

/// Whether an operation answers with JSON and does not set an ETag itself.
fn is_documented_as_tagged(operation: &Value) -> bool {
    let id = operation["operationId"].as_str().unwrap_or_default();
    let answer = &operation["responses"]["200"];
    answer["content"].get("application/json").is_some()
        && answer["headers"].get("ETag").is_none()
        && !UNTAGGED.contains(&id)
}

/// Gives JSON without an ETag a weak one made of its bytes, and answers 304 to a client that has them. Answers with
/// `no-store` are left alone.
pub(super) async fn tag_answers(request: Request, next: Next) -> Response {
    let is_get = request.method() == Method::GET;
    let known = request.headers().clone();
    let response = next.run(request).await;
    if !is_get || !is_to_be_tagged(&response) {
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
    let revalidate = HeaderValue::from_static("no-cache");
    parts
        .headers
        .entry(header::CACHE_CONTROL)
        .or_insert(revalidate);
    if unchanged {
        parts.status = StatusCode::NOT_MODIFIED;
        parts.headers.remove(header::CONTENT_TYPE);
        parts.headers.remove(header::CONTENT_LENGTH);
        return Response::from_parts(parts, Body::empty());
    }
    Response::from_parts(parts, bytes.into())
}

fn is_to_be_tagged(response: &Response) -> bool {
    let headers = response.headers();
    let caching = headers.get(header::CACHE_CONTROL);
    let size = response.body().size_hint().exact();
    response.status() == StatusCode::OK
        && media_type(headers) == "application/json"
        && !headers.contains_key(header::ETAG)
        && caching.is_none_or(|caching| caching != "no-store")
        && size.is_some_and(|bytes| bytes <= HASHED_BYTES_MAX)
}

/// The media type of an answer, without parameters.
pub(super) fn media_type(headers: &HeaderMap) -> &str {
    let stated = headers.get(header::CONTENT_TYPE);
    let stated = stated.and_then(|value| value.to_str().ok());
    let media_type = stated.and_then(|stated| stated.split(';').next());
    media_type.unwrap_or_default().trim()
}
