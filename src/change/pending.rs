//! A change that the map has not taken in.

use super::accepted::{ACCEPTED_MARGIN_M, AcceptedChange};
use super::{AlertStatus, Finding};
use crate::geometry::{Vector2, distance_to_polygon};
use crate::ids::StampNs;

/// A change of the world that nobody has accepted: inside its region the map shows what was there before,
/// whatever was observed since.
#[derive(Debug, Clone, PartialEq)]
pub struct PendingChange {
    /// A simple polygon, map frame, metres; the change reaches [`ACCEPTED_MARGIN_M`] beyond it.
    pub region: Vec<Vector2<f64>>,
    /// The first observation of the new state.
    pub since: StampNs,
    /// The first observation of the old state again; `None` while the new one stands.
    pub until: Option<StampNs>,
}

impl PendingChange {
    /// What an alert keeps out of the map: nothing if it is accepted, if it is no change of what is
    /// occupied, or if it was resolved without the old state being observed again.
    pub fn of(status: AlertStatus, evidence: &Finding) -> Option<Self> {
        let is_kept_out = match status {
            AlertStatus::Open | AlertStatus::Acknowledged | AlertStatus::Dismissed => true,
            AlertStatus::Resolved => evidence.until.is_some(),
            AlertStatus::Accepted => false,
        };
        (is_kept_out && evidence.kind.is_of_state()).then(|| Self {
            region: evidence.whole_region(),
            since: evidence.since,
            until: evidence.until,
        })
    }

    /// Whether what is observed at a point is kept out: it lies in the region or within
    /// [`ACCEPTED_MARGIN_M`] of it, and no change accepted there is as new.
    pub fn covers(&self, point: &Vector2<f64>, accepted: &[AcceptedChange]) -> bool {
        distance_to_polygon(point, &self.region) <= ACCEPTED_MARGIN_M
            && !accepted
                .iter()
                .any(|change| change.since >= self.since && change.covers(point))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::change::ChangeKind;
    use crate::change::testing::finding;
    use crate::ids::AlertId;

    #[test]
    fn what_is_accepted_refuted_or_no_change_is_not_kept_out() {
        let open = finding(ChangeKind::Appeared, [2.0, 1.0], 0.2, 100);
        let over = Finding {
            until: Some(StampNs(200)),
            ..open.clone()
        };
        let until = |status, evidence| PendingChange::of(status, evidence).map(|one| one.until);
        for status in [
            AlertStatus::Open,
            AlertStatus::Acknowledged,
            AlertStatus::Dismissed,
        ] {
            assert_eq!(until(status, &open), Some(None), "{status:?}");
        }
        assert_eq!(until(AlertStatus::Accepted, &open), None);
        assert_eq!(until(AlertStatus::Resolved, &open), None);
        assert_eq!(
            until(AlertStatus::Resolved, &over),
            Some(Some(StampNs(200)))
        );
        let mismatch = finding(ChangeKind::MapMismatch, [2.0, 1.0], 0.2, 100);
        assert_eq!(until(AlertStatus::Open, &mismatch), None);
    }

    #[test]
    fn a_newer_acceptance_counts_more() {
        let finding = finding(ChangeKind::Appeared, [2.0, 1.0], 0.2, 100);
        let pending = PendingChange::of(AlertStatus::Open, &finding).unwrap();
        let accepted = |after_ns| AcceptedChange {
            alert_id: AlertId(uuid::Uuid::nil()),
            region: pending.region.clone(),
            since: StampNs(finding.since.0 + after_ns),
            map_version: 2,
            nodes: Vec::new(),
            first_edge_id: crate::ids::EdgeId(1),
        };
        let middle = Vector2::new(2.0, 1.0);
        assert!(pending.covers(&middle, &[]));
        assert!(pending.covers(&middle, &[accepted(-1)]));
        assert!(!pending.covers(&middle, &[accepted(0)]));
        assert!(!pending.covers(&Vector2::new(4.0, 1.0), &[]));
    }
}
