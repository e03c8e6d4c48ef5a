//! The map in tiles, for viewers that zoom.

use axum::Json;
use axum::extract::State;
use axum::http::HeaderMap;
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Deserializer, Serialize};
use utoipa::{IntoParams, ToSchema};

use super::ApiState;
use super::extract::{ApiPath, ApiQuery};
use super::map_files::{Kept, MapFiles, Shown, map_files, meant};
use super::maps::Binary;
use super::parameters::{IfMapChanged, RouteParam};
use super::problem::{Problem, ProblemKind};
use super::problem_responses::RoutePartProblems;
use crate::ids::RouteId;
use crate::model::MapLayer;
use crate::render::{MapRaster, TILE_PIXELS, ZOOM_MAX};
use crate::store::RouteRecord;

/// Which map to show.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct TileQuery {
    /// A version of the map; if left out the newest released one, or the draft while none is released.
    #[param(nullable = false)]
    version: Option<i64>,
    /// What of the world the map shows: `observed` is the draft with changes that nobody has accepted.
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

/// The place of a tile, as the OpenAPI document has it.
#[derive(IntoParams)]
#[into_params(parameter_in = Path)]
#[allow(dead_code)]
struct TileParams {
    /// Zoom: at 8 a pixel is 5 cm, at each lower one twice that of the one above
    #[param(minimum = 0, maximum = 8)]
    z: u8,
    /// Column, along the map's x; 0 begins at the map's origin
    x: i32,
    /// Row, against the map's y; 0 begins at the map's origin. With `.png` behind it
    #[param(pattern = r"^-?[0-9]{1,10}\.png$")]
    y: String,
}

/// The row of a tile with the name of its format behind it: parts of a path are matched whole.
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

/// What there is in tiles, and where.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = MapTiles)]
pub(super) struct TilesBody {
    /// The version that is shown.
    version: i64,
    /// What of the world it shows.
    layer: MapLayer,
    /// Path of a tile, with `{z}`, `{x}` and `{y}` to be replaced.
    tiles: String,
    /// Pixels along the edge of a tile.
    tile_size: usize,
    /// The lowest zoom.
    min_zoom: u8,
    /// The highest zoom at which tiles show more than at the one below. Higher ones, up to 8, show larger
    /// pixels.
    max_zoom: u8,
    /// Edge of a cell of the map, metres: 0.05, or coarser for a map of more than 24 million cells.
    resolution_m: f64,
    /// Lowest x and y, highest x and y of the map, metres, map frame.
    #[schema(min_items = 4, max_items = 4)]
    bounds: [f64; 4],
    /// The ETag of every tile: as long as it is the same, so are the tiles.
    tag: String,
}

/// What a request asks for.
struct Asked {
    route: RouteRecord,
    shown: Shown,
    kept: Kept,
}

async fn asked(state: &ApiState, route: &RouteId, query: &TileQuery) -> Result<Asked, Problem> {
    let route = state.known_route(route).await?;
    let shown = meant(state, &route, query.version, query.layer).await?;
    let kept = Kept::new(&route, query.version, shown);
    Ok(Asked { route, shown, kept })
}

/// The cells of a picture.
pub(super) fn raster(files: &MapFiles) -> Result<MapRaster<'_>, Problem> {
    let yaml = std::str::from_utf8(&files.yaml).map_err(Problem::internal)?;
    MapRaster::read(&files.pgm, yaml).ok_or_else(|| {
        let error = std::io::Error::other("a map's picture does not read back");
        Problem::internal(error)
    })
}

/// Read what the tiles of a map cover.
///
/// The extent of the map, its zooms, and the path of its tiles. A map of more than 24 million cells is drawn with
/// coarser cells, and its highest zoom is lower.
#[utoipa::path(
    get, path = "/v1/routes/{route}/map/tiles.json", tag = "map",
    params(RouteParam, TileQuery, IfMapChanged),
    responses(
        (status = 200, description = "What there is", body = TilesBody, headers(("ETag" = String, description = "Changes with the map"))),
        (status = 304, description = "The map is as it was"),
        RoutePartProblems,
    )
)]
pub(super) async fn get_tiles(
    State(state): State<ApiState>,
    ApiPath(route_id): ApiPath<RouteId>,
    ApiQuery(query): ApiQuery<TileQuery>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let Asked { route, shown, kept } = asked(&state, &route_id, &query).await?;
    if let Some(unchanged) = kept.unchanged(&headers) {
        return Ok(unchanged);
    }
    let files = map_files(&state, &route, shown).await?;
    let raster = raster(&files)?;
    let (version, layer) = match shown {
        Shown::Draft(layer) => (route.map_version, layer),
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
            "/v1/routes/{}/map/tiles/{{z}}/{{x}}/{{y}}.png?version={version}{layered}",
            route.id
        ),
        tile_size: TILE_PIXELS,
        min_zoom: 0,
        max_zoom: raster.zoom(),
        resolution_m: raster.resolution_m(),
        bounds: raster.bounds_m(),
        tag: kept.tag().to_owned(),
    };
    Ok((kept.headers(), Json(body)).into_response())
}

/// Read a tile of a map as a PNG picture.
///
/// 256 × 256 pixels. Free white, occupied black, unknown transparent, as is everything outside the map. A
/// pixel of several cells is occupied if one of them is. Tiles of a version that has ended never change.
#[utoipa::path(
    get, path = "/v1/routes/{route}/map/tiles/{z}/{x}/{y}", tag = "map",
    params(RouteParam, TileParams, TileQuery, IfMapChanged),
    responses(
        (status = 200, description = "The tile", body = Binary, content_type = "image/png", headers(("ETag" = String, description = "Changes with the map"))),
        (status = 304, description = "The map is as it was"),
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
    let Asked { route, shown, kept } = asked(&state, &route, &query).await?;
    if let Some(unchanged) = kept.unchanged(&headers) {
        return Ok(unchanged);
    }
    let files = map_files(&state, &route, shown).await?;
    let draw = move || Ok(raster(&files)?.tile(z, x, y.0).map_err(Problem::internal)?);
    let tile: Result<_, Problem> = state.rendering.run(draw).await?;
    Ok(kept.answer("image/png", tile?.into()))
}
