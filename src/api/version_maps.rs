//! Pictures of the versions of a route's map: of one that has ended they never change.

use axum::body::Bytes;
use axum::extract::State;
use axum::http::HeaderMap;
use axum::response::Response;

use super::ApiState;
use super::extract::{ApiPath, NoQuery};
use super::map_files::{Kept, MapFiles, map_files, meant};
use super::maps::Binary;
use super::parameters::{IfMapChanged, RouteParam, VersionParam};
use super::problem::Problem;
use super::problem_responses::RoutePartProblems;
use crate::ids::RouteId;

async fn answer(
    state: &ApiState,
    (route_id, version): (RouteId, i64),
    request: &HeaderMap,
    media_type: &'static str,
    choose: impl Fn(&MapFiles) -> &Bytes,
) -> Result<Response, Problem> {
    let route = state.known_route(&route_id).await?;
    let shown = meant(state, &route, Some(version), None).await?;
    let kept = Kept::new(&route, Some(version), shown);
    // A version that is not there has no copies.
    let files = map_files(state, &route, shown).await?;
    let unchanged = kept.unchanged(request);
    Ok(unchanged.unwrap_or_else(|| kept.answer(media_type, choose(&files).clone())))
}

/// Read a version of the map as a PNG picture.
///
/// As `map.png` was when the version ended; of the draft as the accepted map is now.
#[utoipa::path(
    get, path = "/v1/routes/{route}/versions/{version}/map.png", tag = "map",
    params(RouteParam, VersionParam, IfMapChanged),
    responses(
        (status = 200, description = "The picture", body = Binary, content_type = "image/png", headers(("ETag" = String, description = "Changes with the draft"))),
        (status = 304, description = "The map is as it was"),
        RoutePartProblems,
    )
)]
pub(super) async fn get_version_png(
    State(state): State<ApiState>,
    ApiPath(path): ApiPath<(RouteId, i64)>,
    _: NoQuery,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    answer(&state, path, &headers, "image/png", |files| &files.png).await
}

/// Read a version of the map as a PGM picture for ROS's `map_server`.
///
/// As `map.pgm` was when the version ended, with the SHA-256 that the list of versions has; of the draft as
/// the accepted map is now.
#[utoipa::path(
    get, path = "/v1/routes/{route}/versions/{version}/map.pgm", tag = "map",
    params(RouteParam, VersionParam, IfMapChanged),
    responses(
        (status = 200, description = "The picture", body = Binary, content_type = "image/x-portable-graymap", headers(("ETag" = String, description = "Changes with the draft"))),
        (status = 304, description = "The map is as it was"),
        RoutePartProblems,
    )
)]
pub(super) async fn get_version_pgm(
    State(state): State<ApiState>,
    ApiPath(path): ApiPath<(RouteId, i64)>,
    _: NoQuery,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let media_type = "image/x-portable-graymap";
    answer(&state, path, &headers, media_type, |files| &files.pgm).await
}

/// Read the description of a version of the map for ROS's `map_server`.
///
/// Resolution, origin and thresholds of the version's `map.pgm`.
#[utoipa::path(
    get, path = "/v1/routes/{route}/versions/{version}/map.yaml", tag = "map",
    params(RouteParam, VersionParam, IfMapChanged),
    responses(
        (status = 200, description = "The description", body = String, content_type = "application/yaml", headers(("ETag" = String, description = "Changes with the draft"))),
        (status = 304, description = "The map is as it was"),
        RoutePartProblems,
    )
)]
pub(super) async fn get_version_yaml(
    State(state): State<ApiState>,
    ApiPath(path): ApiPath<(RouteId, i64)>,
    _: NoQuery,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let media_type = "application/yaml";
    answer(&state, path, &headers, media_type, |files| &files.yaml).await
}
