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

/// A motion by odometry with how far it is trusted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OdometryMotion {
    /// `last_from_base`.
    pub motion: Pose2,
    /// Of the motion.
    pub sigmas: OdometrySigmas,
}

/// Between two scans of a trip, even with batches lost between them, no vehicle moves farther,
/// metres.
const BELIEVED_MAX_M: f64 = 1_000.0;
/// What is known without odometry: the vehicle is about where it was.
const NOT_TOLD: OdometryMotion = OdometryMotion {
    motion: Pose2::IDENTITY,
    sigmas: OdometrySigmas {
        xy_m: 0.5,
        theta_rad: 0.3,
    },
};

impl OdometryMotion {
    /// What the wheels say; a motion beyond belief (a frame that began anew, a wrong number) says
    /// nothing.
    pub fn told(motion: &Pose2) -> Self {
        let way_m = motion.translation().norm();
        if way_m.is_nan() || way_m > BELIEVED_MAX_M {
            return NOT_TOLD;
        }
        Self {
            motion: *motion,
            sigmas: OdometrySigmas::assumed(motion),
        }
    }
}

impl OdometryMotion {
    /// Of a vehicle whose odometry says nothing, that was at `last_from_base` a moment ago.
    pub fn not_told(last_from_base: &Pose2) -> Self {
        Self {
            motion: *last_from_base,
            ..NOT_TOLD
        }
    }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tenth_of_the_way_and_a_fifth_of_the_turn() {
        let sigmas = OdometrySigmas::assumed(&Pose2::new(0.6, -0.8, -0.5));
        assert!((sigmas.xy_m - 0.15).abs() < 1e-12);
        assert!((sigmas.theta_rad - 0.17).abs() < 1e-12);
        let still = OdometrySigmas::assumed(&Pose2::IDENTITY);
        assert_eq!((still.xy_m, still.theta_rad), (0.05, 0.05));
    }

    #[test]
    fn an_error_of_its_sigmas_has_their_length() {
        let sigmas = OdometrySigmas::assumed(&Pose2::new(2.0, 1.0, 0.4));
        let error = Vector3::new(0.6 * sigmas.xy_m, -0.8 * sigmas.xy_m, -sigmas.theta_rad);
        assert!((sigmas.mahalanobis(&error) - 2.0_f64.sqrt()).abs() < 1e-12);
        let squared = sigmas.information().squared_norm(&error);
        assert!((sigmas.mahalanobis(&error).powi(2) - squared).abs() < 1e-9);
    }

    #[test]
    fn a_motion_beyond_belief_says_nothing() {
        let far = Pose2::new(900.0, 0.0, 1.0);
        assert_eq!(OdometryMotion::told(&far).motion, far);
        for wild in [
            Pose2::new(1_001.0, 0.0, 0.0),
            Pose2::new(0.0, -1e300, 0.0),
            Pose2::new(f64::NAN, 0.0, 0.0),
        ] {
            assert_eq!(OdometryMotion::told(&wild), NOT_TOLD);
        }
    }
}
