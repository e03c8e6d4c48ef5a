//! A route's residual series as people read them: from the closures that the pipeline's own series
//! are read from, and by the same rule.

use std::collections::BTreeMap;

use crate::change::series::{ClosureSample, ResidualSeries, residual_series};
use crate::change::{
    RESIDUAL_FALSE_ALARM_RATE, VehicleResidual, is_in_baseline, p_values_in_order,
};
use crate::ids::{EdgeId, RouteId, VehicleId};
use crate::model::{Detector, ResidualMeasurement};
use crate::store::{
    AcceptedChange, SeriesClosure, SeriesClosures, Store, StoreError, SubgraphSums,
};

/// What of a closure a measurement takes.
fn residual_of(measurement: ResidualMeasurement, closure: &SeriesClosure) -> Option<f64> {
    match measurement {
        ResidualMeasurement::Robust => Some(closure.delta_f),
        ResidualMeasurement::AllPoints => closure.all_points_residual,
    }
}

/// How many closures sums hold, and what these add up to.
fn sum_of(measurement: ResidualMeasurement, sums: &SubgraphSums) -> Left {
    let (closures, total) = match measurement {
        ResidualMeasurement::Robust => (sums.closures, sums.delta_f),
        ResidualMeasurement::AllPoints => (sums.scan_closures, sums.all_points),
    };
    Left {
        closures: usize::try_from(closures).unwrap_or(0),
        total,
    }
}

/// Closures that are counted in a series and not shown in it.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Left {
    closures: usize,
    total: f64,
}

/// A residual series with the calibrated test of its closures.
#[derive(Debug)]
pub struct ResidualReading {
    /// The sub-graph; `None` for the whole route.
    pub subgraph_id: Option<i64>,
    /// Which residuals.
    pub measurement: ResidualMeasurement,
    /// The series. Where closures have left the active graph that it does not show, `n`, `total`
    /// and `mean` of the entries after them count them.
    pub series: ResidualSeries,
    /// The probability of an all-points residual this large without a change (of a closure that
    /// came as an edge: of such a ΔF), calibrated by the closures of its vehicle before it.
    pub p_values: BTreeMap<EdgeId, f64>,
}

/// The closures of a route's residual series.
#[derive(Debug)]
pub struct Residuals {
    closures: SeriesClosures,
    accepted: Vec<AcceptedChange>,
    detector: Detector,
}

impl Residuals {
    /// The closures as they stand now; where one of `accepted` changes was taken in, those made
    /// before it do not count.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn load(
        store: &Store,
        route: &RouteId,
        detector: Detector,
        accepted: Vec<AcceptedChange>,
    ) -> Result<Self, StoreError> {
        Ok(Self {
            closures: store.series_closures(route).await?,
            accepted,
            detector,
        })
    }

    /// The series of a sub-graph, or of the whole route. Of closures that have left the active
    /// graph only the first [`crate::store::SETTLED_CLOSURES_MAX`] of the route are entries.
    pub fn read(
        &self,
        subgraph_id: Option<i64>,
        measurement: ResidualMeasurement,
    ) -> ResidualReading {
        let robust = self.series(subgraph_id, ResidualMeasurement::Robust);
        let baseline = robust.converged_at;
        let mut series = match measurement {
            ResidualMeasurement::Robust => robust,
            ResidualMeasurement::AllPoints => self.series(subgraph_id, measurement),
        };
        self.count_what_left(subgraph_id, measurement, &mut series);
        ResidualReading {
            subgraph_id,
            measurement,
            series,
            p_values: self.p_values(subgraph_id, baseline),
        }
    }

    /// The robust series around a closure, `reach` entries to each side of it: of its sub-graph, or
    /// of the whole route if it lies in none. `None` if it is not among the entries.
    pub fn around(&self, edge: EdgeId, reach: usize) -> Option<ResidualReading> {
        let closures = &self.closures.closures;
        let found = closures.binary_search_by_key(&edge, |closure| closure.id);
        let subgraph_id = closures.get(found.ok()?)?.subgraph_id;
        let mut reading = self.read(subgraph_id, ResidualMeasurement::Robust);
        let entries = &mut reading.series.entries;
        let place = entries.iter().position(|entry| entry.edge_id == edge)?;
        entries.truncate(place + reach + 1);
        entries.drain(..place.saturating_sub(reach));
        Some(reading)
    }

    /// What a sub-graph's robust series has settled at: its entries count only what they show.
    pub fn settled(&self, subgraph_id: i64) -> ResidualSeries {
        self.series(Some(subgraph_id), ResidualMeasurement::Robust)
    }

    /// The closures of a sub-graph that its baseline counts.
    fn counted(&self, subgraph_id: Option<i64>) -> impl Iterator<Item = &SeriesClosure> {
        self.closures.closures.iter().filter(move |closure| {
            is_within(closure, subgraph_id)
                && is_in_baseline(&self.accepted, closure.id, [closure.from, closure.to])
        })
    }

    fn series(&self, subgraph_id: Option<i64>, measurement: ResidualMeasurement) -> ResidualSeries {
        let samples = self.counted(subgraph_id).filter_map(|closure| {
            Some(ClosureSample {
                edge_id: closure.id,
                delta_f: residual_of(measurement, closure)?,
            })
        });
        let samples: Vec<ClosureSample> = samples.collect();
        residual_series(&samples, &self.detector.series_params())
    }

    /// Of a series that has settled after so many closures those are the baseline, and of the later
    /// ones those that are not flagged; before, all are.
    fn p_values(&self, subgraph_id: Option<i64>, settled: Option<usize>) -> BTreeMap<EdgeId, f64> {
        let closures: Vec<&SeriesClosure> = self.counted(subgraph_id).collect();
        let residuals: Vec<VehicleResidual<&VehicleId>> = closures
            .iter()
            .map(|closure| VehicleResidual {
                vehicle: &closure.vehicle_id,
                residual: closure.all_points_residual.unwrap_or(closure.delta_f),
            })
            .collect();
        let baseline = settled.unwrap_or(residuals.len());
        let p_values = p_values_in_order(&residuals, baseline, RESIDUAL_FALSE_ALARM_RATE);
        let known = closures.iter().zip(p_values);
        known
            .filter_map(|(closure, p_value)| Some((closure.id, p_value?)))
            .collect()
    }

    /// Counts what has left and is not shown at the place where it is left out.
    fn count_what_left(
        &self,
        subgraph_id: Option<i64>,
        measurement: ResidualMeasurement,
        series: &mut ResidualSeries,
    ) {
        let Some((after, left)) = self.left_out(subgraph_id, measurement) else {
            return;
        };
        for entry in series.entries.iter_mut().filter(|e| e.edge_id > after) {
            entry.n += left.closures;
            entry.total += left.total;
            entry.mean = entry.total / entry.n as f64;
        }
    }

    /// The closures that are not shown, and the last one before them.
    fn left_out(
        &self,
        subgraph_id: Option<i64>,
        measurement: ResidualMeasurement,
    ) -> Option<(EdgeId, Left)> {
        let sums = self.closures.archive.iter();
        let sums = sums.filter(|(id, _)| subgraph_id.is_none() || **id == subgraph_id);
        let all = sums.map(|(_, sums)| sum_of(measurement, sums));
        let all = all.fold(Left::default(), |a, b| Left {
            closures: a.closures + b.closures,
            total: a.total + b.total,
        });
        let archived = self.closures.closures.iter().filter(|c| c.archived);
        let last = archived.clone().map(|closure| closure.id).max()?;
        let shown = archived.filter(|closure| is_within(closure, subgraph_id));
        let shown: Vec<f64> = shown
            .filter_map(|closure| residual_of(measurement, closure))
            .collect();
        let shown_total: f64 = shown.iter().map(|value| value.max(0.0)).sum();
        let closures = all.closures.checked_sub(shown.len()).filter(|n| *n > 0)?;
        let total = (all.total - shown_total).max(0.0);
        Some((last, Left { closures, total }))
    }
}

fn is_within(closure: &SeriesClosure, subgraph_id: Option<i64>) -> bool {
    subgraph_id.is_none() || closure.subgraph_id == subgraph_id
}
