//! Edges of a route's pose graph.

use axum::Json;
use axum::extract::State;
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

use super::ApiState;
use super::extract::{ApiPath, ApiQuery, NoQuery};
use super::paging::{Listed, PageQuery, Wanted, page};
use super::parameters::{EdgeParam, RouteParam};
use super::problem::Problem;
use super::problem_responses::{RoutePartProblems, RouteProblems};
use super::types::PoseBody;
use crate::ids::{EdgeId, RouteId};
use crate::model::{EdgeKind, EdgeStatus};
use crate::store::{ClosureRecord, EdgeFilter, EdgeRecord};

/// A measured motion between two nodes.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Edge)]
pub(super) struct EdgeBody {
    /// Unique within the route.
    id: i64,
    /// The older node.
    from: i64,
    /// The newer node.
    to: i64,
    /// How it was measured.
    kind: EdgeKind,
    /// Whether it takes part in the optimisation.
    status: EdgeStatus,
    /// The batch that it came with.
    batch_id: String,
    /// `from_from_to`, as optimised.
    measurement: PoseBody,
    /// Information matrix in the order (x, y, θ), upper triangle row by row, as in g2o.
    #[schema(min_items = 6, max_items = 6)]
    information: Vec<f64>,
    /// eᵀΩe at the current poses.
    residual: f64,
    /// The increase of the optimum F when the loop closure was inserted; null for odometry.
    #[schema(required)]
    delta_f: Option<f64>,
    /// The sub-graph that it belongs to; null for bridges.
    #[schema(required)]
    subgraph_id: Option<i64>,
    /// How two scans were matched; null for odometry and for uploaded loop closures.
    #[schema(required)]
    closure: Option<ClosureBody>,
}

/// The second estimate from two matched scans, and the quality of the match.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Closure)]
struct ClosureBody {
    /// The estimate of `from_from_to` from all points: monitored, but not optimised with detector `fused`.
    all_points_measurement: PoseBody,
    /// Its information matrix, in the form of `information`.
    #[schema(min_items = 6, max_items = 6)]
    all_points_information: Vec<f64>,
    /// eᵀΩe of the all-points estimate when the closure was inserted.
    all_points_residual: f64,
    /// Share of the points with a counterpart.
    overlap: f64,
    /// Share of these points that agree with their counterpart.
    inlier_share: f64,
    /// Root mean square distance of the agreeing points, metres.
    rmse: f64,
}

page! {
    /// A page of a route's list of edges.
    pub(super) struct EdgePage {
        /// By id.
        items: Vec<EdgeBody>,
    }
}

/// Which edges to list.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct EdgeQuery {
    /// Only edges of this kind.
    #[param(nullable = false, inline)]
    kind: Option<EdgeKind>,
    /// Only edges with this status.
    #[param(nullable = false, inline)]
    status: Option<EdgeStatus>,
    /// As `PageQuery` declares it.
    #[param(ignore)]
    limit: Option<u32>,
    /// As `PageQuery` declares it.
    #[param(ignore)]
    cursor: Option<String>,
}

impl From<ClosureRecord> for ClosureBody {
    fn from(closure: ClosureRecord) -> Self {
        Self {
            all_points_measurement: closure.all_points_measurement.into(),
            all_points_information: closure.all_points_information.upper().to_vec(),
            all_points_residual: closure.all_points_residual,
            overlap: closure.overlap,
            inlier_share: closure.inlier_share,
            rmse: closure.rmse_m,
        }
    }
}

impl From<EdgeRecord> for EdgeBody {
    fn from(edge: EdgeRecord) -> Self {
        Self {
            id: edge.id.0,
            from: edge.from.0,
            to: edge.to.0,
            kind: edge.kind,
            status: edge.status,
            batch_id: edge.batch_id.to_string(),
            measurement: edge.measurement.into(),
            information: edge.information.upper().to_vec(),
            residual: edge.residual,
            delta_f: edge.delta_f,
            subgraph_id: edge.subgraph_id,
            closure: edge.closure.map(ClosureBody::from),
        }
    }
}

/// List a route's edges.
///
/// By id; optionally only those of a kind or a status.
#[utoipa::path(
    get, path = "/v1/routes/{route}/edges", tag = "graph",
    params(RouteParam, EdgeQuery, PageQuery),
    responses((status = 200, description = "A page of the list", body = EdgePage), RouteProblems)
)]
pub(super) async fn list_edges(
    State(state): State<ApiState>,
    ApiPath(route_id): ApiPath<RouteId>,
    ApiQuery(query): ApiQuery<EdgeQuery>,
) -> Result<Listed<EdgePage>, Problem> {
    let wanted: Wanted<i64> = Wanted::checked(query.limit, query.cursor.as_deref())?;
    let filter = EdgeFilter {
        kind: query.kind,
        status: query.status,
    };
    let after = wanted.after.map(EdgeId);
    let edges = state
        .store
        .edge_page(&route_id, filter, after, wanted.to_read());
    Ok(wanted.page(edges.await?, |edge| edge.id, EdgeBody::from))
}

/// Read an edge.
///
/// The measurement, its residual in the map, and how its scans were matched.
#[utoipa::path(
    get, path = "/v1/routes/{route}/edges/{edge}", tag = "graph",
    params(RouteParam, EdgeParam),
    responses((status = 200, description = "The edge", body = EdgeBody), RoutePartProblems)
)]
pub(super) async fn get_edge(
    State(state): State<ApiState>,
    ApiPath((route_id, id)): ApiPath<(RouteId, EdgeId)>,
    _: NoQuery,
) -> Result<Json<EdgeBody>, Problem> {
    let edge = state.store.edge(&route_id, id).await?;
    Ok(Json(edge.ok_or_else(|| Problem::not_found("edge"))?.into()))
}
