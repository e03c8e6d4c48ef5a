//! Calibrations of a route's vehicles, trip by trip, and the corrections that follow from them.

use std::collections::BTreeMap;
use std::sync::Arc;

use anyhow::Context;

use crate::calibration::{
    AppliedCorrection, CalibratedTrip, Corrections, TRIPS_MAX, TripCorrections, VehicleCalibration,
};
use crate::geometry::Pose2;
use crate::ids::{LidarId, StampNs, TripId, VehicleId};
use crate::mapping::{Drive, DriveScan, Keyframe};
use crate::scan::{LaserScan, Lidar};
use crate::store::TripCalibrationRecord;

/// The newest trips' calibrations by vehicle and lidar, the oldest first, exactly as stored.
#[derive(Debug, Default)]
pub(super) struct Calibrations {
    by_lidar: BTreeMap<(VehicleId, Option<LidarId>), Vec<CalibratedTrip>>,
}

impl Calibrations {
    /// Calibrations from the store.
    pub fn of(records: Vec<TripCalibrationRecord>) -> Self {
        let mut all = Self::default();
        for record in records {
            let trip = record.own();
            let lidar = (record.vehicle_id, record.lidar);
            all.by_lidar.entry(lidar).or_default().push(trip);
        }
        all
    }

    /// Adds a calibration that is about to be stored, and replaces an earlier one of its trip. Numbers are
    /// rounded as by the store.
    ///
    /// # Errors
    /// If it has no JSON.
    pub fn put(&mut self, record: &TripCalibrationRecord) -> anyhow::Result<()> {
        let mut trip = record.own();
        let stored = serde_json::to_string(&trip.calibration);
        let stored = stored.context("a calibration cannot be written as JSON")?;
        trip.calibration = serde_json::from_str(&stored)?;
        let lidar = (record.vehicle_id.clone(), record.lidar.clone());
        let calibrations = self.by_lidar.entry(lidar).or_default();
        calibrations.retain(|other| other.trip != trip.trip);
        calibrations.push(trip);
        calibrations.sort_by(|a, b| (a.stamp, &a.trip).cmp(&(b.stamp, &b.trip)));
        calibrations.drain(..calibrations.len().saturating_sub(TRIPS_MAX));
        Ok(())
    }

    /// The newest of a vehicle's calibrated trips.
    pub fn newest_trip(&self, vehicle: &VehicleId) -> Option<&TripId> {
        let calibrations = self
            .lidars_of(vehicle)
            .filter_map(|(_, calibrations)| calibrations.last());
        let newest = calibrations.max_by(|a, b| (a.stamp, &a.trip).cmp(&(b.stamp, &b.trip)));
        Some(&newest?.trip)
    }

    /// Forgets the calibrations of some trips.
    pub fn forget(&mut self, trips: &[TripId]) {
        for calibrations in self.by_lidar.values_mut() {
            calibrations.retain(|trip| !trips.contains(&trip.trip));
        }
        self.by_lidar
            .retain(|_, calibrations| !calibrations.is_empty());
    }

    /// The lidars of a vehicle by name.
    pub fn lidars_of(
        &self,
        vehicle: &VehicleId,
    ) -> impl Iterator<Item = (Option<&LidarId>, &[CalibratedTrip])> {
        let from = (vehicle.clone(), None);
        let lidars = self.by_lidar.range(from..);
        let lidars = lidars.take_while(move |((of, _), _)| of == vehicle);
        lidars.map(|((_, lidar), calibrations)| (lidar.as_ref(), calibrations.as_slice()))
    }

    /// The vehicles with calibrated trips, by name.
    pub fn vehicles(&self) -> impl Iterator<Item = &VehicleId> {
        let mut last = None;
        let vehicles = self.by_lidar.keys().map(|(vehicle, _)| vehicle);
        vehicles.filter(move |vehicle| last.replace(*vehicle) != Some(*vehicle))
    }

    /// About how much memory it takes, bytes.
    pub fn size_bytes(&self) -> usize {
        CALIBRATION_BYTES * self.by_lidar.values().map(Vec::len).sum::<usize>()
    }

    /// What is corrected for a trip that begins now: all that its vehicle's trips up to now are sure
    /// of. `before` is what was corrected in the newest trip that has said something, and `primary`
    /// the lidar that says how the wheels err.
    pub fn corrections_for(
        &self,
        vehicle: &VehicleId,
        before: &TripCorrections,
        primary: Option<&LidarId>,
        begins: (&TripId, StampNs),
    ) -> TripCorrections {
        let lidars = self.lidars_of(vehicle);
        let of_lidars = lidars.flat_map(|(lidar, words)| {
            let sure = VehicleCalibration::of(words.to_vec()).sure().into_iter();
            sure.filter(move |(quantity, _)| !quantity.is_of_wheels() || lidar == primary)
                .map(move |(quantity, estimate)| {
                    let known = before.find(lidar, quantity).filter(|known| {
                        let apart = (known.estimate.value - estimate.value).abs();
                        apart < quantity.changed_min()
                    });
                    let since = match known {
                        Some(known) => (known.since_trip.clone(), known.since),
                        None => (begins.0.clone(), begins.1),
                    };
                    AppliedCorrection::new(lidar.cloned(), quantity, &estimate, since)
                })
        });
        TripCorrections::new(of_lidars.collect())
    }
}

/// Size of a trip's calibration of one lidar, bytes.
const CALIBRATION_BYTES: usize = 1_500;

/// The lidar that estimates the errors of the wheels: the vehicle's first.
pub(super) fn primary_of(drive: &Drive) -> Option<&LidarId> {
    let first = drive.scans.iter().min_by_key(|scan| scan.lidar.place);
    first.and_then(|scan| scan.lidar.name.as_ref())
}

/// The scans of a trip with corrected lidars. Odometry stays as sent; the corrections of the wheels are attached.
pub(super) fn corrected(drive: Drive, corrections: &TripCorrections) -> Drive {
    if corrections.applied().is_empty() {
        return drive;
    }
    let scans = drive.scans.into_iter().map(|scan| {
        let of_lidar = corrections.of_lidar(scan.lidar.name.as_ref());
        match corrected_scan(&scan.scan, &of_lidar) {
            Some(seen) => DriveScan { scan: seen, ..scan },
            // No valid lidar: its beams would cover more than a full turn.
            None => scan,
        }
    });
    Drive {
        scans: scans.collect(),
        wheels: corrections.of_wheels(),
        ..drive
    }
}

fn corrected_scan(scan: &LaserScan, corrections: &Corrections) -> Option<LaserScan> {
    if *corrections == Corrections::default() {
        return Some(scan.clone());
    }
    let lidar = corrections.lidar(scan.lidar(), scan.beam_count()).ok()?;
    corrections.scan(scan, &Arc::new(lidar)).ok()
}

/// A scan of the map as its vehicle stated it.
pub(super) fn as_stated(scan: &LaserScan, corrections: &Corrections) -> Option<LaserScan> {
    if *corrections == Corrections::default() {
        return Some(scan.clone());
    }
    let stated: Lidar = corrections
        .stated_lidar(scan.lidar(), scan.beam_count())
        .ok()?;
    LaserScan::from_ticks(Arc::new(stated), scan.ticks()).ok()
}

/// `base_from_stated`: the pose of the base by the stated mount of a keyframe's lidar, in the base by the
/// corrected mount. The identity where nothing is corrected.
pub(super) fn base_from_stated(
    keyframe: &Keyframe,
    corrections: &TripCorrections,
) -> Option<Pose2> {
    let of_lidar = corrections.of_lidar(keyframe.lidar.as_ref());
    if of_lidar == Corrections::default() {
        return Some(Pose2::IDENTITY);
    }
    let scan = keyframe.scan.as_ref()?;
    let corrected = scan.lidar();
    let stated = of_lidar.stated_lidar(corrected, scan.beam_count()).ok()?;
    Some(corrected.mount.compose(&stated.mount.inverse()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::{Estimate, Quantity, TripCalibration};

    fn record(
        vehicle: &str,
        lidar: Option<&str>,
        trip: usize,
        yaw_rad: f64,
    ) -> TripCalibrationRecord {
        let estimate = |value| Estimate {
            value,
            sigma: 0.0015,
        };
        let estimates = [
            (Quantity::MountYaw, estimate(yaw_rad)),
            (
                Quantity::WayScale,
                estimate(0.03 + 1e-4 / 3.0 * trip as f64),
            ),
        ];
        TripCalibrationRecord {
            trip_id: TripId::new(format!("{vehicle}-{trip}")).unwrap(),
            vehicle_id: VehicleId::new(vehicle).unwrap(),
            lidar: lidar.map(|name| LidarId::new(name).unwrap()),
            stamp: StampNs(trip as i64),
            scans: 150,
            calibration: TripCalibration {
                estimates: estimates.into(),
                ..TripCalibration::default()
            },
            beside_primary: None,
        }
    }

    fn decided(all: &Calibrations, before: &TripCorrections, at: i64) -> TripCorrections {
        let (vehicle, front) = (VehicleId::new("b").unwrap(), LidarId::new("front").unwrap());
        let trip = TripId::new(format!("new-{at}")).unwrap();
        all.corrections_for(&vehicle, before, Some(&front), (&trip, StampNs(at)))
    }

    #[test]
    fn a_vehicle_is_corrected_by_its_own_trips_since_the_first_that_was_sure() {
        let mut all = Calibrations::default();
        let mut before = TripCorrections::default();
        for trip in 0..6 {
            before = decided(&all, &before, trip);
            assert_eq!(before.applied().is_empty(), trip < 4, "{trip}");
            for vehicle in ["a", "b", "c"] {
                let yaw_rad = if vehicle == "b" { 0.03 } else { -0.2 };
                for lidar in ["front", "rear"] {
                    all.put(&record(vehicle, Some(lidar), trip as usize, yaw_rad))
                        .unwrap();
                }
            }
        }
        // The wheels are the vehicle's, and corrected once.
        let applied = before.applied().iter().map(|one| {
            let lidar = one.lidar.as_ref().unwrap().to_string();
            (lidar, one.quantity, one.since_trip.to_string())
        });
        let applied: Vec<_> = applied.collect();
        let expected = [
            ("front", Quantity::MountYaw),
            ("front", Quantity::WayScale),
            ("rear", Quantity::MountYaw),
        ];
        let expected = expected.map(|(l, q)| (l.to_owned(), q, "new-4".to_owned()));
        assert_eq!(applied, expected);
        assert!((before.applied()[0].estimate.value - 0.03).abs() < 1e-9);
        assert_eq!(
            all.newest_trip(&VehicleId::new("b").unwrap())
                .unwrap()
                .as_str(),
            "b-5"
        );
        // Knocked: nothing of the mount is corrected any more, the wheels are.
        all.put(&record("b", Some("front"), 6, -0.04)).unwrap();
        let after = decided(&all, &before, 7);
        let left: Vec<Quantity> = after.applied().iter().map(|one| one.quantity).collect();
        assert_eq!(left, [Quantity::WayScale, Quantity::MountYaw]);
        assert_eq!(after.applied()[0].since_trip.as_str(), "new-4");
    }

    #[test]
    fn calibrations_are_those_that_come_back_from_the_store() {
        let mut kept = Calibrations::default();
        let mut restored = Vec::new();
        for trip in 0..30 {
            let record = record("b", None, trip, 0.1 / (3.0 + trip as f64));
            kept.put(&record).unwrap();
            let text = serde_json::to_string(&record.calibration).unwrap();
            restored.push(TripCalibrationRecord {
                calibration: serde_json::from_str(&text).unwrap(),
                ..record
            });
        }
        let restored = Calibrations::of(restored.split_off(10));
        assert_eq!(kept.by_lidar, restored.by_lidar);
        assert_eq!(kept.vehicles().count(), 1);
    }

    #[test]
    fn what_is_corrected_goes_back_to_what_was_stated() {
        let lidar = Lidar {
            angle_min_rad: -2.0,
            angle_increment_rad: 0.02,
            range_min_m: 0.05,
            range_max_m: 10.0,
            mount: crate::geometry::Pose2::new(0.2, 0.1, 0.5),
            range_sigma_m: 0.01,
            band: None,
        };
        let ranges = (0..201).map(|beam| Some(1.0 + 0.01 * f64::from(beam)));
        let sent = LaserScan::new(Arc::new(lidar), ranges).unwrap();
        let corrections = Corrections::default()
            .with(Quantity::MountYaw, 0.03)
            .with(Quantity::MountX, -0.05)
            .with(Quantity::BeamSpacing, 0.02);
        let seen = corrected_scan(&sent, &corrections).unwrap();
        assert_ne!(seen.lidar(), sent.lidar());
        let back = as_stated(&seen, &corrections).unwrap();
        assert_eq!(back.ticks(), sent.ticks());
        let off = back.lidar().mount.between(&sent.lidar().mount).log();
        assert!(off.norm() < 1e-12);
        let none = Corrections::default();
        assert_eq!(corrected_scan(&sent, &none).unwrap(), sent);
    }
}
