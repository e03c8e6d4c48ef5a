//! What was observed of an alert's place, as JSON and as a picture.

use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

use super::evidence_picture::PICTURE_POLICY;
use super::known::known_alert;
use super::observations::place_grid;
use super::sentence::{summary, title};
use super::size::Size;
use crate::api::ApiState;
use crate::api::extract::{ApiPath, ApiQuery, NoQuery};
use crate::api::if_match::is_known;
use crate::api::parameters::{AlertParam, IfNoneMatch};
use crate::api::problem::Problem;
use crate::api::problem_responses::AlertProblems;
use crate::geometry::Vector2;
use crate::ids::AlertId;
use crate::model::ShownSide;
use crate::render::place_svg::{PlacePicture, to_svg};
use crate::render::{PlaceGrid, SideCells};
use crate::store::AlertRecord;

/// What to show.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(in crate::api) struct ShownQuery {
    /// Which observations: those before the change, those since, or `both` (the default).
    #[param(nullable = false, inline)]
    show: Option<ShownSide>,
}

/// What was observed of an alert's place, cell by cell.
#[derive(Debug, Serialize, ToSchema)]
pub(in crate::api) struct AlertObservations {
    /// The alert.
    #[schema(format = "uuid")]
    alert_id: String,
    /// Edge of a cell, metres.
    resolution: f64,
    /// The lower left corner of cell 0, map frame.
    origin: OriginBody,
    /// Cells along x.
    width: usize,
    /// Cells along y.
    height: usize,
    /// What was observed before the change, and after the last change accepted there.
    before: SideBody,
    /// What was observed since, for as long as the change lasted.
    since: SideBody,
}

/// A corner of a grid.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = GridOrigin)]
struct OriginBody {
    /// Metres.
    x: f64,
    /// Metres.
    y: f64,
}

/// What was observed on one side of the change: three lists of equal length, and a list of positions.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = ObservedCells)]
struct SideBody {
    /// How many observations cover the place.
    observations: usize,
    /// The cells with a hit or a miss: row · `width` + column, row 0 at the lowest y. All others are unknown.
    cells: Vec<usize>,
    /// For each of these cells, the observations with a hit: a beam ended there.
    hits: Vec<u32>,
    /// For each of these cells, the observations with a miss: beams passed through, and none ended there.
    misses: Vec<u32>,
    /// The position of the lidar at each observation: [x, y] in the map frame, metres.
    #[schema(value_type = Vec<Vec<f64>>)]
    positions: Vec<[f64; 2]>,
}

/// Read what was observed of an alert's place.
///
/// Cell by cell, before the change and since, in the map as it is now: from all scans taken within reach of the
/// place, at most those of 600 keyframes for each side. 404 for alerts about a vehicle.
#[utoipa::path(
    get, path = "/v1/alerts/{alert}/observations", tag = "alerts",
    params(AlertParam, IfNoneMatch),
    responses(
        (status = 200, description = "The observations", body = AlertObservations, headers(("ETag" = String, description = "Changes with the alert and with the map"))),
        (status = 304, description = "The observations have not changed"),
        AlertProblems,
    )
)]
pub(in crate::api) async fn get_observations(
    State(state): State<ApiState>,
    ApiPath(id): ApiPath<AlertId>,
    _: NoQuery,
    request: HeaderMap,
) -> Result<Response, Problem> {
    let alert = known_alert(&state, id).await?;
    let headers = headers(&state, &alert, "json").await?;
    if is_known(&request, &headers[0].1) {
        return Ok((StatusCode::NOT_MODIFIED, headers).into_response());
    }
    let grid = place_grid(&state, &alert).await?;
    Ok((headers, Json(AlertObservations::of(id, &grid))).into_response())
}

/// Read what was observed of an alert's place as an SVG picture.
///
/// The same as `observations`: cells hit before the change in blue, since in orange, on both sides in grey; free
/// space is shaded, and dots mark the positions of the lidar.
#[utoipa::path(
    get, path = "/v1/alerts/{alert}/observations.svg", tag = "alerts",
    params(AlertParam, ShownQuery, IfNoneMatch),
    responses(
        (status = 200, description = "The picture", body = String, content_type = "image/svg+xml", headers(("ETag" = String, description = "Changes with the alert and with the map"))),
        (status = 304, description = "The picture has not changed"),
        AlertProblems,
    )
)]
pub(in crate::api) async fn get_observations_svg(
    State(state): State<ApiState>,
    ApiPath(id): ApiPath<AlertId>,
    ApiQuery(query): ApiQuery<ShownQuery>,
    request: HeaderMap,
) -> Result<Response, Problem> {
    let alert = known_alert(&state, id).await?;
    let shown = query.show.unwrap_or_default();
    let headers = headers(&state, &alert, shown.name()).await?;
    if is_known(&request, &headers[0].1) {
        return Ok((StatusCode::NOT_MODIFIED, headers).into_response());
    }
    let grid = place_grid(&state, &alert).await?;
    let picture = state.rendering.run(move || draw(&alert, &grid, shown));
    let picture = picture.await?;
    let of_picture = [
        (header::CONTENT_TYPE, "image/svg+xml"),
        (header::CONTENT_SECURITY_POLICY, PICTURE_POLICY),
    ];
    Ok((headers, of_picture, picture).into_response())
}

/// The ETag, and how the answer may be cached.
async fn headers(
    state: &ApiState,
    alert: &AlertRecord,
    form: &str,
) -> Result<[(header::HeaderName, String); 2], Problem> {
    let route = state.known_route(&alert.route_id).await?;
    let tag = format!("\"{}-{}-{form}\"", alert.revision, route.revision);
    Ok([
        (header::ETAG, tag),
        (header::CACHE_CONTROL, "no-cache".to_owned()),
    ])
}

fn draw(alert: &AlertRecord, grid: &PlaceGrid, shown: ShownSide) -> String {
    let region = &alert.evidence.region;
    let size = Size::of(region);
    to_svg(&PlacePicture {
        title: &title(alert, size),
        summary: &summary(alert, size),
        grid,
        region,
        shown,
    })
}

impl AlertObservations {
    fn of(id: AlertId, grid: &PlaceGrid) -> Self {
        Self {
            alert_id: id.to_string(),
            resolution: grid.resolution_m,
            origin: OriginBody {
                x: grid.origin.x,
                y: grid.origin.y,
            },
            width: grid.width,
            height: grid.height,
            before: SideBody::from(&grid.before),
            since: SideBody::from(&grid.since),
        }
    }
}

impl From<&SideCells> for SideBody {
    fn from(side: &SideCells) -> Self {
        let is_known = |cell: &usize| side.hits[*cell] + side.misses[*cell] > 0;
        let cells: Vec<usize> = (0..side.hits.len()).filter(is_known).collect();
        let to_centimetre = |value: f64| (1e2 * value).round() / 1e2;
        let place = |eye: &Vector2<f64>| [eye.x, eye.y].map(to_centimetre);
        Self {
            observations: side.eyes.len(),
            hits: cells.iter().map(|&cell| side.hits[cell]).collect(),
            misses: cells.iter().map(|&cell| side.misses[cell]).collect(),
            positions: side.eyes.iter().map(place).collect(),
            cells,
        }
    }
}
