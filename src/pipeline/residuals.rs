//! A route's residual series for the API: from the same closures and by the same rule as the pipeline's own.

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

/// The residual of a closure by a measurement.
fn residual_of(measurement: ResidualMeasurement, closure: &SeriesClosure) -> Option<f64> {
    match measurement {
        ResidualMeasurement::Robust => Some(closure.delta_f),
        ResidualMeasurement::AllPoints => closure.all_points_residual,
    }
}

/// The number and the sum of closures in some sums.
fn sum_of(measurement: ResidualMeasurement, sums: &SubgraphSums) -> LeftOut {
    let (closures, total) = match measurement {
        ResidualMeasurement::Robust => (sums.closures, sums.delta_f),
        ResidualMeasurement::AllPoints => (sums.scan_closures, sums.all_points),
    };
    LeftOut {
        closures: usize::try_from(closures).unwrap_or(0),
        total,
    }
}

/// Closures that count in a series without being entries.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct LeftOut {
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
    /// The series. Archived closures that are not entries count in `n`, `total` and `mean` of the entries after
    /// them.
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
    /// Loads the closures. At the places of `accepted` changes, closures made before the acceptance do not count.
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

    /// The series of a sub-graph, or of the whole route. Of archived closures only the first
    /// [`crate::store::ARCHIVED_CLOSURES_MAX`] of the route are entries.
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
        self.add_left_out(subgraph_id, measurement, &mut series);
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

    /// A sub-graph's robust series over its entries alone, without the archived closures that are not entries.
    pub fn settled(&self, subgraph_id: i64) -> ResidualSeries {
        self.series(Some(subgraph_id), ResidualMeasurement::Robust)
    }

    /// The closures in the baseline of a sub-graph.
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

    /// The p-values of the closures. The first `converged_at` of them are the baseline, to which later ones are
    /// added unless flagged; all are, if the series has not converged.
    fn p_values(
        &self,
        subgraph_id: Option<i64>,
        converged_at: Option<usize>,
    ) -> BTreeMap<EdgeId, f64> {
        let closures: Vec<&SeriesClosure> = self.counted(subgraph_id).collect();
        let residuals: Vec<VehicleResidual<&VehicleId>> = closures
            .iter()
            .map(|closure| VehicleResidual {
                vehicle: &closure.vehicle_id,
                residual: closure.all_points_residual.unwrap_or(closure.delta_f),
            })
            .collect();
        let baseline = converged_at.unwrap_or(residuals.len());
        let p_values = p_values_in_order(&residuals, baseline, RESIDUAL_FALSE_ALARM_RATE);
        let known = closures.iter().zip(p_values);
        known
            .filter_map(|(closure, p_value)| Some((closure.id, p_value?)))
            .collect()
    }

    /// Adds the archived closures that are not entries to the sums of the entries after them.
    fn add_left_out(
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

    /// The archived closures that are not entries, and the last archived entry before them.
    fn left_out(
        &self,
        subgraph_id: Option<i64>,
        measurement: ResidualMeasurement,
    ) -> Option<(EdgeId, LeftOut)> {
        let sums = self.closures.archive.iter();
        let sums = sums.filter(|(id, _)| subgraph_id.is_none() || **id == subgraph_id);
        let all = sums.map(|(_, sums)| sum_of(measurement, sums));
        let all = all.fold(LeftOut::default(), |a, b| LeftOut {
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
        Some((last, LeftOut { closures, total }))
    }
}

fn is_within(closure: &SeriesClosure, subgraph_id: Option<i64>) -> bool {
    subgraph_id.is_none() || closure.subgraph_id == subgraph_id
}
