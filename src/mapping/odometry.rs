//! How far a vehicle's own odometry is trusted.

use crate::geometry::{Information, Pose2, Vector3};

/// Standard deviations of a motion by odometry.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OdometrySigmas {
    /// Of x and of y, metres.
    pub xy_m: f64,
    /// Of the heading, radians.
    pub theta_rad: f64,
}

impl OdometrySigmas {
    /// What is assumed of any odometry: a tenth of the way and a fifth of the turn.
    pub fn assumed(motion: &Pose2) -> Self {
        let distance_m = motion.translation().norm();
        Self {
            xy_m: 0.05 + 0.1 * distance_m,
            theta_rad: 0.05 + 0.2 * motion.theta.abs() + 0.02 * distance_m,
        }
    }

    /// As an information matrix.
    pub fn information(&self) -> Information {
        Information::from_sigmas(self.xy_m, self.theta_rad)
    }

    /// The length of an error in standard deviations.
    pub fn mahalanobis(&self, error: &Vector3<f64>) -> f64 {
        let xy = error.xy().norm() / self.xy_m;
        xy.hypot(error.z / self.theta_rad)
    }
}
