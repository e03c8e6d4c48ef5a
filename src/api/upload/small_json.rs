//! The small JSON objects that most requests have as their body.

use axum::body::Body;
use axum::extract::{FromRequest, Request};
use axum::http::{HeaderMap, header};
use serde::de::DeserializeOwned;

use super::{head, read};
use crate::api::ApiState;
use crate::api::problem::Problem;
use crate::ingest::json::{Object, from_json};

/// The body of a request as a small JSON object; a request without a body counts as `{}`.
pub(in crate::api) struct SmallJson<T>(pub T);

impl<T: DeserializeOwned> FromRequest<ApiState> for SmallJson<T> {
    type Rejection = Problem;

    async fn from_request(request: Request, state: &ApiState) -> Result<Self, Problem> {
        let (parts, body) = request.into_parts();
        small_json(state, &parts.headers, body).await.map(Self)
    }
}

/// Reads a small JSON object; no body counts as `{}`.
///
/// # Errors
/// 400, 408, 413, 415.
pub(in crate::api) async fn small_json<T: DeserializeOwned>(
    state: &ApiState,
    headers: &HeaderMap,
    body: Body,
) -> Result<T, Problem> {
    let limits = &state.limits;
    let has_type = headers.contains_key(header::CONTENT_TYPE);
    if has_type {
        head::check_media_type(headers)?;
    }
    head::check_plain(headers)?;
    let bytes = read::read_body(body, limits.small_body_bytes, limits.body_pace).await?;
    if bytes.is_empty() {
        return Ok(from_json::<Object<T>>(b"{}")?.0);
    }
    if !has_type {
        head::check_media_type(headers)?;
    }
    Ok(from_json::<Object<T>>(&bytes)?.0)
}
