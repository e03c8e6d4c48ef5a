//! The residual series of a route or of one of its sub-graphs.

use axum::Json;
use axum::extract::State;
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

use super::ApiState;
use super::extract::{ApiPath, ApiQuery};
use super::parameters::RouteParam;
use super::problem::Problem;
use super::problem_responses::RoutePartProblems;
use crate::change::RESIDUAL_FALSE_ALARM_RATE;
use crate::change::series::SeriesEntry;
use crate::ids::RouteId;
use crate::model::{ResidualMeasurement, ResidualVerdict};
use crate::pipeline::{ResidualReading, Residuals};

/// Most entries that a request may ask for.
const POINTS_MAX: u32 = 100_000;

/// A residual series.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = ResidualSeries)]
pub(super) struct ResidualSeriesBody {
    /// The sub-graph; null for the whole route.
    #[schema(required)]
    subgraph_id: Option<i64>,
    /// Which residuals the series has.
    measurement: ResidualMeasurement,
    /// The n at which f converged; null until then.
    #[schema(required)]
    converged_at: Option<u64>,
    /// σ² = f(n) at that n; null until then.
    #[schema(required)]
    sigma2: Option<f64>,
    /// The threshold on ΔF; null until then.
    #[schema(required)]
    threshold: Option<f64>,
    /// How many later closures the smoothing uses: the last entries may still change.
    delay: u64,
    /// One for each loop closure, in the order of insertion. On a route with a long history, closures in the
    /// middle are left out: those that are neither between active nodes nor among the first 1,000 archived ones.
    entries: Vec<ResidualEntryBody>,
}

/// A loop closure in the series.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = ResidualEntry)]
struct ResidualEntryBody {
    /// 1, 2, … over all closures, including those left out.
    n: u64,
    /// The loop closure.
    edge_id: i64,
    /// F(n).
    total: f64,
    /// f(n) = F(n)/n.
    mean: f64,
    /// F(n) − F(n−1).
    delta_f: f64,
    /// The derivative of the smoothed F at n.
    smoothed: f64,
    /// The threshold on `delta_f`; null until the series has converged.
    #[schema(required)]
    threshold: Option<f64>,
    /// `delta_f` divided by the threshold; null until the series has converged.
    #[schema(required)]
    ratio: Option<f64>,
    /// The probability of a `delta_f` this large without a change.
    p_value: f64,
    /// The probability of an all-points residual this large without a change (for an uploaded closure, of such a
    /// `delta_f`), calibrated with the vehicle's earlier closures that were not flagged, including those up to
    /// `converged_at`; null if there are too few.
    #[schema(required)]
    calibrated_p_value: Option<f64>,
    /// Whether `calibrated_p_value` is below 0.0001, the share of unchanged closures that is flagged.
    alarm: bool,
    /// The verdict of the paper's rule.
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
    /// Which residuals to send; `robust` by default.
    #[param(nullable = false, inline)]
    measurement: Option<ResidualMeasurement>,
    /// The most entries to send: the series is divided into this many equal parts, and each is represented by its
    /// entry with the largest `delta_f`. All entries by default.
    #[param(minimum = 1, maximum = 100000, nullable = false)]
    max_points: Option<u32>,
}

/// Read a residual series.
///
/// F, f and ΔF over the loop closures, with the threshold, as defined in the paper. Once a change of the world is
/// accepted, older closures at its place no longer count.
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
    let max_points = query.max_points.map(checked_points).transpose()?;
    let route = state.known_route(&route_id).await?;
    let accepted = state.store.accepted_changes(&route_id).await?;
    let detector = route.settings.detector;
    let residuals = Residuals::load(&state.store, &route_id, detector, accepted).await?;
    let subgraph_id = query.subgraph_id;
    let measurement = query.measurement.unwrap_or_default();
    let work = move || {
        let mut reading = residuals.read(subgraph_id, measurement);
        let is_there = subgraph_id.is_none() || !reading.series.entries.is_empty();
        if let Some(max_points) = max_points {
            thin(&mut reading.series.entries, max_points);
        }
        is_there.then(|| ResidualSeriesBody::from(&reading))
    };
    let body = state.rendering.run(work).await?;
    body.map(Json)
        .ok_or_else(|| Problem::not_found("sub-graph with loop closures"))
}

fn checked_points(points: u32) -> Result<usize, Problem> {
    if (1..=POINTS_MAX).contains(&points) {
        return Ok(points as usize);
    }
    let refusal = format!("max_points is a number from 1 to {POINTS_MAX}");
    Err(Problem::parameter("max_points", refusal))
}

/// Keeps the entry with the largest ΔF of each of this many equal parts of a series.
fn thin(entries: &mut Vec<SeriesEntry>, points: usize) {
    let count = entries.len();
    if count <= points {
        return;
    }
    let part = |k: usize| &entries[k * count / points..(k + 1) * count / points];
    let largest = |part: &[SeriesEntry]| {
        part.iter()
            .copied()
            .max_by(|a, b| a.delta_f.total_cmp(&b.delta_f))
    };
    *entries = (0..points).filter_map(|k| largest(part(k))).collect();
}

impl From<&ResidualReading> for ResidualSeriesBody {
    fn from(reading: &ResidualReading) -> Self {
        let series = &reading.series;
        let entry = |entry| ResidualEntryBody::of(entry, reading);
        Self {
            subgraph_id: reading.subgraph_id,
            measurement: reading.measurement,
            converged_at: series.converged_at.map(|n| n as u64),
            sigma2: series.sigma2,
            threshold: series.threshold,
            delay: series.delay as u64,
            entries: series.entries.iter().map(entry).collect(),
        }
    }
}

impl ResidualEntryBody {
    fn of(entry: &SeriesEntry, reading: &ResidualReading) -> Self {
        let calibrated_p_value = reading.p_values.get(&entry.edge_id).copied();
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::change::series::{ClosureSample, SeriesParams, residual_series};
    use crate::ids::EdgeId;

    #[test]
    fn a_thinned_series_keeps_its_order_and_its_peaks() {
        let samples: Vec<ClosureSample> = (0..1_000)
            .map(|k| ClosureSample {
                edge_id: EdgeId(k),
                delta_f: if k == 617 { 9.0 } else { (k % 7) as f64 },
            })
            .collect();
        let all = residual_series(&samples, &SeriesParams::default()).entries;
        for points in [1, 2, 7, 300, 999, 1_000, 5_000] {
            let mut entries = all.clone();
            thin(&mut entries, points);
            assert_eq!(entries.len(), points.min(1_000));
            assert!(entries.is_sorted_by_key(|entry| entry.n), "{points}");
            assert!(entries.iter().any(|entry| entry.delta_f == 9.0), "{points}");
        }
        assert!(checked_points(0).is_err());
        assert!(checked_points(POINTS_MAX + 1).is_err());
    }
}
