//! Simulated vehicles that are not as they state.

use std::f64::consts::PI;
use std::sync::Arc;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::calibration::{Corrections, OdometryTrack, Quantity, TripScan};
use crate::geometry::Pose2;
use crate::ids::StampNs;
use crate::scan::{LaserScan, Lidar};
use crate::sim::{OdometryError, PassErrors, SimLidar, SimScan, Vehicle};

/// The stated mount.
const MOUNT: Pose2 = Pose2 {
    x: 0.25,
    y: -0.05,
    theta: 0.3,
};

/// Least and most that a vehicle is off by, to either side.
fn off_by(quantity: Quantity) -> [f64; 2] {
    match quantity {
        Quantity::MountYaw => [0.0035, 0.087],
        Quantity::MountX | Quantity::MountY => [0.0, 0.1],
        Quantity::WayScale | Quantity::TurnScale | Quantity::RangeScale => [0.0, 0.05],
        Quantity::TurnPerMetre => [0.0, 0.005],
        Quantity::ClockOffset => [0.0, 0.3],
        Quantity::BeamSpacing => [0.0, 0.1],
    }
}

/// A vehicle with a lidar of 240° that sees 15 m far.
#[derive(Debug, Clone)]
pub struct OffVehicle {
    /// How far it is off.
    pub truth: Corrections,
    /// As it is.
    pub vehicle: Vehicle,
    /// The lidar that it states.
    pub stated: Arc<Lidar>,
}

impl OffVehicle {
    /// Off in some quantities by amounts that are drawn, and otherwise as it states.
    pub fn drawn(off: &[Quantity], seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut truth = Corrections::default();
        for quantity in Quantity::ALL {
            let [least, most] = off_by(quantity);
            let size = least + (most - least) * rng.random::<f64>();
            let value = if rng.random_bool(0.5) { size } else { -size };
            if off.contains(&quantity) {
                truth.set(quantity, value);
            }
        }
        Self::new(truth)
    }

    /// Off by so much.
    pub fn new(truth: Corrections) -> Self {
        let stated = SimLidar::sector(4.0 * PI / 3.0, 241, 15.0, 0.01, MOUNT);
        let mut lidar = stated.clone();
        // The middle of the fan points straight ahead.
        let spacing = 1.0 + truth.get(Quantity::BeamSpacing);
        lidar.geometry.angle_min_rad *= spacing;
        lidar.geometry.angle_increment_rad *= spacing;
        lidar.mount_error = MOUNT.between(&truth.mount(&MOUNT));
        let vehicle = Vehicle {
            lidar,
            odometry: OdometryError {
                scale: 1.0 / (1.0 + truth.get(Quantity::WayScale)) - 1.0,
                yaw_drift_rad_per_m: -truth.get(Quantity::TurnPerMetre),
                sigma_xy_m: 0.005,
                sigma_theta_rad: 0.002,
            },
            path_noise_m: 0.5,
            scan_spacing_m: 0.2,
            speed_mps: 1.0,
        };
        Self {
            truth,
            vehicle,
            stated: Arc::new(stated.geometry),
        }
    }

    /// The same with errors that the scans of a lap share.
    #[must_use]
    pub fn with_pass_errors(mut self, pass_errors: PassErrors) -> Self {
        self.vehicle.lidar.pass_errors = pass_errors;
        self
    }

    /// A trip as it is sent, of scans that the vehicle took: ranges, turns of the wheels and stamps
    /// are off. It begins so many seconds after the start of the simulation.
    ///
    /// # Errors
    /// If the ranges are no scan of the lidar.
    pub fn sent(&self, scans: &[SimScan], start_s: f64) -> anyhow::Result<Vec<TripScan>> {
        let stamp = |seconds: f64| StampNs((1e9 * (start_s + seconds)) as i64);
        let track = OdometryTrack::through(
            self.by_wheels(scans)
                .map(|(seconds, pose)| (stamp(seconds), pose)),
        );
        let to_range = 1.0 / (1.0 + self.truth.get(Quantity::RangeScale));
        let sent = scans.iter().filter_map(|scan| {
            let stamp = stamp(scan.time_s + self.truth.get(Quantity::ClockOffset));
            let ranges_m = scan
                .ranges_m
                .iter()
                .map(|range| range.map(|m| to_range * m));
            Some((stamp, track.at(stamp.0)?, ranges_m))
        });
        let sent = sent.map(|(stamp, odom_from_base, ranges_m)| {
            Ok(TripScan {
                stamp,
                odom_from_base,
                scan: LaserScan::new(self.stated.clone(), ranges_m)?,
            })
        });
        sent.collect()
    }

    /// The odometry with turns that are off, by time in seconds.
    fn by_wheels(&self, scans: &[SimScan]) -> impl Iterator<Item = (f64, Pose2)> {
        let turn = 1.0 + self.truth.get(Quantity::TurnScale);
        let mut last: Option<(Pose2, Pose2)> = None;
        scans.iter().map(move |scan| {
            let pose = last.map_or(scan.odom_from_base, |(simulated, sent)| {
                let mut twist = simulated.between(&scan.odom_from_base).log();
                twist.z /= turn;
                sent.compose(&Pose2::exp(&twist))
            });
            last = Some((scan.odom_from_base, pose));
            (scan.time_s, pose)
        })
    }
}
