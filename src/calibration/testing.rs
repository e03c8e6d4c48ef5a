//! Simulated vehicles with errors.

use std::sync::Arc;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::corrections::with_spacing;
use super::{
    Corrections, Motions, OdometryTrack, Quantity, ScanMotion, ScanPair, TripScan, is_complete,
};
use crate::geometry::{Information, Pose2, Vector3};
use crate::ids::StampNs;
use crate::scan::LaserScan;
use crate::sim::{Hall, OdometryError, Scene, SimLidar, Vehicle, normal};

/// A vehicle that weaves: where it is after so many seconds.
pub(super) fn weaving(seconds: f64) -> Pose2 {
    let heading_rad = 0.8 * (1.1 * seconds).sin() + 0.4 * (0.37 * seconds).sin();
    Pose2::new(0.5 * seconds, 0.2 * seconds.sin(), heading_rad)
}

/// The stated mount of simulated vehicles.
pub(super) const MOUNT: Pose2 = Pose2 {
    x: 0.25,
    y: -0.05,
    theta: 0.3,
};

/// Once round a hall, metre by metre of its way, at a speed that changes: poses every 50 ms.
pub(super) fn lap() -> Vec<(StampNs, Pose2)> {
    let route = Hall::generate(1).unwrap().route;
    let mut way_m = 0.0;
    let mut poses = Vec::new();
    while way_m < route.length_m() {
        let seconds = 0.05 * poses.len() as f64;
        poses.push((
            StampNs((1e9 * seconds).round() as i64),
            route.pose_at(way_m),
        ));
        way_m += 0.05 * (0.7 + 0.3 * (0.9 * seconds).sin());
    }
    poses
}

/// Straight on at a changing speed.
pub(super) fn straight() -> Vec<(StampNs, Pose2)> {
    let of_lap = lap();
    let mut way_m = 0.0;
    let mut poses = vec![(of_lap[0].0, Pose2::IDENTITY)];
    for pair in of_lap.windows(2) {
        way_m += pair[0].1.between(&pair[1].1).translation().norm();
        poses.push((pair[1].0, Pose2::new(way_m, 0.0, 0.0)));
    }
    poses
}

/// What the wheels and the matched scans of a vehicle with these errors say of a path. Wheels err
/// by 10 mm and 4 mrad after a metre, matches by the same, ten times that for one of twenty.
pub(super) fn motions_along(path: &[(StampNs, Pose2)], truth: &Corrections, seed: u64) -> Motions {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut odom_from_base = Pose2::IDENTITY;
    let mut track = vec![(path[0].0, odom_from_base)];
    for pair in path.windows(2) {
        let true_twist = pair[0].1.between(&pair[1].1).log();
        let way = 1.0 + truth.get(Quantity::WayScale);
        let turn_per_metre = truth.get(Quantity::TurnPerMetre);
        let by_wheels = true_twist.x / way;
        let root = true_twist.x.abs().sqrt();
        let twist = Vector3::new(
            by_wheels + normal(&mut rng, 0.01 * root),
            true_twist.y / way + normal(&mut rng, 0.004 * root),
            (true_twist.z - turn_per_metre * by_wheels) / (1.0 + truth.get(Quantity::TurnScale))
                + normal(&mut rng, 0.004 * root),
        );
        odom_from_base = odom_from_base.compose(&Pose2::exp(&twist));
        track.push((pair[1].0, odom_from_base));
    }
    let shift = truth.mount(&MOUNT).compose(&MOUNT.inverse());
    let stamped = |stamp: StampNs| StampNs(stamp.0 + truth.clock_offset_ns());
    let mut by_scans = Vec::new();
    let mut start = path[0];
    for here in &path[1..] {
        let motion = start.1.between(&here.1);
        if !is_complete(&motion) {
            continue;
        }
        let times = if rng.random_bool(0.05) { 10.0 } else { 1.0 };
        let error = Pose2::new(
            normal(&mut rng, 0.01 * times),
            normal(&mut rng, 0.01 * times),
            normal(&mut rng, 0.004 * times),
        );
        let seen = shift.inverse().compose(&motion).compose(&shift);
        by_scans.push(ScanMotion {
            from: stamped(start.0),
            to: stamped(here.0),
            motion: seen.compose(&error),
            information: Information::from_sigmas(0.01, 0.004),
        });
        start = *here;
    }
    Motions::new(MOUNT, OdometryTrack::through(track), by_scans)
}

/// Errors of a vehicle, each evenly drawn.
pub(super) fn errors(rng: &mut ChaCha8Rng) -> Corrections {
    let mut within = |most: f64| most * (2.0 * rng.random::<f64>() - 1.0);
    Corrections::default()
        .with(Quantity::MountYaw, within(0.08))
        .with(Quantity::MountX, within(0.1))
        .with(Quantity::MountY, within(0.1))
        .with(Quantity::WayScale, within(0.05))
        .with(Quantity::TurnScale, within(0.05))
        .with(Quantity::TurnPerMetre, within(0.005))
        .with(Quantity::ClockOffset, within(0.3))
}

/// Scans along a part of a hall's route.
pub(super) struct SimulatedDrive {
    /// What was sent.
    pub scans: Vec<TripScan>,
    /// Where the base truly was.
    pub truth: Vec<Pose2>,
}

/// What the lidars of simulated drives state: 180 beams over 180°.
pub(super) fn stated_lidar() -> SimLidar {
    SimLidar::sector(std::f64::consts::PI, 180, 15.0, 0.01, MOUNT)
}

/// A noisy lap of a vehicle whose mount and beam spacing are not as stated.
pub(super) fn drive_with(truth: &Corrections, hall: u64, seed: u64) -> SimulatedDrive {
    let mut lidar = stated_lidar();
    let factor = 1.0 + truth.get(Quantity::BeamSpacing);
    lidar.geometry = with_spacing(&lidar.geometry, lidar.beams, factor);
    lidar.mount_error = MOUNT.between(&truth.mount(&MOUNT));
    drive_of(lidar, hall, seed)
}

/// A noisy lap of a vehicle with this lidar, which states another one ([`stated_lidar`]).
pub(super) fn drive_of(lidar: SimLidar, hall: u64, seed: u64) -> SimulatedDrive {
    let vehicle = Vehicle {
        lidar,
        odometry: OdometryError {
            scale: 0.005,
            yaw_drift_rad_per_m: 0.001,
            sigma_xy_m: 0.005,
            sigma_theta_rad: 0.002,
        },
        path_noise_m: 0.5,
        scan_spacing_m: 0.5,
        speed_mps: 1.0,
    };
    let hall = Hall::generate(hall).unwrap();
    let stated = Arc::new(stated_lidar().geometry);
    let scene = Scene::lasting(hall.route, hall.world.shapes().cloned(), 0);
    let mut driven = scene.drive(&vehicle, 1..2, seed);
    driven.truncate(160);
    let truth = driven.iter().map(|scan| scan.map_from_base).collect();
    let scans = driven.into_iter().map(|scan| TripScan {
        stamp: StampNs((1e9 * scan.time_s) as i64),
        odom_from_base: scan.odom_from_base,
        scan: LaserScan::new(stated.clone(), scan.ranges_m).unwrap(),
    });
    SimulatedDrive {
        scans: scans.collect(),
        truth,
    }
}

impl SimulatedDrive {
    pub fn scans(&self) -> impl Iterator<Item = &LaserScan> {
        self.scans.iter().map(|scan| &scan.scan)
    }

    /// Each scan with the next but one, 1 m on.
    pub fn pairs(&self) -> Vec<ScanPair<'_>> {
        let pair = |three: &[TripScan]| three[0].odom_from_base.between(&three[2].odom_from_base);
        let motions = self.scans.windows(3).map(pair);
        let scans = self.scans().zip(self.scans().skip(2));
        let pairs = motions.zip(scans);
        pairs
            .map(|(motion, (from, to))| ScanPair { from, to, motion })
            .collect()
    }
}
