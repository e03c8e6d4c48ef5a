//! A vehicle and the errors of its odometry.

use rand_chacha::ChaCha8Rng;

use super::SimLidar;
use super::random::normal;
use crate::geometry::Pose2;

/// A vehicle that drives laps.
#[derive(Debug, Clone, PartialEq)]
pub struct Vehicle {
    /// Its lidar.
    pub lidar: SimLidar,
    /// The errors of its odometry.
    pub odometry: OdometryError,
    /// How far its laps stray from the route, metres (the paper's ρ). The first lap does not.
    pub path_noise_m: f64,
    /// Distance between two scans, metres.
    pub scan_spacing_m: f64,
    /// Speed, metres per second.
    pub speed_mps: f64,
}

/// The errors of wheel odometry.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OdometryError {
    /// Relative error of every distance.
    pub scale: f64,
    /// Heading error of every metre, radians.
    pub yaw_drift_rad_per_m: f64,
    /// Standard deviation of the distance after one metre, metres; grows with its square root.
    pub sigma_xy_m: f64,
    /// Standard deviation of the turn after one metre, radians; grows with its square root.
    pub sigma_theta_rad: f64,
}

impl OdometryError {
    /// A true motion as the wheels measure it.
    pub(super) fn measured(&self, motion: &Pose2, rng: &mut ChaCha8Rng) -> Pose2 {
        let way_m = motion.translation().norm();
        let root = way_m.sqrt();
        Pose2::new(
            motion.x * (1.0 + self.scale) + normal(rng, self.sigma_xy_m * root),
            motion.y * (1.0 + self.scale) + normal(rng, self.sigma_xy_m * root),
            motion.theta
                + self.yaw_drift_rad_per_m * way_m
                + normal(rng, self.sigma_theta_rad * root),
        )
    }
}
