//! What the service tells, from the same map.

use super::mapped::{MadeClosure, Mapped};
use super::method::{Judged, LAPS_LEARNT, Raised, Told};
use crate::change::series::{ClosureSample, residual_series};
use crate::change::{Detector, Finding};

/// A closure is told if a residual this large has a smaller probability without a change.
const FALSE_ALARM_RATE: f64 = 1e-3;
/// A finding this near to an earlier one of its kind is that one again, metres.
const SAME_FINDING_M: f64 = 0.5;

/// Closures by their all-points residuals at the optimum of robust estimates; alerts by the
/// service's findings.
pub(super) fn judge(mapped: &Mapped) -> Judged {
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
        raised: alerts(&mapped.findings),
        ..judged
    }
}

/// Every finding in the lap that raises it, those too that later laps take back.
fn alerts(findings: &[Vec<Finding>]) -> Vec<Raised> {
    let mut known: Vec<&Finding> = Vec::new();
    let mut raised = Vec::new();
    for (lap, findings) in findings.iter().enumerate().skip(LAPS_LEARNT) {
        for finding in findings {
            let same = |known: &&Finding| {
                known.kind == finding.kind
                    && (known.location - finding.location).norm() <= SAME_FINDING_M
            };
            if !known.iter().any(same) {
                known.push(finding);
                raised.push(Raised {
                    lap,
                    what: Told::Region {
                        kind: finding.kind,
                        location: finding.location,
                        region: finding.region.clone(),
                    },
                });
            }
        }
    }
    raised
}
