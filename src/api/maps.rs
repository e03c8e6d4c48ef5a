//! The map of a route as vehicles use it: the newest released version.

use axum::extract::State;
use axum::http::HeaderMap;
use axum::response::Response;
use serde::Deserialize;
use utoipa::IntoParams;

use super::ApiState;
use super::extract::{ApiPath, ApiQuery};
use super::parameters::{IfNoneMatch, RouteParam};
use super::problem::Problem;
use super::problem_responses::RoutePartProblems;
use super::shown_map::{MapFormat, ShownMap};
use super::types::Binary;
use crate::ids::RouteId;
use crate::model::MapLayer;

/// What the picture shows.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct LayerQuery {
    /// Which state of the world the map shows: `accepted` (the default) is the newest released version, or
    /// the draft while none is released; `observed` is the draft with changes that nobody has accepted yet.
    #[param(nullable = false, inline)]
    layer: Option<MapLayer>,
}

/// Read the map as a PNG picture.
///
/// The newest released version, or the draft while none is released. Free cells are white, occupied ones
/// black, unknown ones light grey; y points up, 5 cm a pixel. Changes that nobody has accepted are left out.
/// The ETag changes with the map.
#[utoipa::path(
    get, path = "/v1/routes/{route}/map.png", tag = "map",
    params(RouteParam, LayerQuery, IfNoneMatch),
    responses(
        (status = 200, description = "The picture", body = Binary, content_type = "image/png", headers(("ETag" = String, description = "Changes with the map"))),
        (status = 304, description = "The map has not changed"),
        RoutePartProblems,
    )
)]
pub(super) async fn get_map_png(
    State(state): State<ApiState>,
    ApiPath(route_id): ApiPath<RouteId>,
    ApiQuery(LayerQuery { layer }): ApiQuery<LayerQuery>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let map = ShownMap::of(&state, &route_id, None, layer).await?;
    map.answer(&state, &headers, MapFormat::Png).await
}

/// Read the map as a PGM picture for ROS's `map_server`.
///
/// The newest released version, or the draft while none is released. Binary PGM: 0 is occupied, 254 free,
/// 205 unknown; row 0 is at the top. `map.yaml` belongs to it.
#[utoipa::path(
    get, path = "/v1/routes/{route}/map.pgm", tag = "map",
    params(RouteParam, LayerQuery, IfNoneMatch),
    responses(
        (status = 200, description = "The picture", body = Binary, content_type = "image/x-portable-graymap", headers(("ETag" = String, description = "Changes with the map"))),
        (status = 304, description = "The map has not changed"),
        RoutePartProblems,
    )
)]
pub(super) async fn get_map_pgm(
    State(state): State<ApiState>,
    ApiPath(route_id): ApiPath<RouteId>,
    ApiQuery(LayerQuery { layer }): ApiQuery<LayerQuery>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let map = ShownMap::of(&state, &route_id, None, layer).await?;
    map.answer(&state, &headers, MapFormat::Pgm).await
}

/// Read the map's description for ROS's `map_server`.
///
/// Resolution, origin and thresholds of `map.pgm`.
#[utoipa::path(
    get, path = "/v1/routes/{route}/map.yaml", tag = "map",
    params(RouteParam, LayerQuery, IfNoneMatch),
    responses(
        (status = 200, description = "The description", body = String, content_type = "application/yaml", headers(("ETag" = String, description = "Changes with the map"))),
        (status = 304, description = "The map has not changed"),
        RoutePartProblems,
    )
)]
pub(super) async fn get_map_yaml(
    State(state): State<ApiState>,
    ApiPath(route_id): ApiPath<RouteId>,
    ApiQuery(LayerQuery { layer }): ApiQuery<LayerQuery>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let map = ShownMap::of(&state, &route_id, None, layer).await?;
    map.answer(&state, &headers, MapFormat::Yaml).await
}
