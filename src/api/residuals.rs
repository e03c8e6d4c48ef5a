//! The residual series of a route or of one of its sub-graphs.

use std::collections::BTreeMap;

use axum::Json;
use axum::extract::State;
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

use super::ApiState;
use super::extract::{ApiPath, ApiQuery};
use super::parameters::RouteParam;
use super::problem::Problem;
use super::problem_responses::RoutePartProblems;
use crate::change::series::{ClosureSample, ResidualSeries, SeriesEntry, residual_series};
use crate::change::{RESIDUAL_FALSE_ALARM_RATE, VehicleResidual, p_values_in_order};
use crate::graph::EdgeKind;
use crate::ids::{EdgeId, NodeId, RouteId, VehicleId};
use crate::model::{Detector, ResidualMeasurement, ResidualVerdict};
use crate::store::{AcceptedChange, EdgeRecord, NodeRecord};

/// A residual series.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = ResidualSeries)]
pub(super) struct ResidualSeriesBody {
    /// The sub-graph; null for the whole route.
    #[schema(required)]
    subgraph_id: Option<i64>,
    /// Which residuals.
    measurement: ResidualMeasurement,
    /// The n at which f settled; null before.
    #[schema(required)]
    converged_at: Option<u64>,
    /// σ² = f(n) at that n; null before.
    #[schema(required)]
    sigma2: Option<f64>,
    /// What ΔF is compared with; null before.
    #[schema(required)]
    threshold: Option<f64>,
    /// The smoothing looks ahead by this many closures: the last entries may still change.
    delay: u64,
    /// One a loop closure, in the order of insertion.
    entries: Vec<ResidualEntryBody>,
}

/// A loop closure in the series.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = ResidualEntry)]
struct ResidualEntryBody {
    /// 1, 2, …
    n: u64,
    /// The closure.
    edge_id: i64,
    /// F(n).
    total: f64,
    /// f(n) = F(n)/n.
    mean: f64,
    /// F(n) − F(n−1).
    delta_f: f64,
    /// The derivative of the smoothed F at n.
    smoothed: f64,
    /// What `delta_f` is compared with; null while warming up.
    #[schema(required)]
    threshold: Option<f64>,
    /// `delta_f` over the threshold; null while warming up.
    #[schema(required)]
    ratio: Option<f64>,
    /// Probability of a `delta_f` this large without a change.
    p_value: f64,
    /// Probability of an all-points residual this large without a change (of a closure that came as
    /// an edge: of such a `delta_f`), calibrated by the closures of its vehicle before it that were
    /// not told, those of the baseline up to `converged_at` among them; null where there are too
    /// few.
    #[schema(required)]
    calibrated_p_value: Option<f64>,
    /// Whether that is below 0.0001: so small a share of unchanged closures is flagged.
    alarm: bool,
    /// What the paper's rule says.
    verdict: ResidualVerdict,
}

/// Which series to send.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct ResidualQuery {
    /// Only the closures of this sub-graph.
    #[param(nullable = false)]
    subgraph_id: Option<i64>,
    /// Which residuals; `robust` if left out.
    #[param(nullable = false, inline)]
    measurement: Option<ResidualMeasurement>,
}

/// Read a residual series.
///
/// F, f and ΔF over the loop closures as the paper has them, with its threshold. Where a change of
/// the world was accepted, the closures made before it no longer count.
#[utoipa::path(
    get, path = "/v1/routes/{route}/residuals", tag = "residuals",
    params(RouteParam, ResidualQuery),
    responses((status = 200, description = "The series", body = ResidualSeriesBody), RoutePartProblems)
)]
pub(super) async fn get_residuals(
    State(state): State<ApiState>,
    ApiPath(route_id): ApiPath<RouteId>,
    ApiQuery(query): ApiQuery<ResidualQuery>,
) -> Result<Json<ResidualSeriesBody>, Problem> {
    let route = state.known_route(&route_id).await?;
    let edges = state.store.edges(&route_id).await?;
    let nodes = state.store.nodes(&route_id).await?;
    let accepted = state.store.accepted_changes(&route_id).await?;
    let (subgraph_id, measurement) = (query.subgraph_id, query.measurement.unwrap_or_default());
    let detector = route.settings.detector;
    let work = move || {
        let within = |edge: &&EdgeRecord| subgraph_id.is_none_or(|id| edge.subgraph_id == Some(id));
        let edges = || edges.iter().filter(within);
        let settled = robust_series(edges(), detector, &accepted).converged_at;
        let series = series(edges(), measurement, detector, &accepted);
        let tests = Tests::of(edges(), settled, &vehicles_of(&nodes), &accepted);
        (subgraph_id.is_none() || !series.entries.is_empty())
            .then(|| body(subgraph_id, measurement, &series, &tests))
    };
    let body = state.rendering.run(work).await?;
    body.map(Json)
        .ok_or_else(|| Problem::not_found("sub-graph with loop closures"))
}

/// Who drove each node's trip.
pub(super) fn vehicles_of(nodes: &[NodeRecord]) -> BTreeMap<NodeId, &VehicleId> {
    nodes.iter().map(|n| (n.id, &n.vehicle_id)).collect()
}

/// The calibrated test of closures' all-points residuals.
#[derive(Debug)]
struct Tests {
    p_values: BTreeMap<EdgeId, f64>,
}

impl Tests {
    /// Of a series that has settled after so many closures: those are the baseline, and of the
    /// later ones those that are not told. Before, all closures are.
    fn of<'a>(
        edges: impl Iterator<Item = &'a EdgeRecord>,
        settled: Option<usize>,
        vehicles: &BTreeMap<NodeId, &VehicleId>,
        accepted: &[AcceptedChange],
    ) -> Self {
        let closures = baseline(edges, accepted).filter_map(|edge| {
            let residual = VehicleResidual {
                vehicle: *vehicles.get(&edge.to)?,
                residual: match edge.closure {
                    Some(closure) => closure.all_points_residual,
                    None => edge.delta_f?,
                },
            };
            Some((edge.id, residual))
        });
        let (ids, residuals): (Vec<EdgeId>, Vec<_>) = closures.unzip();
        let baseline = settled.unwrap_or(residuals.len());
        let p_values = p_values_in_order(&residuals, baseline, RESIDUAL_FALSE_ALARM_RATE);
        let known = ids.into_iter().zip(p_values);
        Self {
            p_values: known.filter_map(|(id, p)| Some((id, p?))).collect(),
        }
    }
}

/// The series that says how settled a sub-graph is, as `robust` residuals tell it.
pub(super) fn robust_series<'a>(
    edges: impl Iterator<Item = &'a EdgeRecord>,
    detector: Detector,
    accepted: &[AcceptedChange],
) -> ResidualSeries {
    series(edges, ResidualMeasurement::Robust, detector, accepted)
}

/// A stretch of a sub-graph's series.
#[derive(Debug)]
pub(super) struct SeriesAround {
    /// The sub-graph; `None` for the whole route.
    pub subgraph_id: Option<i64>,
    /// What was read from the whole series, with the entries of the stretch alone.
    pub series: ResidualSeries,
    tests: Tests,
}

/// The series that a closure lies in, `reach` entries to each side of it; `None` if the edge is
/// no closure. A closure outside every sub-graph is shown in the series of the whole route.
pub(super) fn series_around(
    edges: &[EdgeRecord],
    vehicles: &BTreeMap<NodeId, &VehicleId>,
    edge: EdgeId,
    detector: Detector,
    accepted: &[AcceptedChange],
    reach: usize,
) -> Option<SeriesAround> {
    let found = edges.binary_search_by_key(&edge, |edge| edge.id).ok()?;
    let subgraph_id = edges.get(found)?.subgraph_id;
    let within = |other: &&EdgeRecord| subgraph_id.is_none() || other.subgraph_id == subgraph_id;
    let edges = || edges.iter().filter(within);
    let mut series = robust_series(edges(), detector, accepted);
    let settled = series.converged_at;
    let entries = &mut series.entries;
    let place = entries.iter().position(|entry| entry.edge_id == edge)?;
    entries.truncate(place + reach + 1);
    entries.drain(..place.saturating_sub(reach));
    Some(SeriesAround {
        subgraph_id,
        series,
        tests: Tests::of(edges(), settled, vehicles, accepted),
    })
}

fn series<'a>(
    edges: impl Iterator<Item = &'a EdgeRecord>,
    measurement: ResidualMeasurement,
    detector: Detector,
    accepted: &[AcceptedChange],
) -> ResidualSeries {
    let samples: Vec<ClosureSample> = baseline(edges, accepted)
        .filter_map(|edge| {
            Some(ClosureSample {
                edge_id: edge.id,
                delta_f: match measurement {
                    ResidualMeasurement::Robust => edge.delta_f?,
                    ResidualMeasurement::AllPoints => edge.closure?.all_points_residual,
                },
            })
        })
        .collect();
    residual_series(&samples, &detector.series_params())
}

/// The closures that accepted changes leave in the series.
fn baseline<'a>(
    edges: impl Iterator<Item = &'a EdgeRecord>,
    accepted: &[AcceptedChange],
) -> impl Iterator<Item = &'a EdgeRecord> {
    edges.filter(|edge| {
        let has_left = |a: &AcceptedChange| a.leaves_baseline(edge.id, edge.from, edge.to);
        edge.kind == EdgeKind::LoopClosure && !accepted.iter().any(has_left)
    })
}

impl From<&SeriesAround> for ResidualSeriesBody {
    fn from(around: &SeriesAround) -> Self {
        let robust = ResidualMeasurement::Robust;
        body(around.subgraph_id, robust, &around.series, &around.tests)
    }
}

fn body(
    subgraph_id: Option<i64>,
    measurement: ResidualMeasurement,
    series: &ResidualSeries,
    tests: &Tests,
) -> ResidualSeriesBody {
    let entry = |entry| ResidualEntryBody::of(entry, tests);
    ResidualSeriesBody {
        subgraph_id,
        measurement,
        converged_at: series.converged_at.map(|n| n as u64),
        sigma2: series.sigma2,
        threshold: series.threshold,
        delay: series.delay as u64,
        entries: series.entries.iter().map(entry).collect(),
    }
}

impl ResidualEntryBody {
    fn of(entry: &SeriesEntry, tests: &Tests) -> Self {
        let calibrated_p_value = tests.p_values.get(&entry.edge_id).copied();
        Self {
            calibrated_p_value,
            alarm: calibrated_p_value.is_some_and(|p| p < RESIDUAL_FALSE_ALARM_RATE),
            n: entry.n as u64,
            edge_id: entry.edge_id.0,
            total: entry.total,
            mean: entry.mean,
            delta_f: entry.delta_f,
            smoothed: entry.smoothed,
            threshold: entry.threshold,
            ratio: entry.ratio,
            p_value: entry.p_value,
            verdict: entry.verdict,
        }
    }
}
