//! Evidence against a suspected vehicle: its faults, and the changes that they explain.

use serde::{Deserialize, Serialize};

use super::ChangeKind;
use crate::calibration::VehicleFault;
use crate::geometry::Vector2;
use crate::ids::StampNs;

/// Silenced changes of one kind this near to each other are one, metres.
const SAME_PLACE_M: f64 = 0.5;

/// The evidence against a vehicle.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct SuspectEvidence {
    /// Its faults.
    pub faults: Vec<VehicleFault>,
    /// The changes that these explain, which are therefore not reported.
    pub silenced: Vec<SilencedChange>,
}

/// A change that a fault of the only vehicle that saw it explains.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SilencedChange {
    /// What the change would have been.
    pub kind: ChangeKind,
    /// Its centre, map frame, metres, to the millimetre.
    pub at_m: [f64; 2],
    /// The first observation that shows it.
    pub since: StampNs,
}

impl SilencedChange {
    /// A change at a location of the map, first observed `since`.
    pub fn new(kind: ChangeKind, location: &Vector2<f64>, since: StampNs) -> Self {
        let to_millimetre = |value: f64| (1e3 * value).round() / 1e3;
        Self {
            kind,
            at_m: [location.x, location.y].map(to_millimetre),
            since,
        }
    }

    /// Whether it is the same change as another one.
    pub fn is_same(&self, other: &Self) -> bool {
        let [dx, dy] = [0, 1].map(|k| self.at_m[k] - other.at_m[k]);
        self.kind == other.kind && dx.hypot(dy) <= SAME_PLACE_M
    }
}

impl SuspectEvidence {
    /// Adds a silenced change, unless the same is there already.
    pub fn silence(&mut self, change: SilencedChange) {
        if !self.silenced.iter().any(|known| known.is_same(&change)) {
            self.silenced.push(change);
        }
    }

    /// Whether the same change was silenced.
    pub fn has_silenced(&self, change: &SilencedChange) -> bool {
        self.silenced.iter().any(|known| known.is_same(change))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::change::testing::finding;

    #[test]
    fn a_place_is_silenced_once() {
        let mut evidence = SuspectEvidence::default();
        let at = |kind, x| finding(kind, [x, 1.0], 0.2, 100).as_silenced();
        for (kind, x) in [
            (ChangeKind::Appeared, 2.0),
            (ChangeKind::Appeared, 2.2),
            (ChangeKind::Disappeared, 2.0),
            (ChangeKind::Appeared, 3.0),
        ] {
            evidence.silence(at(kind, x));
        }
        assert_eq!(evidence.silenced.len(), 3);
        assert!(evidence.has_silenced(&at(ChangeKind::Appeared, 2.1)));
        assert!(!evidence.has_silenced(&at(ChangeKind::Appeared, 4.0)));
        let text = serde_json::to_string(&evidence).unwrap();
        assert_eq!(
            serde_json::from_str::<SuspectEvidence>(&text).unwrap(),
            evidence
        );
    }
}
