//! The map in tiles, for viewers that zoom.

use axum::Json;
use axum::extract::State;
use axum::http::HeaderMap;
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Deserializer, Serialize};
use utoipa::{IntoParams, ToSchema};

use super::ApiState;
use super::extract::{ApiPath, ApiQuery};
use super::map_cache::Shown;
use super::map_files::raster;
use super::parameters::{IfNoneMatch, RouteParam};
use super::problem::{Problem, ProblemKind};
use super::problem_responses::RoutePartProblems;
use super::shown_map::ShownMap;
use super::types::Binary;
use crate::ids::RouteId;
use crate::model::MapLayer;
use crate::render::{TILE_PIXELS, ZOOM_MAX};

/// Which map to show.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct TileQuery {
    /// A version of the map; the newest released one by default, or the draft while none is released.
    #[param(nullable = false)]
    version: Option<i64>,
    /// Which state of the world the map shows: `accepted` (the default), or `observed`, the draft with
    /// changes that nobody has accepted yet.
    #[param(nullable = false, inline)]
    layer: Option<MapLayer>,
}

/// Which tile.
#[derive(Debug, Deserialize)]
pub(super) struct TilePath {
    route: RouteId,
    z: u8,
    x: i32,
    y: TileRow,
}

/// The parts of a tile's path, for the OpenAPI document.
#[derive(IntoParams)]
#[into_params(parameter_in = Path)]
#[allow(dead_code)]
struct TileParams {
    /// Zoom level: a pixel is 5 cm at 8, and twice as large at each level below
    #[param(minimum = 0, maximum = 8)]
    z: u8,
    /// Column, in the direction of the map's x; column 0 begins at the map's origin
    x: i32,
    /// Row, against the direction of the map's y, followed by `.png`; row 0 begins at the map's origin
    #[param(pattern = r"^-?[0-9]{1,10}\.png$")]
    y: String,
}

/// The row of a tile followed by the name of its format: the router matches a part of a path as a whole.
#[derive(Debug)]
struct TileRow(i32);

impl<'de> Deserialize<'de> for TileRow {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = String::deserialize(deserializer)?;
        let row = text
            .strip_suffix(".png")
            .and_then(|digits| digits.parse().ok());
        let expected = "the last part of a tile's path is a number and `.png`, such as `-3.png`";
        row.map(Self)
            .ok_or_else(|| serde::de::Error::custom(expected))
    }
}

/// What the tiles of a map cover.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = MapTiles)]
pub(super) struct TilesBody {
    /// The version shown.
    version: i64,
    /// Which state of the world it shows.
    layer: MapLayer,
    /// Path of a tile, with `{z}`, `{x}` and `{y}` to be replaced.
    tiles: String,
    /// Pixels along the edge of a tile.
    tile_size: usize,
    /// The lowest zoom.
    min_zoom: u8,
    /// The highest zoom at which tiles show more detail than at the one below; higher ones, up to 8, only
    /// show larger pixels.
    max_zoom: u8,
    /// Edge of a cell of the map, metres: 0.05, or more for a map of more than 24 million cells.
    resolution_m: f64,
    /// Lowest x and y, highest x and y of the map, metres, map frame.
    #[schema(min_items = 4, max_items = 4)]
    bounds: [f64; 4],
    /// The ETag of every tile: while it is the same, so are the tiles.
    tag: String,
}

/// Read what the tiles of a map cover.
///
/// The extent of the map, its zoom levels, and the path of its tiles. A map of more than 24 million cells is
/// drawn with coarser cells, so its highest zoom is lower.
#[utoipa::path(
    get, path = "/v1/routes/{route}/map/tiles.json", tag = "map",
    params(RouteParam, TileQuery, IfNoneMatch),
    responses(
        (status = 200, description = "What the tiles cover", body = TilesBody, headers(("ETag" = String, description = "Changes with the map"))),
        (status = 304, description = "The map has not changed"),
        RoutePartProblems,
    )
)]
pub(super) async fn get_tiles(
    State(state): State<ApiState>,
    ApiPath(route_id): ApiPath<RouteId>,
    ApiQuery(query): ApiQuery<TileQuery>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let map = ShownMap::of(&state, &route_id, query.version, query.layer).await?;
    if let Some(unchanged) = map.validity.unchanged(&headers) {
        return Ok(unchanged);
    }
    let files = map.files(&state).await?;
    let raster = raster(&files)?;
    let (version, layer) = match map.shown {
        Shown::Draft(layer) => (map.route.map_version, layer),
        Shown::Version(version) => (version, MapLayer::Accepted),
    };
    let layered = match layer {
        MapLayer::Accepted => String::new(),
        MapLayer::Observed => format!("&layer={}", layer.name()),
    };
    let body = TilesBody {
        version,
        layer,
        tiles: format!(
            "/v1/routes/{route_id}/map/tiles/{{z}}/{{x}}/{{y}}.png?version={version}{layered}"
        ),
        tile_size: TILE_PIXELS,
        min_zoom: 0,
        max_zoom: raster.zoom(),
        resolution_m: raster.resolution_m(),
        bounds: raster.bounds_m(),
        tag: map.validity.tag().to_owned(),
    };
    Ok((map.validity.headers(), Json(body)).into_response())
}

/// Read a tile of a map as a PNG picture.
///
/// 256 × 256 pixels. Free cells are white, occupied ones black; unknown cells and everything outside the map
/// are transparent. A pixel that covers several cells is occupied if any of them is. Tiles of a version that
/// has ended never change.
#[utoipa::path(
    get, path = "/v1/routes/{route}/map/tiles/{z}/{x}/{y}", tag = "map",
    params(RouteParam, TileParams, TileQuery, IfNoneMatch),
    responses(
        (status = 200, description = "The tile", body = Binary, content_type = "image/png", headers(("ETag" = String, description = "Changes with the map"))),
        (status = 304, description = "The map has not changed"),
        RoutePartProblems,
    )
)]
pub(super) async fn get_tile(
    State(state): State<ApiState>,
    ApiPath(TilePath { route, z, x, y }): ApiPath<TilePath>,
    ApiQuery(query): ApiQuery<TileQuery>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    if z > ZOOM_MAX {
        let detail = format!("a zoom is 0 to {ZOOM_MAX}, at which a pixel is 5 cm");
        return Err(Problem::new(ProblemKind::InvalidField, detail));
    }
    let map = ShownMap::of(&state, &route, query.version, query.layer).await?;
    if let Some(unchanged) = map.validity.unchanged(&headers) {
        return Ok(unchanged);
    }
    let files = map.files(&state).await?;
    let draw = move || raster(&files)?.tile(z, x, y.0).map_err(Problem::internal);
    let tile = state.rendering.run(draw).await?;
    Ok(map.validity.answer("image/png", tile?.into()))
}
