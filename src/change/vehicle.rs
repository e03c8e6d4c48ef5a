//! Vehicles that are suspected: what is off, and which changes that explains.

use serde::{Deserialize, Serialize};

use super::region::region_round;
use super::{ChangeKind, Finding, Tier};
use crate::calibration::{Displacement, VehicleFault};
use crate::geometry::Vector2;
use crate::ids::{NodeId, StampNs, TripId, VehicleId};

/// Radius of the region that stands for where the vehicle was seen first, metres.
const REGION_RADIUS_M: f64 = 0.3;
/// What was silenced this near to each other and of one kind is one, metres.
const SAME_PLACE_M: f64 = 0.5;

/// A vehicle whose trips say that something is off.
#[derive(Debug, Clone, PartialEq)]
pub struct Suspect {
    /// Which vehicle.
    pub vehicle: VehicleId,
    /// What is off.
    pub faults: Vec<VehicleFault>,
    /// The trips that say so, ascending.
    pub trips: Vec<TripId>,
    /// Scans that they rest on.
    pub scans: usize,
    /// What the vehicle saw up to then was seen before; `None` if it was always so.
    pub sound_until: Option<StampNs>,
    /// Of the first trip that says so.
    pub since: StampNs,
    /// Of the last.
    pub last_seen: StampNs,
    /// From when on the vehicle is known anew; `None` while it is not.
    pub until: Option<StampNs>,
    /// Confirmed if two trips say so.
    pub tier: Tier,
    /// How many standard errors the plainest fault is away from none.
    pub significance: f64,
}

/// What a finding says of the vehicle that it suspects.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct SuspectEvidence {
    /// What is off.
    pub faults: Vec<VehicleFault>,
    /// The changes that this explains, which are not told for that.
    pub silenced: Vec<SilencedChange>,
}

/// A change that a fault of the only vehicle that saw it explains.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SilencedChange {
    /// What the change would have been.
    pub kind: ChangeKind,
    /// Its centre, map frame, metres, to the millimetre.
    pub at_m: [f64; 2],
    /// The first look that shows it.
    pub since: StampNs,
}

impl Suspect {
    /// How far its faults may put what the vehicle sees beside where it is.
    pub fn displacement(&self) -> Displacement {
        let faults = self.faults.iter().map(VehicleFault::displacement);
        faults.fold(Displacement::default(), Displacement::and)
    }

    /// The finding against the vehicle, seen first from a node at a place.
    pub fn finding(&self, first: NodeId, location: Vector2<f64>) -> Finding {
        Finding {
            kind: ChangeKind::VehicleSuspect,
            location,
            sigma_m: REGION_RADIUS_M,
            region: region_round(&[location], REGION_RADIUS_M),
            tier: self.tier,
            counterpart: None,
            shift: None,
            bands: Vec::new(),
            suspect: Some(SuspectEvidence {
                faults: self.faults.clone(),
                silenced: Vec::new(),
            }),
            edges: Vec::new(),
            nodes: vec![first],
            trips: self.trips.clone(),
            views: self.scans,
            laps: self.trips.len(),
            confidence: 1.0 - (-self.significance).exp(),
            since: self.since,
            last_seen: self.last_seen,
            until: self.until,
        }
    }
}

impl SilencedChange {
    /// Of a finding that is not told.
    pub fn of(finding: &Finding) -> Self {
        let to_millimetre = |value: f64| (1e3 * value).round() / 1e3;
        Self {
            kind: finding.kind,
            at_m: [finding.location.x, finding.location.y].map(to_millimetre),
            since: finding.since,
        }
    }

    /// Whether it tells of the same as another one.
    pub fn is_same(&self, other: &Self) -> bool {
        let [dx, dy] = [0, 1].map(|k| self.at_m[k] - other.at_m[k]);
        self.kind == other.kind && dx.hypot(dy) <= SAME_PLACE_M
    }
}

impl SuspectEvidence {
    /// Adds a change that was silenced, if none of that place is there.
    pub fn silence(&mut self, change: SilencedChange) {
        if !self.silenced.iter().any(|known| known.is_same(&change)) {
            self.silenced.push(change);
        }
    }

    /// Whether it has silenced a finding.
    pub fn has_silenced(&self, finding: &Finding) -> bool {
        let change = SilencedChange::of(finding);
        self.silenced.iter().any(|known| known.is_same(&change))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::change::testing::finding;

    #[test]
    fn a_place_is_silenced_once() {
        let mut evidence = SuspectEvidence::default();
        let at = |kind, x| SilencedChange::of(&finding(kind, [x, 1.0], 0.2, 100));
        for (kind, x) in [
            (ChangeKind::Appeared, 2.0),
            (ChangeKind::Appeared, 2.2),
            (ChangeKind::Disappeared, 2.0),
            (ChangeKind::Appeared, 3.0),
        ] {
            evidence.silence(at(kind, x));
        }
        assert_eq!(evidence.silenced.len(), 3);
        assert!(evidence.has_silenced(&finding(ChangeKind::Appeared, [2.1, 1.0], 0.2, 300)));
        assert!(!evidence.has_silenced(&finding(ChangeKind::Appeared, [4.0, 1.0], 0.2, 300)));
        let text = serde_json::to_string(&evidence).unwrap();
        assert_eq!(
            serde_json::from_str::<SuspectEvidence>(&text).unwrap(),
            evidence
        );
    }
}
