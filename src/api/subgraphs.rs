//! The sub-graphs of a route: blocks of its pose graph that contain loop closures.

use axum::extract::State;
use serde::Serialize;
use utoipa::ToSchema;

use super::ApiState;
use super::extract::{ApiPath, ApiQuery};
use super::paging::{Listed, PageQuery, page};
use super::parameters::RouteParam;
use super::problem::Problem;
use super::problem_responses::RouteProblems;
use crate::change::series::ResidualSeries;
use crate::ids::RouteId;
use crate::pipeline::Residuals;
use crate::store::SubgraphSums;

/// A block of the pose graph with its own statistics.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Subgraph)]
pub(super) struct SubgraphBody {
    /// Unique within the route.
    id: i64,
    /// Nodes in it.
    nodes: u64,
    /// Active edges in it.
    edges: u64,
    /// n, its active loop closures.
    loop_closures: u64,
    /// F: the sum of eᵀΩe over its active edges at the current poses; edges whose nodes were archived count with
    /// their residual at that time.
    total: f64,
    /// f = F/n; null without loop closures.
    #[schema(required)]
    mean: Option<f64>,
    /// σ²; null until f has converged.
    #[schema(required)]
    sigma2: Option<f64>,
    /// The threshold on ΔF; null until f has converged.
    #[schema(required)]
    threshold: Option<f64>,
    /// The n at which f converged; null until then.
    #[schema(required)]
    converged_at: Option<u64>,
}

page! {
    /// A page of a route's list of sub-graphs.
    pub(super) struct SubgraphPage {
        /// By id.
        items: Vec<SubgraphBody>,
    }
}

/// List a route's sub-graphs.
///
/// Each can be optimised by itself and has its own F, f, σ² and threshold.
#[utoipa::path(
    get, path = "/v1/routes/{route}/subgraphs", tag = "residuals",
    params(RouteParam, PageQuery),
    responses((status = 200, description = "A page of the list", body = SubgraphPage), RouteProblems)
)]
pub(super) async fn list_subgraphs(
    State(state): State<ApiState>,
    ApiPath(route_id): ApiPath<RouteId>,
    ApiQuery(query): ApiQuery<PageQuery>,
) -> Result<Listed<SubgraphPage>, Problem> {
    let wanted = query.wanted::<i64>()?;
    let route = state.known_route(&route_id).await?;
    let sums = state.store.subgraph_sums(&route_id).await?;
    let accepted = state.store.accepted_changes(&route_id).await?;
    let detector = route.settings.detector;
    let residuals = Residuals::load(&state.store, &route_id, detector, accepted).await?;
    let after = wanted.after.unwrap_or(i64::MIN);
    let following = sums.into_iter().filter(move |(id, _)| *id > after);
    let following = following.take(wanted.to_read() as usize);
    let bodies = state.rendering.run(move || {
        let bodies =
            following.map(|(id, sums)| SubgraphBody::new(id, &sums, &residuals.settled(id)));
        bodies.collect::<Vec<_>>()
    });
    Ok(wanted.page(bodies.await?, |body| body.id, |body| body))
}

impl SubgraphBody {
    fn new(id: i64, sums: &SubgraphSums, series: &ResidualSeries) -> Self {
        let loop_closures = sums.loop_closures.max(0).unsigned_abs();
        Self {
            id,
            nodes: sums.nodes.max(0).unsigned_abs(),
            edges: sums.edges.max(0).unsigned_abs(),
            loop_closures,
            total: sums.total,
            mean: (loop_closures > 0).then(|| sums.total / loop_closures as f64),
            sigma2: series.sigma2,
            threshold: series.threshold,
            converged_at: series.converged_at.map(|n| n as u64),
        }
    }
}
