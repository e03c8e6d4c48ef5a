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
use super::map_files::{Kept, Shown, map_files, meant};
use super::maps::Binary;
use super::parameters::{IfMapChanged, RouteParam, VersionParam};
use super::problem::Problem;
use super::problem_responses::RoutePartProblems;
use super::tiles::raster;
use super::versions::known_version;
use crate::ids::{AlertId, RouteId};
use crate::render::{DifferingCells, MapDifference};
use crate::store::RouteRecord;

/// With what to compare a version.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct DiffQuery {
    /// The version to compare with; the one before if left out.
    #[param(nullable = false)]
    from: Option<i64>,
}

/// What differs between two versions.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = MapVersionDifference)]
pub(super) struct DiffBody {
    /// The version that is compared with.
    from: i64,
    /// The version in the path.
    to: i64,
    /// Edge of the cells that are counted, metres: the larger one of the two versions.
    resolution_m: f64,
    /// How many cells differ.
    cells: DifferingCellsBody,
    /// Lowest x and y, highest x and y of the cells that differ, metres, map frame; null if none does.
    #[schema(required, min_items = 4, max_items = 4)]
    bbox: Option<[f64; 4]>,
    /// The alerts that were accepted or undone between the two, by id.
    #[schema(value_type = Vec<String>)]
    alerts: Vec<AlertId>,
}

/// How many cells differ, each counted once.
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
    route: RouteRecord,
    versions: [i64; 2],
    began_at: [Timestamp; 2],
    shown: [Shown; 2],
}

async fn compared(
    state: &ApiState,
    (route_id, to): (RouteId, i64),
    query: &DiffQuery,
) -> Result<Compared, Problem> {
    let route = state.known_route(&route_id).await?;
    let after = known_version(state, &route_id, to).await?;
    let from = query.from.unwrap_or(to - 1);
    let before = state.store.map_version(&route_id, from).await?;
    let before = before.ok_or_else(|| {
        let detail = match query.from {
            Some(from) => format!("the map has no version {from} to compare with"),
            None => "nothing comes before version 1: name a version to compare with".to_owned(),
        };
        Problem::parameter("from", detail)
    })?;
    Ok(Compared {
        shown: [
            meant(state, &route, Some(from), None).await?,
            meant(state, &route, Some(to), None).await?,
        ],
        route,
        versions: [from, to],
        began_at: [before.created_at, after.created_at],
    })
}

impl Compared {
    fn kept(&self) -> Kept {
        let kept = |side: usize| {
            let version = Some(self.versions[side]);
            Kept::new(&self.route, version, self.shown[side])
        };
        Kept::of_both(&kept(0), &kept(1))
    }

    async fn difference(&self, state: &ApiState) -> Result<MapDifference, Problem> {
        let before = map_files(state, &self.route, self.shown[0]).await?;
        let after = map_files(state, &self.route, self.shown[1]).await?;
        let work = move || {
            let (before, after) = (raster(&before)?, raster(&after)?);
            Ok(MapDifference::between(&before, &after))
        };
        state.rendering.run(work).await?
    }
}

/// Read what differs between two versions of a map.
///
/// How many cells differ and where, and the alerts that were decided about in between. The draft is compared
/// as the accepted map is now.
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
    let [a, b] = compared.began_at;
    let route_id = &compared.route.id;
    let alerts = state
        .store
        .alerts_in_map_between(route_id, a.min(b), a.max(b));
    let [from, to] = compared.versions;
    Ok(Json(DiffBody {
        from,
        to,
        resolution_m: difference.resolution_m(),
        cells: difference.cells().into(),
        bbox: difference.bounds_m(),
        alerts: alerts.await?,
    }))
}

/// Read what differs between two versions of a map as a PNG picture.
///
/// Of everything that either version shows, y upwards, one pixel a cell. Grey where they agree: free white,
/// occupied dark, unknown light. Vermilion where a free cell has become occupied, blue where an occupied one
/// has become free; pale where one of them knows nothing. Both colours can be distinguished by everybody.
#[utoipa::path(
    get, path = "/v1/routes/{route}/versions/{version}/diff.png", tag = "map",
    params(RouteParam, VersionParam, DiffQuery, IfMapChanged),
    responses(
        (status = 200, description = "The picture", body = Binary, content_type = "image/png", headers(("ETag" = String, description = "Changes with the draft"))),
        (status = 304, description = "Both versions are as they were"),
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
    let kept = compared.kept();
    if let Some(unchanged) = kept.unchanged(&headers) {
        return Ok(unchanged);
    }
    let difference = compared.difference(&state).await?;
    let draw = move || difference.to_png();
    let png = state.rendering.run(draw).await?;
    Ok(kept.answer("image/png", png.map_err(Problem::internal)?.into()))
}
