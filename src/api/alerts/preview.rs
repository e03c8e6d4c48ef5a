//! What accepting an alert would change.

use axum::Json;
use axum::extract::State;
use serde::Serialize;
use utoipa::ToSchema;

use super::body::corners;
use super::decisions::refused;
use crate::api::ApiState;
use crate::api::extract::{ApiPath, NoQuery};
use crate::api::parameters::AlertParam;
use crate::api::problem::Problem;
use crate::api::problem_responses::PreviewProblems;
use crate::ids::AlertId;
use crate::model::AlertAction;
use crate::pipeline::Preview;
use crate::render::DifferingCells;

/// Edges named in the answer.
const EDGES_MAX: usize = 100;

/// What accepting an alert would change.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = AlertPreview)]
pub(in crate::api) struct PreviewBody {
    /// The alert.
    #[schema(format = "uuid")]
    alert_id: String,
    /// The decision revision of the alert that was previewed: send it with the decision.
    decision_revision: i64,
    /// The version of the map that would begin.
    map_version_next: i64,
    /// How many cells of the map would change.
    cells: CellChangesBody,
    /// Edge of a cell, metres.
    resolution_m: f64,
    /// How many loop closures would be retired.
    edges_retired: usize,
    /// The first 100 of them.
    edge_ids: Vec<i64>,
    /// Nodes that would become reference keyframes, or cease to be.
    nodes_handed_over: usize,
    /// The largest displacement of a node, metres.
    max_displacement_m: f64,
    /// Archived nodes that accepting would reactivate first. Unless this is 0, `cells`, `nodes_handed_over` and
    /// `max_displacement_m` are approximate.
    nodes_reactivated: usize,
    /// The alert's region.
    #[schema(value_type = Vec<Vec<f64>>)]
    region: Vec<[f64; 2]>,
}

/// Cells that would change, by their new state.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = CellChanges)]
struct CellChangesBody {
    /// Occupied cells that would become free.
    to_free: u64,
    /// Free cells that would become occupied.
    to_occupied: u64,
    /// Free or occupied cells that would become unknown.
    to_unknown: u64,
    /// Unknown cells that would become free or occupied.
    from_unknown: u64,
}

impl From<DifferingCells> for CellChangesBody {
    fn from(cells: DifferingCells) -> Self {
        Self {
            to_free: cells.to_free,
            to_occupied: cells.to_occupied,
            to_unknown: cells.to_unknown,
            from_unknown: cells.from_unknown,
        }
    }
}

impl From<Preview> for PreviewBody {
    fn from(preview: Preview) -> Self {
        let edges = preview.edges_retired.iter().take(EDGES_MAX);
        Self {
            alert_id: preview.alert.id.to_string(),
            decision_revision: preview.alert.decision_revision,
            map_version_next: preview.map_version_next,
            cells: preview.cells.into(),
            resolution_m: preview.resolution_m,
            edges_retired: preview.edges_retired.len(),
            edge_ids: edges.map(|edge| edge.0).collect(),
            nodes_handed_over: preview.nodes_handed_over,
            max_displacement_m: preview.max_displacement_m,
            nodes_reactivated: preview.nodes_reactivated,
            region: corners(&preview.alert.evidence.region),
        }
    }
}

/// Preview an acceptance.
///
/// What accepting the alert would change now, computed in the same way but without changing anything. Waits
/// for the batch that the route is processing, and takes as long as accepting.
#[utoipa::path(
    get, path = "/v1/alerts/{alert}/preview", tag = "alerts",
    params(AlertParam),
    responses((status = 200, description = "What would change", body = PreviewBody), PreviewProblems)
)]
pub(in crate::api) async fn preview_alert(
    State(state): State<ApiState>,
    ApiPath(id): ApiPath<AlertId>,
    _: NoQuery,
) -> Result<Json<PreviewBody>, Problem> {
    let preview = state.decisions.preview(id).await;
    let preview = preview.map_err(|error| refused(error, AlertAction::Accept))?;
    Ok(Json(preview.into()))
}
