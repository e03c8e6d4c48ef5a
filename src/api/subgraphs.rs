//! The detachable sub-graphs of a route: blocks that hold loop closures.

use std::collections::BTreeMap;

use axum::Json;
use axum::extract::State;
use serde::Serialize;
use utoipa::ToSchema;

use super::ApiState;
use super::extract::{ApiPath, ApiQuery, PageQuery};
use super::paging::{checked_limit, cut_page, key_of_cursor};
use super::parameters::RouteParam;
use super::problem::Problem;
use super::problem_responses::RouteProblems;
use super::residuals::robust_series;
use crate::change::series::ResidualSeries;
use crate::graph::{EdgeKind, EdgeStatus};
use crate::ids::RouteId;
use crate::model::Detector;
use crate::store::{AcceptedChange, EdgeRecord, NodeRecord};

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
    /// F: eᵀΩe summed over its active edges at the current poses.
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
) -> Result<Json<SubgraphPage>, Problem> {
    let limit = checked_limit(query.limit)?;
    let after: Option<i64> = key_of_cursor(query.cursor.as_deref())?;
    let route = state.known_route(&route_id).await?;
    let edges = state.store.edges(&route_id).await?;
    let nodes = state.store.nodes(&route_id).await?;
    let accepted = state.store.accepted_changes(&route_id).await?;
    let detector = route.settings.detector;
    let all = state
        .rendering
        .run(move || subgraphs(&nodes, &edges, detector, &accepted));
    let mut items = all.await?;
    items.retain(|item| after.is_none_or(|after| item.id > after));
    let next_cursor = cut_page(&mut items, limit, |item| item.id.to_string());
    Ok(Json(SubgraphPage { items, next_cursor }))
}

fn subgraphs(
    nodes: &[NodeRecord],
    edges: &[EdgeRecord],
    detector: Detector,
    accepted: &[AcceptedChange],
) -> Vec<SubgraphBody> {
    let mut members: BTreeMap<i64, (u64, Vec<&EdgeRecord>)> = BTreeMap::new();
    for node in nodes {
        if let Some(id) = node.subgraph_id {
            members.entry(id).or_default().0 += 1;
        }
    }
    for edge in edges {
        if let Some(id) = edge.subgraph_id {
            members.entry(id).or_default().1.push(edge);
        }
    }
    let bodies = members.into_iter().map(|(id, (nodes, edges))| {
        let series = robust_series(edges.iter().copied(), detector, accepted);
        body(id, nodes, &edges, &series)
    });
    bodies.collect()
}

fn body(id: i64, nodes: u64, edges: &[&EdgeRecord], series: &ResidualSeries) -> SubgraphBody {
    let active = || {
        edges
            .iter()
            .filter(|edge| edge.status == EdgeStatus::Active)
    };
    let closures = active().filter(|edge| edge.kind == EdgeKind::LoopClosure);
    let loop_closures = closures.count() as u64;
    let total: f64 = active().map(|edge| edge.residual).sum();
    SubgraphBody {
        id,
        nodes,
        edges: active().count() as u64,
        loop_closures,
        total,
        mean: (loop_closures > 0).then(|| total / loop_closures as f64),
        sigma2: series.sigma2,
        threshold: series.threshold,
        converged_at: series.converged_at.map(|n| n as u64),
    }
}
