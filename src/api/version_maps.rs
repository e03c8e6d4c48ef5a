//! Pictures of the versions of a route's map that others have followed: they never change.

use axum::extract::State;
use axum::http::header;
use axum::response::{IntoResponse, Response};

use super::ApiState;
use super::extract::{ApiPath, NoQuery};
use super::maps::Binary;
use super::parameters::{RouteParam, VersionParam};
use super::problem::{Problem, ProblemKind};
use super::problem_responses::RoutePartProblems;
use crate::ids::RouteId;
use crate::store::MapPicture;

/// A year, the longest time that caches keep anything.
const FOR_EVER: &str = "public, max-age=31536000, immutable";

async fn answer(
    state: &ApiState,
    (route_id, version): (RouteId, i64),
    media_type: &'static str,
    choose: impl Fn(MapPicture) -> Vec<u8>,
) -> Result<Response, Problem> {
    let route = state.known_route(&route_id).await?;
    let picture = state.store.map_version_picture(&route_id, version).await?;
    let Some(picture) = picture else {
        return Err(if version == route.map_version {
            let detail = "the present version still grows: read map.png, map.pgm and map.yaml of \
                          the route";
            Problem::new(ProblemKind::NotFound, detail)
        } else {
            Problem::not_found("version of the map")
        });
    };
    let headers = [
        (header::CONTENT_TYPE, media_type),
        (header::CACHE_CONTROL, FOR_EVER),
    ];
    Ok((headers, choose(picture)).into_response())
}

/// Read a version of the map as a PNG picture.
///
/// As `map.png` was when another version followed. The present version is not here.
#[utoipa::path(
    get, path = "/v1/routes/{route}/versions/{version}/map.png", tag = "map",
    params(RouteParam, VersionParam),
    responses((status = 200, description = "The picture", body = Binary, content_type = "image/png"), RoutePartProblems)
)]
pub(super) async fn get_version_png(
    State(state): State<ApiState>,
    ApiPath(path): ApiPath<(RouteId, i64)>,
    _: NoQuery,
) -> Result<Response, Problem> {
    answer(&state, path, "image/png", |picture| picture.png).await
}

/// Read a version of the map as a PGM picture for ROS's `map_server`.
///
/// As `map.pgm` was when another version followed; its SHA-256 is in the list of versions.
#[utoipa::path(
    get, path = "/v1/routes/{route}/versions/{version}/map.pgm", tag = "map",
    params(RouteParam, VersionParam),
    responses((status = 200, description = "The picture", body = Binary, content_type = "image/x-portable-graymap"), RoutePartProblems)
)]
pub(super) async fn get_version_pgm(
    State(state): State<ApiState>,
    ApiPath(path): ApiPath<(RouteId, i64)>,
    _: NoQuery,
) -> Result<Response, Problem> {
    let media_type = "image/x-portable-graymap";
    answer(&state, path, media_type, |picture| picture.pgm).await
}

/// Read the description of a version of the map for ROS's `map_server`.
///
/// Resolution, origin and thresholds of the version's `map.pgm`.
#[utoipa::path(
    get, path = "/v1/routes/{route}/versions/{version}/map.yaml", tag = "map",
    params(RouteParam, VersionParam),
    responses((status = 200, description = "The description", body = String, content_type = "application/yaml"), RoutePartProblems)
)]
pub(super) async fn get_version_yaml(
    State(state): State<ApiState>,
    ApiPath(path): ApiPath<(RouteId, i64)>,
    _: NoQuery,
) -> Result<Response, Problem> {
    let media_type = "application/yaml";
    answer(&state, path, media_type, |picture| {
        picture.yaml.into_bytes()
    })
    .await
}
