//! Edges of a route's pose graph.

use axum::Json;
use axum::extract::State;
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

use super::ApiState;
use super::extract::{ApiPath, ApiQuery, NoQuery, PageQuery};
use super::paging::{Listed, Part, checked_limit, cut_page, key_of_cursor};
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
    /// What made it.
    kind: EdgeKind,
    /// Whether it is optimised.
    status: EdgeStatus,
    /// The upload it came with.
    batch_id: String,
    /// `from_from_to`, as optimised.
    measurement: PoseBody,
    /// Information matrix in the order (x, y, θ), upper triangle row by row, as in g2o.
    #[schema(min_items = 6, max_items = 6)]
    information: Vec<f64>,
    /// eᵀΩe at the current poses.
    residual: f64,
    /// What a loop closure added to the optimum F when it was inserted; null for odometry.
    #[schema(required)]
    delta_f: Option<f64>,
    /// The block of the graph it lies in; null for bridges.
    #[schema(required)]
    subgraph_id: Option<i64>,
    /// How two scans were matched; null for odometry, and for loop closures that came as edges.
    #[schema(required)]
    closure: Option<ClosureBody>,
}

/// What two matched scans say beside the estimate that is optimised.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Closure)]
struct ClosureBody {
    /// The all-points estimate of `from_from_to`; watched, never optimised in fused mode.
    all_points_measurement: PoseBody,
    /// Its information, as in `information`.
    #[schema(min_items = 6, max_items = 6)]
    all_points_information: Vec<f64>,
    /// eᵀΩe of the all-points estimate when the closure was inserted.
    all_points_residual: f64,
    /// Share of the points with a counterpart.
    overlap: f64,
    /// Share of the counterparts that agree.
    inlier_share: f64,
    /// Root mean square distance of the agreeing points, metres.
    rmse: f64,
}

/// A part of a route's list of edges.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct EdgePage {
    /// By id.
    items: Vec<EdgeBody>,
    /// Where the next part begins; null at the end.
    #[schema(required)]
    next_cursor: Option<String>,
}

impl Part for EdgePage {
    fn next_cursor(&self) -> Option<&str> {
        self.next_cursor.as_deref()
    }
}

/// Which edges to list.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct EdgeQuery {
    /// Only of this kind.
    #[param(nullable = false, inline)]
    kind: Option<EdgeKind>,
    /// Only in this state.
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
/// By id, in parts; by kind and status if wanted.
#[utoipa::path(
    get, path = "/v1/routes/{route}/edges", tag = "graph",
    params(RouteParam, EdgeQuery, PageQuery),
    responses((status = 200, description = "A part of the list", body = EdgePage), RouteProblems)
)]
pub(super) async fn list_edges(
    State(state): State<ApiState>,
    ApiPath(route_id): ApiPath<RouteId>,
    ApiQuery(query): ApiQuery<EdgeQuery>,
) -> Result<Listed<EdgePage>, Problem> {
    let limit = checked_limit(query.limit)?;
    let after: Option<i64> = key_of_cursor(query.cursor.as_deref())?;
    let filter = EdgeFilter {
        kind: query.kind,
        status: query.status,
    };
    let after = after.map(EdgeId);
    let edges = state.store.edge_page(&route_id, filter, after, limit + 1);
    let mut edges = edges.await?;
    let next_cursor = cut_page(&mut edges, limit, |edge| edge.id.to_string());
    Ok(Listed(EdgePage {
        items: edges.into_iter().map(EdgeBody::from).collect(),
        next_cursor,
    }))
}

/// Read an edge.
///
/// The measurement, how well it agrees with the map, and how its scans were matched.
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
