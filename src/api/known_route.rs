//! Requests below a route that does not exist are answered 404 before their query, headers and body are checked,
//! so that the order of checks is the same everywhere.

use std::str::FromStr;

use axum::body::HttpBody;
use axum::extract::{MatchedPath, Request, State};
use axum::http::Method;
use axum::http::request::Parts;
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use super::ApiState;
use super::batch_intake::count_upload;
use super::extract::raw_path;
use super::problem::Problem;
use crate::ids::RouteId;

/// The path where a PUT creates the route.
const ROUTE: &str = "/v1/routes/{route}";
/// How the paths of uploads end.
const BATCH: &str = "/{batch}";

/// Refuses requests below a route that does not exist, and closes the connection if a body was not read.
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

/// Leaves malformed names for the handler to refuse.
async fn check(state: &ApiState, parts: &mut Parts) -> Result<(), Problem> {
    let matched = parts.extensions.get::<MatchedPath>();
    if parts.method == Method::PUT && matched.is_some_and(|path| path.as_str() == ROUTE) {
        return Ok(());
    }
    match named_route(parts, state).await? {
        Some(route) => state.known_route(&route).await.map(drop),
        None => Ok(()),
    }
}

/// The route that a path names; `None` if it names none, or none that can be.
///
/// # Errors
/// 400 for a part of the path that is not UTF-8.
pub(super) async fn named_route(
    parts: &mut Parts,
    state: &ApiState,
) -> Result<Option<RouteId>, Problem> {
    let params = raw_path(parts, state).await?;
    let named = params.iter().find(|(name, _)| *name == "route");
    Ok(named.and_then(|(_, text)| RouteId::from_str(text).ok()))
}
