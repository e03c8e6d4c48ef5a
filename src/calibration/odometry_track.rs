//! Odometry as a function of time.

use crate::geometry::Pose2;
use crate::ids::StampNs;

/// Where odometry had the base at each time.
#[derive(Debug, Clone, PartialEq)]
pub struct OdometryTrack {
    /// Ascending by stamp.
    poses: Vec<(StampNs, Pose2)>,
}

impl OdometryTrack {
    /// Through poses of one odometry frame in the order of time.
    pub fn through(poses: impl IntoIterator<Item = (StampNs, Pose2)>) -> Self {
        Self {
            poses: poses.into_iter().collect(),
        }
    }

    /// Its poses with their times, ascending by stamp.
    pub(super) fn poses(&self) -> &[(StampNs, Pose2)] {
        &self.poses
    }

    /// The pose at a time, on the arc between the two around it; the first or the last one outside.
    /// `None` without any.
    pub fn at(&self, stamp_ns: i64) -> Option<Pose2> {
        let next = self.poses.partition_point(|(stamp, _)| stamp.0 <= stamp_ns);
        let Some(before) = next.checked_sub(1) else {
            return Some(self.poses.first()?.1);
        };
        let (from, from_pose) = self.poses[before];
        let Some((to, to_pose)) = self.poses.get(next) else {
            return Some(from_pose);
        };
        let share = (stamp_ns - from.0) as f64 / (to.0 - from.0) as f64;
        let motion = from_pose.between(to_pose).log();
        Some(from_pose.compose(&Pose2::exp(&(share * motion))))
    }

    /// The motion between two times: `from_from_to`. `None` without any pose.
    pub fn motion(&self, from_ns: i64, to_ns: i64) -> Option<Pose2> {
        Some(self.at(from_ns)?.between(&self.at(to_ns)?))
    }

    /// The first and the last time.
    pub fn span(&self) -> Option<(StampNs, StampNs)> {
        Some((self.poses.first()?.0, self.poses.last()?.0))
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::calibration::testing::weaving;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn a_track_goes_through_its_poses(at_s in 0.0..9.9_f64) {
            let track = OdometryTrack::through((0..100).map(|k| {
                let seconds = 0.1 * f64::from(k);
                (StampNs((1e9 * seconds) as i64), weaving(seconds))
            }));
            let (found, there) = (track.at((1e9 * at_s) as i64).unwrap(), weaving(at_s));
            prop_assert!((found.translation() - there.translation()).norm() < 2e-3);
            prop_assert!((found.theta - there.theta).abs() < 2e-3);
        }
    }
}
