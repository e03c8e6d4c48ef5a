//! How a trip came from its last keyframe to its next scan, where its odometry may be wrong.
//!
//! Wheels slip, an encoder jumps, a driver starts its odometry anew, a robot is carried. The scans
//! show it: what one saw as free is full in the next. Then the scans are believed without the
//! odometry, and where they say nothing either, nobody knows how the trip went on.

use super::closure::contradiction_share;
use super::front_end::{Motion, match_alone, measure_motion};
use super::keyframe::Keyframe;
use super::local_map::{LocalCloud, LocalMap};
use super::odometry::OdometryMotion;
use crate::geometry::Pose2;

/// Two scans of a step are not where the odometry has them if more than this share of one's points
/// lies in the other's free space …
const CONTRADICTION_SHARE_MAX: f64 = 0.35;
/// … and not where a match has them if more than this does.
const CONTRADICTION_SHARE_MAX_IF_MATCHED: f64 = 0.5;
/// Odometry is abrupt if it is faster by this factor than the trip has been, …
const ABRUPT_FACTOR: f64 = 3.0;
/// … and faster than this, m/s …
const ABRUPT_M_PER_S: f64 = 3.0;
/// … or rad/s; …
const ABRUPT_RAD_PER_S: f64 = 3.0;
/// … for a trip that has just begun, than this, m/s …
const UNHEARD_OF_M_PER_S: f64 = 40.0;
/// … or rad/s.
const UNHEARD_OF_RAD_PER_S: f64 = 10.0;
/// A trip has just begun while it has fewer keyframes, and its newest so many say how fast it is.
const KEYFRAMES_MIN: usize = 5;
const KEYFRAMES_MAX: usize = 20;

/// The scans of a step, and what is known of it.
pub(super) struct Step<'a> {
    /// The trip's last keyframe.
    pub last: &'a Keyframe,
    /// The scan as the keyframe that it would be.
    pub new: &'a Keyframe,
    /// The trip's last keyframes, in the frame of the last one's base …
    pub local_map: LocalMap<'a>,
    /// … and their points.
    pub cloud: &'a LocalCloud,
    /// `last_from_base` by the odometry.
    pub odometry: &'a OdometryMotion,
    /// `last_from_base` of the scan before the new one.
    pub before: Pose2,
    /// Whether the odometry moves as the trip never did.
    pub is_abrupt: bool,
}

impl Step<'_> {
    /// The motion; `None` if nothing tells it.
    pub fn measure(&self) -> Option<Motion> {
        let (points, sigma_m) = (&self.new.points, self.sigma_m());
        let motion = measure_motion(&self.local_map, self.cloud, points, self.odometry, sigma_m);
        let contradicts = self.contradicts(&motion);
        if !contradicts && !self.is_abrupt {
            return Some(motion);
        }
        let alone = match_alone(&self.local_map, self.cloud, points, &self.before, sigma_m);
        let alone = alone.filter(|alone| !self.contradicts(alone));
        alone.or((!contradicts).then_some(motion))
    }

    fn sigma_m(&self) -> f64 {
        let scan = self.new.scan.as_ref();
        scan.map_or(0.0, |scan| scan.lidar().range_sigma_m)
    }

    fn contradicts(&self, motion: &Motion) -> bool {
        let share_max = match motion.matched {
            true => CONTRADICTION_SHARE_MAX_IF_MATCHED,
            false => CONTRADICTION_SHARE_MAX,
        };
        let share = contradiction_share(self.last, self.new, &motion.measurement);
        share.is_some_and(|share| share > share_max)
    }
}

/// Whether odometry moves by `motion` in a time as the trip never did. `keyframes` are the trip's,
/// in the order of the drive.
pub(super) fn is_abrupt<'a>(
    motion: &Pose2,
    elapsed_s: f64,
    keyframes: impl DoubleEndedIterator<Item = &'a Keyframe>,
) -> bool {
    let newest: Vec<&Keyframe> = keyframes.rev().take(KEYFRAMES_MAX).collect();
    let mut fastest = match newest.len() < KEYFRAMES_MIN {
        true => (UNHEARD_OF_M_PER_S, UNHEARD_OF_RAD_PER_S),
        false => (ABRUPT_M_PER_S, ABRUPT_RAD_PER_S),
    };
    for pair in newest.windows(2) {
        let (after, before) = (pair[0], pair[1]);
        let motion = before.odom_from_base.between(&after.odom_from_base);
        let elapsed_s = after.stamp.seconds() - before.stamp.seconds();
        if elapsed_s > 0.0 && after.drift_m < super::LOST_DRIFT_M {
            let (m_per_s, rad_per_s) = speed(&motion, elapsed_s);
            fastest.0 = fastest.0.max(ABRUPT_FACTOR * m_per_s);
            fastest.1 = fastest.1.max(ABRUPT_FACTOR * rad_per_s);
        }
    }
    let (m_per_s, rad_per_s) = speed(motion, elapsed_s.max(1e-3));
    m_per_s > fastest.0 || rad_per_s > fastest.1
}

fn speed(motion: &Pose2, elapsed_s: f64) -> (f64, f64) {
    let m_per_s = motion.translation().norm() / elapsed_s;
    (m_per_s, motion.theta.abs() / elapsed_s)
}
