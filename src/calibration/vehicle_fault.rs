//! What of a vehicle makes it suspect, and what it does to what its lidar sees.

use serde::{Deserialize, Serialize};

use super::{Change, Estimate, Quantity};
use crate::ids::LidarId;

/// Half the fan of a lidar whose beams are not as far apart as stated, radians: at its border they
/// are off by so many times the error of the spacing.
const HALF_FAN_RAD: f64 = 2.36;

/// A fault of a vehicle, as an alert reports it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct VehicleFault {
    /// The lidar whose scans say it; `None` for the vehicle's only one.
    pub lidar: Option<LidarId>,
    /// What is off; `None` for a fault that no quantity describes.
    pub quantity: Option<Quantity>,
    /// What held before, of a change.
    pub before: Option<Estimate>,
    /// What the trips since say. Where they differ from trip to trip, their mean and their standard
    /// deviation.
    pub now: Option<Estimate>,
    /// The same for people.
    pub text: String,
}

/// How far a fault may put what is seen beside where it is.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Displacement {
    /// At any range, metres.
    pub offset_m: f64,
    /// For each metre of range, metres.
    pub per_metre: f64,
}

impl VehicleFault {
    /// Of a value that changed.
    pub fn changed(lidar: Option<LidarId>, change: &Change) -> Self {
        let (before, now) = (rounded(&change.before), rounded(&change.now));
        let quantity = change.quantity;
        Self {
            lidar,
            quantity: Some(quantity),
            text: format!(
                "{} changed from {} to {}",
                quantity.subject(),
                quantity.with_unit(&before),
                quantity.with_unit(&now)
            ),
            before: Some(before),
            now: Some(now),
        }
    }

    /// Of a value that is far off, and another one in each trip.
    pub fn unsteady(lidar: Option<LidarId>, quantity: Quantity, now: &Estimate) -> Self {
        let now = rounded(now);
        Self {
            lidar,
            quantity: Some(quantity),
            before: None,
            text: format!(
                "{} is far off and differs from trip to trip, by {}, so that it is not corrected",
                quantity.subject(),
                quantity.with_unit(&now)
            ),
            now: Some(now),
        }
    }

    /// Of a value that is off, always alike, and not corrected.
    pub fn uncorrected(lidar: Option<LidarId>, quantity: Quantity, now: &Estimate) -> Self {
        let now = rounded(now);
        Self {
            lidar,
            quantity: Some(quantity),
            before: None,
            text: format!(
                "{} is off by {}, which is not corrected: it should be stated as it is",
                quantity.subject(),
                quantity.with_unit(&now)
            ),
            now: Some(now),
        }
    }

    /// Of something that no correction mends.
    pub fn uncorrectable(lidar: Option<LidarId>, text: &str) -> Self {
        Self {
            lidar,
            quantity: None,
            before: None,
            now: None,
            text: text.to_owned(),
        }
    }

    /// Where it puts what is seen: as far as the vehicle is off, or was corrected by mistake.
    pub fn displacement(&self) -> Displacement {
        let off = match (&self.before, &self.now) {
            (Some(before), Some(now)) => now.value.abs().max((now.value - before.value).abs()),
            (None, Some(unsteady)) => unsteady.value.abs() + unsteady.sigma,
            (_, None) => 0.0,
        };
        let at_any_range = |offset_m| Displacement {
            offset_m,
            per_metre: 0.0,
        };
        let per_metre = |per_metre| Displacement {
            offset_m: 0.0,
            per_metre,
        };
        match self.quantity {
            Some(Quantity::MountX | Quantity::MountY) => at_any_range(off),
            Some(Quantity::MountYaw | Quantity::RangeScale) => per_metre(off),
            Some(Quantity::BeamSpacing) => per_metre(HALF_FAN_RAD * off),
            // Scans are matched with scans: wheels move nothing that is seen.
            Some(
                Quantity::WayScale
                | Quantity::TurnScale
                | Quantity::TurnPerMetre
                | Quantity::ClockOffset,
            )
            | None => Displacement::default(),
        }
    }
}

impl Displacement {
    /// The farthest that it puts something at a range, metres.
    pub fn at_range_m(&self, range_m: f64) -> f64 {
        self.offset_m + self.per_metre * range_m
    }

    /// Of two faults together.
    #[must_use]
    pub fn and(self, other: Self) -> Self {
        Self {
            offset_m: self.offset_m + other.offset_m,
            per_metre: self.per_metre + other.per_metre,
        }
    }
}

/// To a millionth, so that it comes back from JSON to the bit.
pub(super) fn rounded(estimate: &Estimate) -> Estimate {
    let rounded = |value: f64| (value * 1e6).round() / 1e6;
    Estimate {
        value: rounded(estimate.value),
        sigma: rounded(estimate.sigma),
    }
}

impl Quantity {
    fn subject(self) -> &'static str {
        match self {
            Self::MountYaw => "the turn of the lidar on its mount",
            Self::MountX => "how far the lidar sits ahead of its stated mount",
            Self::MountY => "how far the lidar sits to the left of its stated mount",
            Self::WayScale => "the scale of ways by wheels",
            Self::TurnScale => "the scale of turns by wheels",
            Self::TurnPerMetre => "the turn that wheels miss for each metre",
            Self::ClockOffset => "the offset of the clock",
            Self::BeamSpacing => "the spacing of the beams",
            Self::RangeScale => "the scale of the ranges",
        }
    }

    /// A value with its unit, as people read it.
    fn with_unit(self, estimate: &Estimate) -> String {
        let Estimate { value, sigma } = *estimate;
        match self {
            Self::MountYaw => format!("{:.2} ± {:.2}°", value.to_degrees(), sigma.to_degrees()),
            Self::MountX | Self::MountY => format!("{value:.3} ± {sigma:.3} m"),
            Self::TurnPerMetre => format!("{value:.4} ± {sigma:.4} rad/m"),
            Self::ClockOffset => format!("{value:.3} ± {sigma:.3} s"),
            Self::WayScale | Self::TurnScale | Self::BeamSpacing | Self::RangeScale => {
                format!("{:.2} ± {:.2} %", 100.0 * value, 100.0 * sigma)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fault_displaces_what_it_can_and_says_so() {
        let estimate = |value, sigma| Estimate { value, sigma };
        let change = |quantity, before, now| Change {
            quantity,
            before: estimate(before, 0.001),
            now: estimate(now, 0.001),
            trips: vec![4],
            last_before: 3,
            is_confirmed: false,
            known_anew: None,
        };
        let turned = VehicleFault::changed(None, &change(Quantity::MountYaw, -0.01, 0.05));
        assert!((turned.displacement().at_range_m(5.0) - 0.3).abs() < 1e-9);
        assert_eq!(
            turned.text,
            "the turn of the lidar on its mount changed from -0.57 ± 0.06° to 2.86 ± 0.06°"
        );
        let moved = VehicleFault::changed(None, &change(Quantity::MountX, 0.0, 0.1));
        assert_eq!(moved.displacement().at_range_m(9.0), 0.1);
        let both = moved.displacement().and(turned.displacement());
        assert!((both.at_range_m(5.0) - 0.4).abs() < 1e-9);
        let wheels = VehicleFault::changed(None, &change(Quantity::WayScale, 0.0, 0.1));
        assert_eq!(wheels.displacement(), Displacement::default());
        let slips = VehicleFault::uncorrectable(None, "wheels slip");
        assert_eq!(slips.displacement().at_range_m(9.0), 0.0);
        let text = serde_json::to_string(&turned).unwrap();
        assert_eq!(serde_json::from_str::<VehicleFault>(&text).unwrap(), turned);
    }
}
