//! What belongs to a route that is not there is answered with 404, before query, headers and body are
//! checked: the order is the same everywhere.

use std::str::FromStr;

use axum::body::HttpBody;
use axum::extract::{MatchedPath, Request, State};
use axum::http::Method;
use axum::http::request::Parts;
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use super::ApiState;
use super::batches::count_upload;
use super::extract::raw_path;
use super::problem::Problem;
use crate::ids::RouteId;

/// Where a PUT makes the route.
const ROUTE: &str = "/v1/routes/{route}";
/// How the paths end where a PUT uploads.
const BATCH: &str = "/{batch}";

/// Refuses requests below a route that does not exist. The connection is closed where a body was not read.
pub(super) async fn require(
    State(state): State<ApiState>,
    request: Request,
    next: Next,
) -> Response {
    let (mut parts, body) = request.into_parts();
    let Err(problem) = check(&state, &mut parts).await else {
        return next.run(Request::from_parts(parts, body)).await;
    };
    let matched = parts.extensions.get::<MatchedPath>();
    if parts.method == Method::PUT && matched.is_some_and(|path| path.as_str().ends_with(BATCH)) {
        count_upload(Err(&problem));
    }
    match body.is_end_stream() {
        true => problem.into_response(),
        false => problem.closing().into_response(),
    }
}

/// A name that is none is the handler's to refuse.
async fn check(state: &ApiState, parts: &mut Parts) -> Result<(), Problem> {
    let matched = parts.extensions.get::<MatchedPath>();
    if parts.method == Method::PUT && matched.is_some_and(|path| path.as_str() == ROUTE) {
        return Ok(());
    }
    let params = raw_path(parts, state).await?;
    let named = params.iter().find(|(name, _)| *name == "route");
    match named.and_then(|(_, text)| RouteId::from_str(text).ok()) {
        Some(route) => state.known_route(&route).await.map(drop),
        None => Ok(()),
    }
}
