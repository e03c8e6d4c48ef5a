//! What a trip says of its vehicle: asked once it has driven enough, and once more when it has
//! driven much.

use crate::calibration::{TripCalibration, TripScan};
use crate::ids::{TripId, VehicleId};
use crate::mapping::RouteMap;
use crate::scan::LaserScan;
use crate::store::TripCalibrationRecord;

/// A trip is asked when the map keeps so many of its scans. Each costs about half a millisecond.
const SCANS: [usize; 2] = [150, 600];

/// The trip's word, if it is due: if its scans in the map, of which there were `known` before, have
/// come to one of the numbers at which it is asked.
///
/// It rests on what was sent, not on what the map makes of it, and changes nothing: the map is the
/// same whether it was asked or not.
pub(super) fn trip_calibration(
    map: &RouteMap,
    trip: &TripId,
    vehicle: &VehicleId,
    known: usize,
) -> Option<TripCalibrationRecord> {
    let count = kept_scans(map, trip);
    SCANS.iter().find(|due| known < **due && **due <= count)?;
    let scans = scans_of(map, trip);
    let newest = scans.last()?.stamp;
    Some(TripCalibrationRecord {
        trip_id: trip.clone(),
        vehicle_id: vehicle.clone(),
        stamp: newest,
        scans: u32::try_from(scans.len()).ok()?,
        calibration: TripCalibration::of_scans(&scans),
    })
}

/// How many of a trip's scans the map keeps.
pub(super) fn kept_scans(map: &RouteMap, trip: &TripId) -> usize {
    let keyframes = map.keyframes().iter().filter(|k| k.trip == *trip);
    let kept = keyframes.map(|keyframe| {
        let between = keyframe.intermediate.iter().filter(|s| s.scan.is_some());
        usize::from(keyframe.scan.is_some()) + between.count()
    });
    kept.sum()
}

/// Those of one lidar, that of the first, in the order of time.
fn scans_of(map: &RouteMap, trip: &TripId) -> Vec<TripScan> {
    let keyframes = map.keyframes().iter().filter(|k| k.trip == *trip);
    let scans = keyframes.flat_map(|keyframe| {
        let own = (
            keyframe.stamp,
            keyframe.odom_from_base,
            keyframe.scan.as_ref(),
        );
        let between = keyframe
            .intermediate
            .iter()
            .map(|s| (s.stamp, s.odom_from_base, s.scan.as_ref()));
        std::iter::once(own).chain(between)
    });
    let scans = scans.filter_map(|(stamp, odom_from_base, scan)| {
        Some(TripScan {
            stamp,
            odom_from_base,
            scan: scan?.clone(),
        })
    });
    let mut scans: Vec<TripScan> = scans.collect();
    scans.sort_by_key(|scan| scan.stamp);
    if let Some(first) = scans.first().map(|scan| scan.scan.clone()) {
        let is_alike = |scan: &LaserScan| {
            scan.lidar() == first.lidar() && scan.beam_count() == first.beam_count()
        };
        scans.retain(|scan| is_alike(&scan.scan));
    }
    scans
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::calibration::Quantity;
    use crate::ids::StampNs;
    use crate::mapping::{Drive, DriveScan, Weighting};
    use crate::sim::{Hall, Vehicle, drive};

    const TURN_RAD: f64 = 0.04;

    /// A lap of a vehicle whose lidar sits turned on its mount.
    fn lap(trip: &TripId) -> Drive {
        let hall = Hall::generate(5).unwrap();
        let vehicle = Vehicle::of_fleet(0, 0.0).with_turned_lidar(TURN_RAD);
        let lidar = Arc::new(vehicle.lidar.geometry.clone().validated().unwrap());
        let scans = drive(&hall.world, &hall.route, &vehicle, 1, 5).into_iter();
        let scans = scans.map(|scan| DriveScan {
            beam_interval_s: 0.0,
            stamp: StampNs((1e9 * scan.time_s) as i64),
            odom_from_base: scan.odom_from_base,
            scan: LaserScan::new(lidar.clone(), scan.ranges_m).unwrap(),
        });
        Drive {
            trip: trip.clone(),
            initial_pose: None,
            scans: scans.collect(),
        }
    }

    #[test]
    fn a_trip_is_asked_when_it_has_driven_enough_and_not_before() {
        let (trip, vehicle) = (TripId::new("t").unwrap(), VehicleId::new("v").unwrap());
        let mut map = RouteMap::new(Weighting::Robust);
        let mut whole = lap(&trip);
        let mut rest = whole.clone();
        rest.scans = whole.scans.split_off(60);
        map.extend(&whole).unwrap();
        assert_eq!(trip_calibration(&map, &trip, &vehicle, 0), None, "too few");
        let known = kept_scans(&map, &trip);
        map.extend(&rest).unwrap();
        let asked = trip_calibration(&map, &trip, &vehicle, known).unwrap();
        assert_eq!(asked.scans as usize, kept_scans(&map, &trip));
        let yaw = asked.calibration.estimates[&Quantity::MountYaw];
        assert!((yaw.value - TURN_RAD).abs() < 4.0 * yaw.sigma, "{yaw:?}");
        assert!(yaw.sigma < 0.01, "{yaw:?}");
        let known = kept_scans(&map, &trip);
        assert_eq!(
            trip_calibration(&map, &trip, &vehicle, known),
            None,
            "no news"
        );
    }
}
