//! A vehicle and how its odometry errs.

use rand_chacha::ChaCha8Rng;

use super::SimLidar;
use super::random::normal;
use crate::geometry::Pose2;

/// A vehicle that drives laps.
#[derive(Debug, Clone, PartialEq)]
pub struct Vehicle {
    /// What it sees with.
    pub lidar: SimLidar,
    /// How its odometry errs.
    pub odometry: OdometryError,
    /// How far its laps stray from the route, metres (the paper's ρ). The first lap does not.
    pub path_noise_m: f64,
    /// Way from a scan to the next, metres.
    pub scan_spacing_m: f64,
    /// Metres a second.
    pub speed_mps: f64,
}

/// The errors of wheel odometry.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OdometryError {
    /// Share by which every way is overstated.
    pub scale: f64,
    /// Turn that is added to every metre, radians.
    pub yaw_drift_rad_per_m: f64,
    /// Standard deviation of the way after one metre, metres; grows with its square root.
    pub sigma_xy_m: f64,
    /// Standard deviation of the turn after one metre, radians; grows with its square root.
    pub sigma_theta_rad: f64,
}

impl OdometryError {
    /// What the wheels say of a true motion.
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
