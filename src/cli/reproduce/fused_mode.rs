//! What the service tells, from the same map.

use super::laps::Laps;
use super::mapped::{MadeClosure, Mapped};
use super::method::{Judged, Raised};
use crate::change::Detector;
use crate::change::series::{ClosureSample, residual_series};

/// A closure is told if a residual this large has a smaller probability without a change.
const FALSE_ALARM_RATE: f64 = 1e-3;

/// The all-points residuals of a map of robust estimates, closure by closure, and what the
/// service raises.
pub(super) fn judge(mapped: &Mapped, laps: &Laps) -> Judged {
    let sample = |made: &MadeClosure| ClosureSample {
        edge_id: made.closure.edge,
        delta_f: made.closure.all_points_residual,
    };
    let samples: Vec<ClosureSample> = mapped.closures.iter().map(sample).collect();
    let series = residual_series(&samples, &Detector::Fused.series_params());
    let scores = samples.iter().map(|sample| sample.delta_f).collect();
    let told = series.entries.iter().map(|e| e.p_value < FALSE_ALARM_RATE);
    let judged = Judged::by_closure(mapped, Some(scores), told.collect());
    Judged {
        raised: findings(mapped, laps, &judged),
        ..judged
    }
}

/// What the service raises for this map.
fn findings(_mapped: &Mapped, _laps: &Laps, by_residual: &Judged) -> Vec<Raised> {
    by_residual.raised.clone()
}
