use std::sync::Arc;

use super::super::vehicles::corrected;
use super::*;
use crate::calibration::{AppliedCorrection, Estimate, Quantity};
use crate::ids::{StampNs, VehicleId};
use crate::mapping::{Drive, DriveScan, InitialPose, LidarOfVehicle, Weighting};
use crate::sim::{Hall, Scene, SimLidar, SimScan, Vehicle, drive};

const TURN_RAD: f64 = 0.04;

/// A lap of a vehicle whose lidar sits turned on its mount.
fn lap(trip: &TripId) -> Drive {
    let hall = Hall::generate(5).unwrap();
    let vehicle = Vehicle::of_fleet(0, 0.0).with_turned_lidar(TURN_RAD);
    let lidar = Arc::new(vehicle.lidar.geometry.clone().validated().unwrap());
    let scans = drive(&hall.world, &hall.route, &vehicle, 1, 5).into_iter();
    let scans = scans.map(|scan| DriveScan {
        beam_interval_s: 0.0,
        lidar: Default::default(),
        stamp: StampNs((1e9 * scan.time_s) as i64),
        odom_from_base: scan.odom_from_base,
        scan: LaserScan::new(lidar.clone(), scan.ranges_m).unwrap(),
    });
    Drive {
        wheels: Default::default(),
        trip: trip.clone(),
        initial_pose: None,
        scans: scans.collect(),
    }
}

/// The calibrations of a trip that shares the map with other trips of these vehicles.
fn calibrate(
    map: &RouteMap,
    vehicles: &[(&str, &str)],
    trip: &TripId,
    known: &KeptScans,
    corrections: &TripCorrections,
) -> Vec<TripCalibrationRecord> {
    let whose = |(trip, vehicle): &(&str, &str)| {
        (
            TripId::new(*trip).unwrap(),
            VehicleId::new(*vehicle).unwrap(),
        )
    };
    TripInMap {
        map,
        vehicles: &vehicles.iter().map(whose).collect(),
        trip,
        vehicle: &VehicleId::new("v").unwrap(),
        corrections,
    }
    .calibrations(known)
}

#[test]
fn a_trip_is_calibrated_when_it_has_driven_enough_and_not_before() {
    let trip = TripId::new("t").unwrap();
    let mut map = RouteMap::new(Weighting::Robust);
    let mut whole = lap(&trip);
    let mut rest = whole.clone();
    rest.scans = whole.scans.split_off(60);
    map.extend(&whole).unwrap();
    let none = KeptScans::new();
    assert_eq!(
        calibrate(&map, &[], &trip, &none, &TripCorrections::default()),
        [],
        "too few"
    );
    let known = kept_scans(&map, &trip);
    map.extend(&rest).unwrap();
    let calibrated = calibrate(&map, &[], &trip, &known, &TripCorrections::default());
    let [calibrated] = calibrated.as_slice() else {
        panic!("{} were calibrated", calibrated.len());
    };
    assert_eq!(calibrated.scans as usize, kept_scans(&map, &trip)[&None]);
    assert_eq!(
        (&calibrated.lidar, &calibrated.beside_primary),
        (&None, &None)
    );
    let yaw = calibrated.calibration.estimates[&Quantity::MountYaw];
    assert!((yaw.value - TURN_RAD).abs() < 4.0 * yaw.sigma, "{yaw:?}");
    assert!(yaw.sigma < 0.01, "{yaw:?}");
    let known = kept_scans(&map, &trip);
    assert_eq!(
        calibrate(&map, &[], &trip, &known, &TripCorrections::default()),
        [],
        "no news"
    );
}

#[test]
fn what_is_corrected_changes_no_word_on_the_vehicle_as_stated() {
    let trip = TripId::new("t").unwrap();
    let corrections = [
        (Quantity::MountYaw, TURN_RAD),
        (Quantity::MountX, -0.1),
        (Quantity::WayScale, 0.02),
        (Quantity::TurnPerMetre, -0.003),
    ];
    let corrections = corrections.map(|(quantity, value)| {
        let estimate = Estimate {
            value,
            sigma: 0.001,
        };
        AppliedCorrection::new(None, quantity, &estimate, (trip.clone(), StampNs(0)))
    });
    let corrections = TripCorrections::new(corrections.into());
    let said = |corrections: &TripCorrections| {
        let mut map = RouteMap::new(Weighting::Robust);
        map.extend(&corrected(lap(&trip), corrections)).unwrap();
        let none = KeptScans::new();
        let mut said = calibrate(&map, &[], &trip, &none, corrections);
        (said.remove(0).calibration.estimates, map.keyframes().len())
    };
    let (stated, nodes) = said(&TripCorrections::default());
    let (corrected, nodes_corrected) = said(&corrections);
    assert!(
        nodes.abs_diff(nodes_corrected) < nodes / 4,
        "{nodes} {nodes_corrected}"
    );
    assert_eq!(stated.len(), corrected.len());
    for (quantity, stated) in &stated {
        let apart = (corrected[quantity].value - stated.value).abs();
        assert!(
            apart < 0.5 * stated.sigma,
            "{quantity:?}: {apart} {stated:?}"
        );
    }
}

#[test]
fn a_map_of_another_vehicle_tells_the_scale_of_the_ranges() {
    let (maker, trip) = (TripId::new("maker").unwrap(), TripId::new("t").unwrap());
    let none = (KeptScans::new(), TripCorrections::default());
    for (whose, factor) in [("other", 1.0), ("other", 1.03), ("v", 1.03)] {
        let mut map = RouteMap::new(Weighting::Robust);
        map.extend(&lap(&maker)).unwrap();
        let mut drive = lap(&trip);
        drive.initial_pose = Some(InitialPose {
            pose: Pose2::IDENTITY,
            sigma_xy_m: 0.1,
            sigma_theta_rad: 0.05,
        });
        for scan in &mut drive.scans {
            let ranges = scan.scan.ranges_m().map(|range| range.map(|m| m / factor));
            scan.scan = LaserScan::new(scan.scan.lidar().clone(), ranges).unwrap();
        }
        map.extend(&drive).unwrap();
        let calibrated = calibrate(
            &map,
            &[("maker", whose), ("t", "v")],
            &trip,
            &none.0,
            &none.1,
        );
        let calibrated = calibrated[0]
            .calibration
            .estimates
            .get(&Quantity::RangeScale);
        assert_eq!(
            calibrated.is_some(),
            whose == "other",
            "its own map tells nothing"
        );
        let off = calibrated.map_or(0.0, |calibrated| calibrated.value - (factor - 1.0));
        assert!(off.abs() < 0.004, "{factor}: {calibrated:?}");
    }
}

/// A lap of a vehicle with two lidars, of which the rear one sits turned.
#[test]
fn each_lidar_is_calibrated_and_companions_beside_the_primary_one() {
    let trip = TripId::new("t").unwrap();
    let hall = Hall::generate(5).unwrap();
    let [front, rear] = SimLidar::front_and_rear(std::f64::consts::PI, 181, 20.0, 0.01);
    let mount_error = Pose2::new(0.0, 0.0, TURN_RAD);
    let lidars = [
        front.clone(),
        SimLidar {
            mount_error,
            ..rear
        },
    ];
    let driven_by = Vehicle {
        lidar: front,
        ..Vehicle::of_fleet(0, 0.0)
    };
    let scene = Scene::of_hall(&hall, 0);
    let ahead = scene.drive(&driven_by, 0..1, 5);
    let back = scene.drive_of_companion(&driven_by, (1, &lidars[1]), 0..1, 5);
    let scan = |place: usize, scan: SimScan| DriveScan {
        beam_interval_s: 0.0,
        lidar: LidarOfVehicle {
            name: Some(LidarId::new(["front", "rear"][place]).unwrap()),
            place,
        },
        stamp: StampNs((1e9 * scan.time_s) as i64),
        odom_from_base: scan.odom_from_base,
        scan: {
            let geometry = Arc::new(lidars[place].geometry.clone());
            LaserScan::new(geometry, scan.ranges_m).unwrap()
        },
    };
    let both = ahead.into_iter().zip(back);
    let scans = both.flat_map(|(ahead, back)| [scan(0, ahead), scan(1, back)]);
    let mut map = RouteMap::new(Weighting::Robust);
    map.extend(&Drive {
        wheels: Default::default(),
        trip: trip.clone(),
        initial_pose: None,
        scans: scans.collect(),
    })
    .unwrap();
    let none = KeptScans::new();
    let calibrated = calibrate(&map, &[], &trip, &none, &TripCorrections::default());
    let [front, rear] = calibrated.as_slice() else {
        panic!("{} were calibrated", calibrated.len());
    };
    let names = [front, rear].map(|record| record.lidar.as_ref().unwrap().as_str());
    assert_eq!(names, ["front", "rear"]);
    assert_eq!(front.beside_primary, None);
    let yaws = [
        (&front.calibration, 0.0),
        (&rear.calibration, TURN_RAD),
        (rear.beside_primary.as_ref().unwrap(), TURN_RAD),
    ];
    for (calibrated, truth) in yaws {
        let yaw = calibrated.estimates[&Quantity::MountYaw];
        assert!(
            (yaw.value - truth).abs() < 4.0 * yaw.sigma,
            "{yaw:?}, not {truth}"
        );
        assert!(yaw.sigma < 0.01, "{yaw:?}");
    }
}
