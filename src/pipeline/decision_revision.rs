//! The revision of an alert that a decision is bound to.
//!
//! A decision is about a status, a tier and a region. Every pass adds evidence and raises an alert's
//! revision; decisions bound to that would be refused whenever a vehicle passes.

use crate::geometry::{Vector2, distance_to_polygon};
use crate::store::AlertRecord;

/// Regions differ if a corner of one is farther than this from the other, metres: less than what would
/// change a decision, more than what further evidence moves a border by.
const TOLERANCE_M: f64 = 0.25;

/// Raises the decision revision if status, tier or region differ from the alert before; a new alert has 1.
pub(super) fn count(before: Option<&AlertRecord>, alert: &mut AlertRecord) {
    let kept = before.filter(|before| is_same(before, alert));
    (alert.decision_revision, alert.decision_region) = match (kept, before) {
        (Some(kept), _) => (kept.decision_revision, kept.decision_region.clone()),
        (None, Some(before)) => (before.decision_revision + 1, alert.evidence.region.clone()),
        (None, None) => (1, alert.evidence.region.clone()),
    };
}

fn is_same(before: &AlertRecord, alert: &AlertRecord) -> bool {
    before.status == alert.status
        && before.evidence.tier == alert.evidence.tier
        && farthest_m(&before.decision_region, &alert.evidence.region) <= TOLERANCE_M
}

/// The largest distance of a corner of one polygon from the other, metres.
fn farthest_m(a: &[Vector2<f64>], b: &[Vector2<f64>]) -> f64 {
    let from_a = a.iter().map(|corner| distance_to_polygon(corner, b));
    let from_b = b.iter().map(|corner| distance_to_polygon(corner, a));
    from_a.chain(from_b).fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square(x_m: f64, side_m: f64) -> Vec<Vector2<f64>> {
        [[0.0, 0.0], [side_m, 0.0], [side_m, side_m], [0.0, side_m]]
            .map(|[x, y]| Vector2::new(x_m + x, y))
            .to_vec()
    }

    #[test]
    fn a_region_is_another_one_once_a_corner_is_far_off() {
        assert_eq!(farthest_m(&square(0.0, 1.0), &square(0.0, 1.0)), 0.0);
        assert_eq!(farthest_m(&square(0.0, 1.0), &square(0.5, 1.0)), 0.5);
        let grown = farthest_m(&square(0.0, 1.0), &square(0.0, 2.0));
        assert!((grown - 2_f64.sqrt()).abs() < 1e-12, "{grown}");
        assert_eq!(grown, farthest_m(&square(0.0, 2.0), &square(0.0, 1.0)));
        assert_eq!(farthest_m(&[], &[]), 0.0);
    }
}
