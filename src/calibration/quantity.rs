//! What can be wrong with a vehicle in every scan and every motion alike.

use crate::model::Quantity;

/// How well a quantity can be known, and must be.
struct Limits {
    /// Standard deviation of what is known without any drive.
    prior: f64,
    /// An estimate with a larger standard deviation is none.
    known: f64,
    /// An estimate with a larger standard deviation is not applied …
    applied: f64,
    /// … and a value below this is not worth it. It is also more than what shared errors of scans
    /// that nobody models make of a sound vehicle.
    worth: f64,
    /// Errors of the model, which more drives do not reduce, as a standard deviation.
    floor: f64,
}

/// What has changed, and what is far off, over what is worth a correction.
const CHANGED_OVER_APPLIED: f64 = 2.0;
const FAR_OVER_APPLIED: f64 = 4.0;

impl Quantity {
    /// How many of them, the first of [`Quantity::ALL`], motions show.
    pub(super) const BY_MOTIONS: usize = 7;

    /// Whether it is one of the wheels; all others but the clock are of a lidar.
    pub fn is_of_wheels(self) -> bool {
        matches!(self, Self::WayScale | Self::TurnScale | Self::TurnPerMetre)
    }

    fn limits(self) -> Limits {
        let (prior, known, applied, worth, floor) = match self {
            Self::MountYaw => (0.5, 0.035, 0.01, 0.0087, 0.0012),
            Self::MountX | Self::MountY => (0.5, 0.1, 0.02, 0.03, 0.005),
            Self::WayScale => (0.3, 0.05, 0.01, 0.01, 0.0015),
            Self::TurnScale => (0.3, 0.1, 0.02, 0.02, 0.004),
            Self::TurnPerMetre => (0.1, 0.01, 0.003, 0.002, 0.0002),
            Self::ClockOffset => (0.5, 0.1, 0.03, 0.03, 0.003),
            Self::BeamSpacing => (0.2, 0.05, 0.012, 0.01, 0.006),
            Self::RangeScale => (0.2, 0.05, 0.01, 0.01, 0.001),
        };
        Limits {
            prior,
            known,
            applied,
            worth,
            floor,
        }
    }

    /// Standard deviation of what is known without any drive, in the quantity's unit.
    pub(super) fn prior(self) -> f64 {
        self.limits().prior
    }

    /// Standard deviation from which on an estimate says nothing, in the quantity's unit.
    pub fn known_sigma_max(self) -> f64 {
        self.limits().known
    }

    /// Largest standard deviation of a value that is applied, in the quantity's unit.
    pub fn applied_sigma_max(self) -> f64 {
        self.limits().applied
    }

    /// Least size of a value that is applied, in the quantity's unit.
    pub fn applied_min(self) -> f64 {
        self.limits().worth
    }

    /// Least size of a change from trip to trip that is one, in the quantity's unit.
    pub fn changed_min(self) -> f64 {
        CHANGED_OVER_APPLIED * self.limits().worth
    }

    /// A value of this size that cannot be corrected is a fault, in the quantity's unit.
    pub fn far_min(self) -> f64 {
        FAR_OVER_APPLIED * self.limits().worth
    }

    /// Whether the map corrects it where it is sure. Not the clock: each trip's own scans show how far
    /// it is off. Nor the beam spacing: what a vehicle's earlier trips saw is in the map, bent, and
    /// scans that are straight fit it nowhere. Nor the range scale: a sound vehicle that meets only
    /// scans of one that is off is as sure of the opposite error.
    pub fn is_corrected(self) -> bool {
        self.is_of_vehicle() && !matches!(self, Self::BeamSpacing | Self::RangeScale)
    }

    /// Whether trips together show it of a vehicle: not the clock, which each trip measures for
    /// itself.
    pub fn is_of_vehicle(self) -> bool {
        self != Self::ClockOffset
    }

    /// Standard deviation that no number of drives goes below, in the quantity's unit.
    pub fn floor(self) -> f64 {
        self.limits().floor
    }
}
