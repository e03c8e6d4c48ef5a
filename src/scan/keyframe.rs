//! When a scan becomes a node.

use crate::geometry::Pose2;

/// A scan becomes a keyframe when the vehicle has moved or turned enough since the last one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KeyframeRule {
    /// Metres.
    pub distance_m: f64,
    /// Radians.
    pub turn_rad: f64,
}

/// A vehicle that has moved and turned by less is stationary: metres, radians.
const STANDING_M: f64 = 0.02;
const STANDING_RAD: f64 = 0.01;

/// Whether the vehicle was stationary.
pub fn is_standing(motion: &Pose2) -> bool {
    motion.translation().norm() <= STANDING_M && motion.theta.abs() <= STANDING_RAD
}

impl KeyframeRule {
    /// A tenth of the lidar's range, 0.1 to 0.5 m, or 20°: so that neighbours share most of
    /// their view.
    pub fn for_range(range_max_m: f64) -> Self {
        Self {
            distance_m: (0.1 * range_max_m).clamp(0.1, 0.5),
            turn_rad: 0.35,
        }
    }

    /// Whether a motion since the last keyframe makes the next one due.
    pub fn is_due(&self, motion: &Pose2) -> bool {
        motion.translation().norm() >= self.distance_m || motion.theta.abs() >= self.turn_rad
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distance_and_turn_each_suffice() {
        let rule = KeyframeRule::for_range(30.0);
        assert!(!rule.is_due(&Pose2::new(0.3, -0.3, 0.2)));
        assert!(rule.is_due(&Pose2::new(0.4, -0.4, 0.0)));
        assert!(rule.is_due(&Pose2::new(0.0, 0.0, -0.4)));
    }
}
