//! The paper's rule on the paper's graph.

use serde::Serialize;

use super::laps::Laps;
use super::mapped::{MadeClosure, Mapped};
use super::method::{Judged, raised_by};
use crate::change::paper::{PaperParams, paper_changes};
use crate::change::series::{ClosureSample, ResidualSeries, residual_series};
use crate::model::ResidualVerdict;

/// The series of a map of all-points estimates with Ω = I, at a multiple of th.
pub(super) fn series(mapped: &Mapped, factor: f64) -> ResidualSeries {
    let params = PaperParams::for_laps(&mapped.places(), factor);
    residual_series(&samples(mapped), &params.series)
}

fn samples(mapped: &Mapped) -> Vec<ClosureSample> {
    let sample = |made: &MadeClosure| ClosureSample {
        edge_id: made.closure.edge,
        delta_f: made.closure.delta_f,
    };
    mapped.closures.iter().map(sample).collect()
}

/// Steps 1 to 4 (section 4.2). A closure is flagged if its ΔF exceeds the threshold near a peak.
pub(super) fn judge(mapped: &Mapped, factor: f64) -> Judged {
    let places = mapped.places();
    let params = PaperParams::for_laps(&places, factor);
    let series = residual_series(&samples(mapped), &params.series);
    let changes = paper_changes(&series, &places, &params);
    let verdicts = || series.entries.iter().map(|entry| entry.verdict);
    Judged {
        scores: Some(series.entries.iter().map(|entry| entry.delta_f).collect()),
        judged: verdicts()
            .map(|v| v != ResidualVerdict::WarmingUp)
            .collect(),
        reported: verdicts()
            .map(|v| v == ResidualVerdict::Contradiction)
            .collect(),
        raised: changes
            .iter()
            .map(|change| raised_by(&mapped.closures[change.first.n - 1]))
            .collect(),
    }
}

/// The two columns of table 1 that are no rates, in units of th.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub(super) struct PaperColumns {
    /// The largest ΔF of the first changed lap, over its closures that show the change.
    pub changed: Option<f64>,
    /// The largest ΔF without any change.
    pub unchanged: Option<f64>,
}

/// ΔF where the world changed and where it did not.
pub(super) fn columns(laps: &Laps, mapped: &Mapped) -> PaperColumns {
    let series = series(mapped, 1.0);
    let mut columns = PaperColumns::default();
    for (entry, made) in series.entries.iter().zip(&mapped.closures) {
        let Some(ratio) = entry.ratio else {
            continue;
        };
        let shows = laps.changed_share(made.old, made.new) > 0.0;
        let side = match (shows, made.place.lap) {
            (true, lap) if lap == laps.before => &mut columns.changed,
            (false, lap) if lap < laps.before || laps.changes.is_empty() => &mut columns.unchanged,
            _ => continue,
        };
        *side = Some(side.map_or(ratio, |largest| largest.max(ratio)));
    }
    columns
}
