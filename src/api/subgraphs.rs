//! The detachable sub-graphs of a route: blocks that hold loop closures.

use axum::extract::State;
use serde::Serialize;
use utoipa::ToSchema;

use super::ApiState;
use super::extract::{ApiPath, ApiQuery, PageQuery};
use super::paging::{Listed, Part, checked_limit, cut_page, key_of_cursor};
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
struct SubgraphBody {
    /// Unique within the route.
    id: i64,
    /// Nodes in it.
    nodes: u64,
    /// Active edges in it.
    edges: u64,
    /// n: active loop closures in it.
    loop_closures: u64,
    /// F: eᵀΩe summed over its active edges at the current poses; of those whose nodes have left
    /// the active graph, as it was when they left.
    total: f64,
    /// f = F/n; null without loop closures.
    #[schema(required)]
    mean: Option<f64>,
    /// σ², once f has settled.
    #[schema(required)]
    sigma2: Option<f64>,
    /// The threshold on ΔF, once f has settled.
    #[schema(required)]
    threshold: Option<f64>,
    /// The n at which f settled.
    #[schema(required)]
    converged_at: Option<u64>,
}

/// A part of a route's list of sub-graphs.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct SubgraphPage {
    /// By id.
    items: Vec<SubgraphBody>,
    /// Where the next part begins; null at the end.
    #[schema(required)]
    next_cursor: Option<String>,
}

impl Part for SubgraphPage {
    fn next_cursor(&self) -> Option<&str> {
        self.next_cursor.as_deref()
    }
}

/// List a route's sub-graphs.
///
/// Each can be solved on its own and has its own F, f, σ² and threshold.
#[utoipa::path(
    get, path = "/v1/routes/{route}/subgraphs", tag = "residuals",
    params(RouteParam, PageQuery),
    responses((status = 200, description = "A part of the list", body = SubgraphPage), RouteProblems)
)]
pub(super) async fn list_subgraphs(
    State(state): State<ApiState>,
    ApiPath(route_id): ApiPath<RouteId>,
    ApiQuery(query): ApiQuery<PageQuery>,
) -> Result<Listed<SubgraphPage>, Problem> {
    let limit = checked_limit(query.limit)?;
    let after: Option<i64> = key_of_cursor(query.cursor.as_deref())?;
    let route = state.known_route(&route_id).await?;
    let sums = state.store.subgraph_sums(&route_id).await?;
    let accepted = state.store.accepted_changes(&route_id).await?;
    let detector = route.settings.detector;
    let residuals = Residuals::load(&state.store, &route_id, detector, accepted).await?;
    let wanted = sums
        .into_iter()
        .filter(move |(id, _)| after.is_none_or(|after| *id > after));
    let page = state.rendering.run(move || {
        let page = wanted.take(limit as usize + 1);
        let bodies = page.map(|(id, sums)| SubgraphBody::new(id, &sums, &residuals.settled(id)));
        bodies.collect::<Vec<_>>()
    });
    let mut items = page.await?;
    let next_cursor = cut_page(&mut items, limit, |item| item.id.to_string());
    Ok(Listed(SubgraphPage { items, next_cursor }))
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
