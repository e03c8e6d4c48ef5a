//! Pictures of a route's map as it is for vehicles: of the newest released version.

use axum::body::Bytes;
use axum::extract::State;
use axum::http::HeaderMap;
use axum::response::Response;
use serde::Deserialize;
use utoipa::{IntoParams, ToSchema};

use super::ApiState;
use super::extract::{ApiPath, ApiQuery};
use super::map_files::{Kept, MapFiles, map_files, meant};
use super::parameters::{IfMapChanged, RouteParam};
use super::problem::Problem;
use super::problem_responses::RoutePartProblems;
use crate::ids::RouteId;
use crate::model::MapLayer;

/// What the picture is to show.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct LayerQuery {
    /// What of the world the map shows: `accepted`, if left out, is the newest released version, or the
    /// draft while none is released; `observed` is the draft with changes that nobody has accepted.
    #[param(nullable = false, inline)]
    layer: Option<MapLayer>,
}

/// Bytes of a picture.
#[derive(ToSchema)]
#[schema(value_type = String, format = Binary)]
#[allow(dead_code)]
pub(super) struct Binary(Vec<u8>);

async fn answer(
    state: &ApiState,
    route_id: &RouteId,
    query: &LayerQuery,
    request: &HeaderMap,
    media_type: &'static str,
    choose: impl Fn(&MapFiles) -> &Bytes,
) -> Result<Response, Problem> {
    let route = state.known_route(route_id).await?;
    let shown = meant(state, &route, None, query.layer).await?;
    let kept = Kept::new(&route, None, shown);
    if let Some(unchanged) = kept.unchanged(request) {
        return Ok(unchanged);
    }
    let files = map_files(state, &route, shown).await?;
    Ok(kept.answer(media_type, choose(&files).clone()))
}

/// Read the map as a PNG picture.
///
/// The newest released version, or the draft while none is released. Free white, occupied black, unknown
/// light grey, y upwards, 5 cm a pixel. Changes that nobody has accepted are left out. The ETag changes
/// with the map.
#[utoipa::path(
    get, path = "/v1/routes/{route}/map.png", tag = "map",
    params(RouteParam, LayerQuery, IfMapChanged),
    responses(
        (status = 200, description = "The picture", body = Binary, content_type = "image/png", headers(("ETag" = String, description = "Changes with the map"))),
        (status = 304, description = "The map is as it was"),
        RoutePartProblems,
    )
)]
pub(super) async fn get_map_png(
    State(state): State<ApiState>,
    ApiPath(route_id): ApiPath<RouteId>,
    ApiQuery(query): ApiQuery<LayerQuery>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    answer(&state, &route_id, &query, &headers, "image/png", |files| {
        &files.png
    })
    .await
}

/// Read the map as a PGM picture for ROS's `map_server`.
///
/// The newest released version, or the draft while none is released. Binary PGM: 0 occupied, 254 free, 205 unknown, row 0 on top. `map.yaml` goes with it.
#[utoipa::path(
    get, path = "/v1/routes/{route}/map.pgm", tag = "map",
    params(RouteParam, LayerQuery, IfMapChanged),
    responses(
        (status = 200, description = "The picture", body = Binary, content_type = "image/x-portable-graymap", headers(("ETag" = String, description = "Changes with the map"))),
        (status = 304, description = "The map is as it was"),
        RoutePartProblems,
    )
)]
pub(super) async fn get_map_pgm(
    State(state): State<ApiState>,
    ApiPath(route_id): ApiPath<RouteId>,
    ApiQuery(query): ApiQuery<LayerQuery>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let media_type = "image/x-portable-graymap";
    answer(&state, &route_id, &query, &headers, media_type, |files| {
        &files.pgm
    })
    .await
}

/// Read the map's description for ROS's `map_server`.
///
/// Resolution, origin and thresholds of `map.pgm`.
#[utoipa::path(
    get, path = "/v1/routes/{route}/map.yaml", tag = "map",
    params(RouteParam, LayerQuery, IfMapChanged),
    responses(
        (status = 200, description = "The description", body = String, content_type = "application/yaml", headers(("ETag" = String, description = "Changes with the map"))),
        (status = 304, description = "The map is as it was"),
        RoutePartProblems,
    )
)]
pub(super) async fn get_map_yaml(
    State(state): State<ApiState>,
    ApiPath(route_id): ApiPath<RouteId>,
    ApiQuery(query): ApiQuery<LayerQuery>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    answer(
        &state,
        &route_id,
        &query,
        &headers,
        "application/yaml",
        |files| &files.yaml,
    )
    .await
}
