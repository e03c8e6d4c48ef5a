//! The service's detector, on the same map.

use super::mapped::{MadeClosure, Mapped};
use super::method::{Judged, LAPS_LEARNT, Raised, Reported};
use crate::change::{Finding, VehicleResidual, calibrated_p_values, separate_counterparts};

/// A closure is flagged if a residual this large has a smaller probability without a change.
const FALSE_ALARM_RATE: f64 = 1e-3;
/// A finding this near to an earlier one of its kind is that one again, metres.
const SAME_FINDING_M: f64 = 0.5;

/// Closures by their all-points residuals at the optimum of robust estimates; alerts by the
/// service's findings.
pub(super) fn judge(mapped: &Mapped) -> Judged {
    let of_closure = |made: &MadeClosure| VehicleResidual {
        vehicle: (),
        residual: made.closure.all_points_residual,
    };
    let residuals: Vec<VehicleResidual<()>> = mapped.closures.iter().map(of_closure).collect();
    let scores = residuals.iter().map(|r| r.residual).collect();
    let p_values = calibrated_p_values(&residuals).into_iter();
    let reported = p_values.map(|p_value| p_value.is_some_and(|p| p < FALSE_ALARM_RATE));
    let judged = Judged::by_closure(mapped, Some(scores), reported.collect());
    Judged {
        raised: alerts(&mapped.findings),
        ..judged
    }
}

/// Every finding of an object in the lap that raises it, even if later laps withdraw it; both sides of what
/// was moved.
fn alerts(findings: &[Vec<Finding>]) -> Vec<Raised> {
    let mut known: Vec<Finding> = Vec::new();
    let mut raised = Vec::new();
    for (lap, findings) in findings.iter().enumerate().skip(LAPS_LEARNT) {
        let sides = separate_counterparts(findings.clone());
        for finding in sides.into_iter().filter(|f| f.kind.is_of_state()) {
            let same = |known: &Finding| {
                known.kind == finding.kind
                    && (known.location - finding.location).norm() <= SAME_FINDING_M
            };
            if !known.iter().any(same) {
                raised.push(Raised {
                    lap,
                    what: Reported::Region {
                        kind: finding.kind,
                        location: finding.location,
                        region: finding.region.clone(),
                    },
                });
                known.push(finding);
            }
        }
    }
    raised
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::change::{ChangeKind, Counterpart, Tier, region_round};
    use crate::geometry::Vector2;
    use crate::ids::StampNs;

    fn finding(kind: ChangeKind, x: f64) -> Finding {
        Finding {
            tier: Tier::Confirmed,
            counterpart: None,
            shift: None,
            suspect: None,
            bands: Vec::new(),
            kind,
            location: Vector2::new(x, 0.0),
            sigma_m: 0.02,
            region: Vec::new(),
            edges: Vec::new(),
            nodes: Vec::new(),
            trips: Vec::new(),
            views: 4,
            laps: 1,
            confidence: 0.99,
            since: StampNs(0),
            last_seen: StampNs(0),
            until: None,
        }
    }

    #[test]
    fn a_finding_is_raised_once_and_counts_though_it_is_taken_back() {
        let appeared = |x| finding(ChangeKind::Appeared, x);
        let by_lap = [
            vec![appeared(40.0)],
            vec![],
            vec![appeared(0.0)],
            vec![appeared(0.3), finding(ChangeKind::Disappeared, 0.0)],
            vec![appeared(9.0)],
        ];
        let laps: Vec<usize> = alerts(&by_lap).iter().map(|raised| raised.lap).collect();
        assert_eq!(laps, [2, 3, 4]);
    }

    #[test]
    fn what_was_moved_is_raised_at_both_places() {
        let mut moved = finding(ChangeKind::Appeared, 1.0);
        moved.counterpart = Some(Counterpart {
            kind: ChangeKind::Disappeared,
            region: region_round(&[Vector2::new(0.0, 0.0)], 0.2),
        });
        let raised = alerts(&[vec![], vec![], vec![moved]]);
        let kinds = raised.iter().map(|raised| match &raised.what {
            Reported::Region { kind, .. } => Some(*kind),
            Reported::Closure { .. } => None,
        });
        let expected = [ChangeKind::Appeared, ChangeKind::Disappeared].map(Some);
        assert!(kinds.eq(expected));
    }
}
