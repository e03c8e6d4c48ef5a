//! What is corrected while a vehicle drives one trip.

use serde::{Deserialize, Serialize};

use super::vehicle_fault::rounded;
use super::{Corrections, Estimate, Quantity};
use crate::ids::{LidarId, StampNs, TripId};

/// A correction that is in force for a trip.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct AppliedCorrection {
    /// The lidar whose trips say it; `None` for the vehicle's only one.
    pub lidar: Option<LidarId>,
    /// What is corrected.
    pub quantity: Quantity,
    /// By how much; its value is rounded so that it comes back from JSON to the bit.
    pub estimate: Estimate,
    /// The vehicle's first trip of those that it has been corrected in without a break …
    pub since_trip: TripId,
    /// … and when that trip's first scan was taken.
    pub since: StampNs,
}

/// The corrections of a vehicle for one trip: decided when the trip begins, and the same to its end.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(transparent)]
pub struct TripCorrections {
    applied: Vec<AppliedCorrection>,
}

impl AppliedCorrection {
    /// Of an estimate, which is rounded to a millionth of its unit.
    pub fn new(
        lidar: Option<LidarId>,
        quantity: Quantity,
        estimate: &Estimate,
        (since_trip, since): (TripId, StampNs),
    ) -> Self {
        Self {
            lidar,
            quantity,
            estimate: rounded(estimate),
            since_trip,
            since,
        }
    }
}

impl TripCorrections {
    /// No quantity of a lidar more than once.
    pub fn new(applied: Vec<AppliedCorrection>) -> Self {
        Self { applied }
    }

    /// All of them.
    pub fn applied(&self) -> &[AppliedCorrection] {
        &self.applied
    }

    /// The one of a quantity by a lidar.
    pub fn find(&self, lidar: Option<&LidarId>, quantity: Quantity) -> Option<&AppliedCorrection> {
        let mut applied = self.applied.iter();
        applied.find(|one| one.lidar.as_ref() == lidar && one.quantity == quantity)
    }

    /// Of a lidar's mount and beams.
    pub fn of_lidar(&self, lidar: Option<&LidarId>) -> Corrections {
        let of_lidar = self.applied.iter();
        Self::values(
            of_lidar.filter(|one| one.lidar.as_ref() == lidar && !one.quantity.is_of_wheels()),
        )
    }

    /// Of the wheels, which a vehicle has once.
    pub fn of_wheels(&self) -> Corrections {
        Self::values(
            self.applied
                .iter()
                .filter(|one| one.quantity.is_of_wheels()),
        )
    }

    fn values<'a>(applied: impl Iterator<Item = &'a AppliedCorrection>) -> Corrections {
        applied.fold(Corrections::default(), |corrections, one| {
            corrections.with(one.quantity, one.estimate.value)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn applied(lidar: Option<&str>, quantity: Quantity, value: f64) -> AppliedCorrection {
        let lidar = lidar.map(|name| LidarId::new(name).unwrap());
        let estimate = Estimate { value, sigma: 1e-3 };
        let since = (TripId::new("monday").unwrap(), StampNs(5));
        AppliedCorrection::new(lidar, quantity, &estimate, since)
    }

    #[test]
    fn each_lidar_has_its_own_and_the_vehicle_one_set_of_wheels() {
        let corrections = TripCorrections::new(vec![
            applied(Some("front"), Quantity::MountYaw, 0.1),
            applied(Some("front"), Quantity::WayScale, 0.01),
            applied(Some("rear"), Quantity::MountYaw, -0.2),
        ]);
        let front = LidarId::new("front").unwrap();
        let of_front = corrections.of_lidar(Some(&front));
        assert_eq!(
            of_front,
            Corrections::default().with(Quantity::MountYaw, 0.1)
        );
        assert_eq!(corrections.of_lidar(None), Corrections::default());
        let wheels = Corrections::default().with(Quantity::WayScale, 0.01);
        assert_eq!(corrections.of_wheels(), wheels);
        assert!(corrections.find(None, Quantity::MountYaw).is_none());
        let found = corrections.find(Some(&front), Quantity::MountYaw);
        assert_eq!(found.unwrap().estimate.value, 0.1);
    }

    proptest! {
        #[test]
        fn they_come_back_from_json_to_the_bit(value in -2.0..2.0_f64, sigma in 0.0..1.0_f64) {
            let mut one = applied(None, Quantity::BeamSpacing, value);
            one = AppliedCorrection::new(
                None, one.quantity, &Estimate { value, sigma }, (one.since_trip, one.since),
            );
            let corrections = TripCorrections::new(vec![one]);
            let text = serde_json::to_string(&corrections).unwrap();
            let back: TripCorrections = serde_json::from_str(&text).unwrap();
            let bits = |c: &TripCorrections| c.applied()[0].estimate.value.to_bits();
            prop_assert_eq!(bits(&back), bits(&corrections));
            prop_assert_eq!(back, corrections);
        }
    }
}
