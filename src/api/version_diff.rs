//! What differs between two versions of a route's map.

use axum::Json;
use axum::extract::State;
use axum::http::HeaderMap;
use axum::response::Response;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

use super::ApiState;
use super::extract::{ApiPath, ApiQuery};
use super::map_files::raster;
use super::map_validity::Validity;
use super::parameters::{IfNoneMatch, RouteParam, VersionParam};
use super::problem::Problem;
use super::problem_responses::RoutePartProblems;
use super::shown_map::ShownMap;
use super::types::Binary;
use super::versions::known_version;
use crate::ids::{AlertId, RouteId};
use crate::render::{DifferingCells, MapDifference};
use crate::store::MapVersionRecord;

/// What to compare a version with.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct DiffQuery {
    /// The version to compare with; the one before it by default.
    #[param(nullable = false)]
    from: Option<i64>,
}

/// What differs between two versions.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = MapVersionDifference)]
pub(super) struct DiffBody {
    /// The version compared with.
    from: i64,
    /// The version in the path.
    to: i64,
    /// Edge of the cells counted, metres: the larger of the two versions' edges.
    resolution_m: f64,
    /// How many cells differ.
    cells: DifferingCellsBody,
    /// Lowest x and y, highest x and y of the cells that differ, metres, map frame; null if none differs.
    #[schema(required, min_items = 4, max_items = 4)]
    bbox: Option<[f64; 4]>,
    /// Ids of the alerts that were accepted or undone between the two.
    #[schema(value_type = Vec<String>)]
    alerts: Vec<AlertId>,
}

/// How many cells differ. Each is counted once.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = DifferingCells)]
struct DifferingCellsBody {
    /// Free in `from`, occupied in `to`.
    to_occupied: u64,
    /// Occupied in `from`, free in `to`.
    to_free: u64,
    /// Free or occupied in `from`, unknown in `to`.
    to_unknown: u64,
    /// Unknown in `from`, free or occupied in `to`.
    from_unknown: u64,
}

impl From<DifferingCells> for DifferingCellsBody {
    fn from(cells: DifferingCells) -> Self {
        Self {
            to_occupied: cells.to_occupied,
            to_free: cells.to_free,
            to_unknown: cells.to_unknown,
            from_unknown: cells.from_unknown,
        }
    }
}

/// The two versions that a request compares.
struct Compared {
    from: Side,
    to: Side,
}

/// One of two compared versions.
struct Side {
    version: i64,
    began_at: Timestamp,
    map: ShownMap,
}

impl Side {
    async fn of(
        state: &ApiState,
        route_id: &RouteId,
        record: &MapVersionRecord,
    ) -> Result<Self, Problem> {
        Ok(Self {
            version: record.version,
            began_at: record.created_at,
            map: ShownMap::of(state, route_id, Some(record.version), None).await?,
        })
    }
}

async fn compared(
    state: &ApiState,
    (route_id, to): (RouteId, i64),
    query: &DiffQuery,
) -> Result<Compared, Problem> {
    let after = known_version(state, &route_id, to).await?;
    let from = query.from.unwrap_or(to - 1);
    let before = state.store.map_version(&route_id, from).await?;
    let before = before.ok_or_else(|| {
        let detail = match query.from {
            Some(from) => format!("the map has no version {from} to compare with"),
            None => {
                "there is no version before version 1: name a version to compare with".to_owned()
            }
        };
        Problem::parameter("from", detail)
    })?;
    Ok(Compared {
        from: Side::of(state, &route_id, &before).await?,
        to: Side::of(state, &route_id, &after).await?,
    })
}

impl Compared {
    fn validity(&self) -> Validity {
        Validity::of_both(&self.from.map.validity, &self.to.map.validity)
    }

    async fn difference(&self, state: &ApiState) -> Result<MapDifference, Problem> {
        let before = self.from.map.files(state).await?;
        let after = self.to.map.files(state).await?;
        let work = move || {
            let (before, after) = (raster(&before)?, raster(&after)?);
            Ok(MapDifference::between(&before, &after))
        };
        state.rendering.run(work).await?
    }
}

/// Read what differs between two versions of a map.
///
/// How many cells differ and where, and which alerts were accepted or undone in between. The draft is
/// compared as the accepted map is now.
#[utoipa::path(
    get, path = "/v1/routes/{route}/versions/{version}/diff", tag = "map",
    params(RouteParam, VersionParam, DiffQuery),
    responses((status = 200, description = "What differs", body = DiffBody), RoutePartProblems)
)]
pub(super) async fn get_version_diff(
    State(state): State<ApiState>,
    ApiPath(path): ApiPath<(RouteId, i64)>,
    ApiQuery(query): ApiQuery<DiffQuery>,
) -> Result<Json<DiffBody>, Problem> {
    let compared = compared(&state, path, &query).await?;
    let difference = compared.difference(&state).await?;
    let Compared { from, to } = &compared;
    let earlier = from.began_at.min(to.began_at);
    let later = from.began_at.max(to.began_at);
    let route_id = &to.map.route.id;
    let alerts = state.store.alerts_in_map_between(route_id, earlier, later);
    Ok(Json(DiffBody {
        from: from.version,
        to: to.version,
        resolution_m: difference.resolution_m(),
        cells: difference.cells().into(),
        bbox: difference.bounds_m(),
        alerts: alerts.await?,
    }))
}

/// Read what differs between two versions of a map as a PNG picture.
///
/// Everything that either version covers; y points up, one pixel a cell. Cells on which they agree are white
/// (free), dark grey (occupied) or light grey (unknown). Vermilion marks cells that have become occupied, blue
/// those that have become free; a pale colour means that one version does not know the cell. The colours are
/// safe for colour-blind readers.
#[utoipa::path(
    get, path = "/v1/routes/{route}/versions/{version}/diff.png", tag = "map",
    params(RouteParam, VersionParam, DiffQuery, IfNoneMatch),
    responses(
        (status = 200, description = "The picture", body = Binary, content_type = "image/png", headers(("ETag" = String, description = "Changes with the draft"))),
        (status = 304, description = "Neither version has changed"),
        RoutePartProblems,
    )
)]
pub(super) async fn get_version_diff_png(
    State(state): State<ApiState>,
    ApiPath(path): ApiPath<(RouteId, i64)>,
    ApiQuery(query): ApiQuery<DiffQuery>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let compared = compared(&state, path, &query).await?;
    let validity = compared.validity();
    if let Some(unchanged) = validity.unchanged(&headers) {
        return Ok(unchanged);
    }
    let difference = compared.difference(&state).await?;
    let draw = move || difference.to_png();
    let png = state.rendering.run(draw).await?;
    Ok(validity.answer("image/png", png.map_err(Problem::internal)?.into()))
}
