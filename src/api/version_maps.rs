//! The maps of a route's versions; that of a version that has ended never changes.

use axum::extract::State;
use axum::http::HeaderMap;
use axum::response::Response;

use super::ApiState;
use super::extract::{ApiPath, NoQuery};
use super::parameters::{IfNoneMatch, RouteParam, VersionParam};
use super::problem::Problem;
use super::problem_responses::RoutePartProblems;
use super::shown_map::{MapFormat, ShownMap};
use super::types::Binary;
use crate::ids::RouteId;

/// Read a version of the map as a PNG picture.
///
/// As `map.png` was when the version ended; for the draft, the accepted map as it is now.
#[utoipa::path(
    get, path = "/v1/routes/{route}/versions/{version}/map.png", tag = "map",
    params(RouteParam, VersionParam, IfNoneMatch),
    responses(
        (status = 200, description = "The picture", body = Binary, content_type = "image/png", headers(("ETag" = String, description = "Changes with the draft"))),
        (status = 304, description = "The map has not changed"),
        RoutePartProblems,
    )
)]
pub(super) async fn get_version_png(
    State(state): State<ApiState>,
    ApiPath((route_id, version)): ApiPath<(RouteId, i64)>,
    _: NoQuery,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let map = ShownMap::of(&state, &route_id, Some(version), None).await?;
    map.answer(&state, &headers, MapFormat::Png).await
}

/// Read a version of the map as a PGM picture for ROS's `map_server`.
///
/// As `map.pgm` was when the version ended, with the SHA-256 that the list of versions gives; for the draft,
/// the accepted map as it is now.
#[utoipa::path(
    get, path = "/v1/routes/{route}/versions/{version}/map.pgm", tag = "map",
    params(RouteParam, VersionParam, IfNoneMatch),
    responses(
        (status = 200, description = "The picture", body = Binary, content_type = "image/x-portable-graymap", headers(("ETag" = String, description = "Changes with the draft"))),
        (status = 304, description = "The map has not changed"),
        RoutePartProblems,
    )
)]
pub(super) async fn get_version_pgm(
    State(state): State<ApiState>,
    ApiPath((route_id, version)): ApiPath<(RouteId, i64)>,
    _: NoQuery,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let map = ShownMap::of(&state, &route_id, Some(version), None).await?;
    map.answer(&state, &headers, MapFormat::Pgm).await
}

/// Read the description of a version of the map for ROS's `map_server`.
///
/// Resolution, origin and thresholds of the version's `map.pgm`.
#[utoipa::path(
    get, path = "/v1/routes/{route}/versions/{version}/map.yaml", tag = "map",
    params(RouteParam, VersionParam, IfNoneMatch),
    responses(
        (status = 200, description = "The description", body = String, content_type = "application/yaml", headers(("ETag" = String, description = "Changes with the draft"))),
        (status = 304, description = "The map has not changed"),
        RoutePartProblems,
    )
)]
pub(super) async fn get_version_yaml(
    State(state): State<ApiState>,
    ApiPath((route_id, version)): ApiPath<(RouteId, i64)>,
    _: NoQuery,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let map = ShownMap::of(&state, &route_id, Some(version), None).await?;
    map.answer(&state, &headers, MapFormat::Yaml).await
}
