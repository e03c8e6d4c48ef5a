//! Parts of maps for tests.

use std::sync::Arc;

use super::drive::{Drive, DriveScan, InitialPose};
use super::keyframe::Keyframe;
use crate::geometry::Pose2;
use crate::ids::{NodeId, StampNs, TripId};
use crate::observation::testing::{World, all_round};
use crate::scan::{LaserScan, Lidar};

pub(super) const BEAMS: usize = 360;
pub(super) const SCANS: i64 = 200;
pub(super) const EVERY_S: f64 = 0.2;

/// Two rooms without a likeness, and a door between them.
pub(super) fn rooms() -> World {
    World::default()
        .with_rectangle([0.0, 0.0], [14.0, 7.0])
        .with_side([7.0, 0.0], [7.0, 3.0])
        .with_side([7.0, 4.5], [7.0, 7.0])
        .with_rectangle([1.0, 5.2], [2.2, 6.4])
        .with_rectangle([4.6, 0.3], [5.2, 1.6])
        .with_rectangle([9.0, 0.6], [11.5, 1.1])
        .with_rectangle([12.2, 4.8], [13.1, 6.6])
}

/// Where a vehicle is that drives through both.
pub(super) fn truth(scan: i64) -> Pose2 {
    let phase = 2.0 * std::f64::consts::PI * scan as f64 / SCANS as f64;
    let (sin, cos) = phase.sin_cos();
    let ahead = (0.5 * cos).atan2(-4.5 * sin);
    Pose2::new(7.0 + 4.5 * cos, 3.75 + 0.5 * sin, ahead)
}

/// The vehicle's drive, beginning after `start_s`, where its odometry reports
/// `reported(k, motion)` of its k-th motion. It takes the scans `taken`.
pub(super) fn drive_through(
    world: &World,
    trip: &str,
    start_s: f64,
    taken: impl Iterator<Item = i64>,
    reported: impl Fn(usize, Pose2) -> Pose2,
) -> Drive {
    let lidar = Arc::new(all_round(BEAMS));
    let taken: Vec<i64> = taken.collect();
    let mut odom_from_base = Pose2::IDENTITY;
    let scans = taken.iter().enumerate().map(|(k, &scan)| {
        if k > 0 {
            let motion = truth(taken[k - 1]).between(&truth(scan));
            odom_from_base = odom_from_base.compose(&reported(k, motion));
        }
        DriveScan {
            beam_interval_s: 0.0,
            lidar: Default::default(),
            stamp: StampNs((1e9 * (start_s + EVERY_S * k as f64)) as i64),
            odom_from_base,
            scan: world.scan(&lidar, BEAMS, &truth(scan), || 0.0),
        }
    });
    Drive {
        wheels: Default::default(),
        trip: TripId::new(trip).unwrap(),
        initial_pose: Some(InitialPose {
            pose: truth(taken[0]),
            sigma_xy_m: 0.01,
            sigma_theta_rad: 0.005,
        }),
        scans: scans.collect(),
    }
}

/// A keyframe whose lidar sees nothing.
pub(super) fn blind_keyframe(id: i64, trip: TripId, stamp: StampNs) -> Keyframe {
    let lidar = Lidar {
        angle_min_rad: 0.0,
        angle_increment_rad: 1.0,
        range_min_m: 0.1,
        range_max_m: 5.0,
        mount: Pose2::IDENTITY,
        range_sigma_m: 0.01,
        band: None,
    };
    let scan = LaserScan::new(Arc::new(lidar), [None; 3]).unwrap();
    Keyframe::new(NodeId(id), trip, stamp, Pose2::IDENTITY, scan)
}
