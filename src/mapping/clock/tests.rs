use std::f64::consts::PI;
use std::sync::Arc;

use super::super::drive::InitialPose;
use super::super::route_map::Weighting;
use super::*;
use crate::calibration::Quantity;
use crate::geometry::{Vector3, angle_difference_rad};
use crate::observation::testing::{World, all_round};
use crate::scan::LaserScan;
use crate::sim::{FloorPlan, OdometryError, Rooms, SimLidar, Vehicle};

const BEAMS: usize = 360;
const SCANS: i64 = 300;
const EVERY_MS: i64 = 100;

/// A vehicle that weaves through a room.
fn truth(ms: i64) -> Pose2 {
    truth_at(1e-3 * ms as f64)
}

fn truth_at(seconds: f64) -> Pose2 {
    let along = Pose2::new(1.5 + 0.1 * seconds, 2.0 + 0.6 * seconds.sin(), 0.0);
    Pose2::new(along.x, along.y, 0.9 * (1.3 * seconds).sin())
}

fn room() -> World {
    World::default()
        .with_rectangle([0.0, 0.0], [6.0, 4.5])
        .with_rectangle([0.8, 3.4], [1.8, 4.1])
        .with_rectangle([4.2, 0.4], [4.9, 0.9])
}

/// Scans that show where the vehicle was so long before their stamp.
fn drives(late_ms: i64) -> Vec<Drive> {
    let (lidar, world) = (Arc::new(all_round(BEAMS)), room());
    let scan = |k: i64| DriveScan {
        beam_interval_s: 0.0,
        lidar: Default::default(),
        stamp: StampNs(k * EVERY_MS * 1_000_000),
        odom_from_base: truth(k * EVERY_MS),
        scan: world.scan(&lidar, BEAMS, &truth(k * EVERY_MS - late_ms), || 0.0),
    };
    let scans: Vec<DriveScan> = (0..SCANS).map(scan).collect();
    let drive = |(number, scans): (usize, &[DriveScan])| Drive {
        wheels: Default::default(),
        trip: TripId::new("monday").unwrap(),
        initial_pose: (number == 0).then(|| InitialPose {
            pose: truth(-late_ms),
            sigma_xy_m: 0.01,
            sigma_theta_rad: 0.01,
        }),
        scans: scans.to_vec(),
    };
    scans.chunks(50).enumerate().map(drive).collect()
}

fn mapped(drives: &[Drive]) -> RouteMap {
    let mut map = RouteMap::new(Weighting::Robust);
    for drive in drives {
        map.extend(drive).unwrap();
    }
    map
}

#[test]
fn odometry_that_is_ahead_is_corrected_and_kept_as_it_was_sent() {
    for late_ms in [0, 120] {
        let map = mapped(&drives(late_ms));
        let poses = map.driven_poses(&TripId::new("monday").unwrap());
        assert_eq!(poses.len() as i64, SCANS);
        let offset_s = clock_offset_s(&poses);
        assert!(
            (offset_s - 1e-3 * late_ms as f64).abs() < 0.015,
            "{offset_s}"
        );
        for pose in &poses {
            let ms = pose.stamp.0 / 1_000_000;
            assert_eq!(pose.odom_from_base, truth(ms), "{ms}");
            if let Some(map_from_base) = pose.map_from_base {
                let there = truth(ms - late_ms);
                let off_m = (map_from_base.translation() - there.translation()).norm();
                let off_rad = angle_difference_rad(map_from_base.theta, there.theta);
                assert!(off_m < 0.03 && off_rad < 0.01, "{ms}: {off_m} {off_rad}");
            }
        }
    }
}

#[test]
fn wheels_that_are_corrected_lead_where_the_scans_do_and_stay_as_sent() {
    // Ways and turns are told too short.
    let wheels = Corrections::default()
        .with(Quantity::WayScale, 0.25)
        .with(Quantity::TurnScale, 0.1);
    let told = |wheels: &Corrections| {
        let mut sent = drives(0);
        for drive in &mut sent {
            drive.wheels = *wheels;
        }
        let (mut by_wheels, mut last) = (Pose2::IDENTITY, truth(0));
        for scan in sent.iter_mut().flat_map(|drive| &mut drive.scans) {
            let twist = last.between(&scan.odom_from_base).log();
            last = scan.odom_from_base;
            let told = Vector3::new(twist.x / 1.25, twist.y / 1.25, twist.z / 1.1);
            by_wheels = by_wheels.compose(&Pose2::exp(&told));
            scan.odom_from_base = by_wheels;
        }
        sent
    };
    let sent = told(&wheels);
    let mut map = mapped(&sent);
    let trip = TripId::new("monday").unwrap();
    let poses = map.driven_poses(&trip);
    let scans = sent.iter().flat_map(|drive| &drive.scans);
    for (pose, scan) in poses.iter().zip(scans) {
        assert_eq!(pose.odom_from_base, scan.odom_from_base);
    }
    let next = Drive {
        scans: Vec::new(),
        ..sent[0].clone()
    };
    let mut clock = TripClock::new(&map, &next);
    clock.adjust(&mut map);
    for pair in map.driven_poses(&trip).windows(2) {
        let by_wheels = pair[0].odom_from_base.between(&pair[1].odom_from_base);
        let [from, to] = [0, 1].map(|k| truth(pair[k].stamp.0 / 1_000_000));
        assert!(from.between(&to).between(&by_wheels).log().norm() < 2e-3);
    }
    clock.restore(&mut map);
    assert_eq!(
        map.driven_poses(&trip)[7].odom_from_base,
        sent[0].scans[7].odom_from_base
    );
}

/// A drive whose lidar needs a tenth of a second for a turn; clockwise if its interval is below 0.
fn swept(beam_interval_s: f64) -> Drive {
    let (lidar, world) = (Arc::new(all_round(BEAMS)), room());
    let scan = |k: i64| {
        let ranges = (0..BEAMS).map(|beam| {
            let before = match beam_interval_s < 0.0 {
                true => BEAMS - 1 - beam,
                false => beam,
            };
            let since_ms = EVERY_MS as f64 * before as f64 / (BEAMS - 1) as f64;
            let map_from_base = truth_at(1e-3 * ((k * EVERY_MS) as f64 + since_ms));
            let direction_rad = map_from_base.theta + lidar.beam_angle_rad(beam);
            world.range_m(&map_from_base.translation(), direction_rad)
        });
        DriveScan {
            stamp: StampNs(k * EVERY_MS * 1_000_000),
            odom_from_base: truth(k * EVERY_MS),
            beam_interval_s,
            lidar: Default::default(),
            scan: LaserScan::new(lidar.clone(), ranges.collect::<Vec<_>>()).unwrap(),
        }
    };
    Drive {
        scans: (0..SCANS).map(scan).collect(),
        ..drives(0).remove(0)
    }
}

#[test]
fn motion_during_a_scan_is_taken_out_where_its_time_is_stated() {
    let worst_m = |beam_interval_s: f64| {
        let map = mapped(&[swept(beam_interval_s)]);
        let poses = map.driven_poses(&TripId::new("monday").unwrap());
        let errors = poses.iter().filter_map(|pose| {
            let there = truth(pose.stamp.0 / 1_000_000);
            let off = pose.map_from_base?.translation() - there.translation();
            Some(off.norm())
        });
        errors.fold(0.0, f64::max)
    };
    let interval_s = 1e-3 * EVERY_MS as f64 / (BEAMS - 1) as f64;
    let not_stated_m = worst_m(0.0);
    for stated_m in [worst_m(interval_s), worst_m(-interval_s)] {
        assert!(stated_m < 0.02, "{stated_m}");
        assert!(not_stated_m > 2.0 * stated_m, "{not_stated_m} {stated_m}");
    }
}

/// Two laps of a corridor 100 m long, parts of which are bare, with a scan a metre. The wheels have
/// the way 2 % too long.
fn round_a_floor() -> Drive {
    let vehicle = Vehicle {
        lidar: SimLidar::sector(PI, 181, 30.0, 0.01, Pose2::new(0.2, 0.0, 0.0)),
        odometry: OdometryError {
            scale: 0.02,
            yaw_drift_rad_per_m: 0.0,
            sigma_xy_m: 0.03,
            sigma_theta_rad: 0.01,
        },
        path_noise_m: 0.1,
        scan_spacing_m: 1.0,
        speed_mps: 0.8,
    };
    let floor = Rooms::of_plan(&FloorPlan::round(100.0, 2.4), 3).unwrap();
    let lidar = Arc::new(vehicle.lidar.geometry.clone().validated().unwrap());
    let scans = floor.scene.drive(&vehicle, 0..2, 3).into_iter();
    let scans = scans.map(|scan| DriveScan {
        stamp: StampNs((1e9 * scan.time_s) as i64),
        odom_from_base: scan.odom_from_base,
        beam_interval_s: 0.0,
        lidar: Default::default(),
        scan: LaserScan::new(lidar.clone(), scan.ranges_m).unwrap(),
    });
    Drive {
        scans: scans.collect(),
        initial_pose: None,
        ..drives(0).remove(0)
    }
}

#[test]
fn wheels_of_a_first_trip_are_found_to_have_the_way_too_long() {
    let drive = round_a_floor();
    let scale_found = |known: Corrections| {
        let mut map = mapped(std::slice::from_ref(&drive));
        let next = Drive {
            scans: Vec::new(),
            wheels: known,
            ..drive.clone()
        };
        let mut clock = TripClock::new(&map, &next);
        clock.adjust(&mut map);
        clock.wheels.get(Quantity::WayScale)
    };
    let found = scale_found(Corrections::default());
    assert!((found + 0.02).abs() < 0.005, "{found}");
    let known = Corrections::default().with(Quantity::WayScale, -0.012);
    assert_eq!(scale_found(known), -0.012, "earlier trips know it better");
}
