//! The odometry over time, and where it had the vehicle at a scan's stamp.

use crate::geometry::{Pose2, wrap_angle};
use crate::ingest::batch_json::COORDINATE_MAX_M;

/// Between poses that are farther apart nobody knows where the vehicle was, nanoseconds.
const GAP_MAX_NS: i64 = 1_000_000_000;

/// Poses by time.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Track {
    /// In the order of time once they are sorted.
    poses: Vec<(i64, Pose2)>,
}

impl Track {
    /// Adds a pose, if it can be one.
    pub fn push(&mut self, stamp_ns: i64, odom_from_base: Pose2) {
        let farthest_m = odom_from_base.x.abs().max(odom_from_base.y.abs());
        if !odom_from_base.is_finite() || farthest_m > COORDINATE_MAX_M {
            return;
        }
        self.poses.push((stamp_ns, odom_from_base));
    }

    pub fn is_empty(&self) -> bool {
        self.poses.is_empty()
    }

    pub fn len(&self) -> usize {
        self.poses.len()
    }

    /// Puts the poses in the order of time; of several with one stamp the first stays.
    pub fn sort(&mut self) {
        self.poses.sort_by_key(|(stamp_ns, _)| *stamp_ns);
        self.poses.dedup_by_key(|(stamp_ns, _)| *stamp_ns);
    }

    /// The pose at a time, between those before and after; `None` outside of the odometry's time and
    /// in its gaps.
    pub fn at(&self, stamp_ns: i64) -> Option<Pose2> {
        let after = self.poses.partition_point(|(at_ns, _)| *at_ns < stamp_ns);
        let (later_ns, later) = self.poses.get(after)?;
        if *later_ns == stamp_ns {
            return Some(*later);
        }
        let (earlier_ns, earlier) = &self.poses[after.checked_sub(1)?];
        let span_ns = later_ns.checked_sub(*earlier_ns)?;
        if span_ns > GAP_MAX_NS {
            return None;
        }
        let share = (stamp_ns - earlier_ns) as f64 / span_ns as f64;
        let turn_rad = wrap_angle(later.theta - earlier.theta);
        Some(Pose2::new(
            earlier.x + share * (later.x - earlier.x),
            earlier.y + share * (later.y - earlier.y),
            earlier.theta + share * turn_rad,
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    const S: i64 = 1_000_000_000;

    #[test]
    fn headings_turn_the_short_way_round() {
        let mut track = Track::default();
        track.push(S / 2, Pose2::new(1.0, 2.0, -PI + 0.1));
        track.push(0, Pose2::new(0.0, 0.0, PI - 0.1));
        track.sort();
        let half = track.at(S / 4).unwrap();
        assert!((half.x - 0.5).abs() < 1e-12 && (half.y - 1.0).abs() < 1e-12);
        assert!((half.theta.abs() - PI).abs() < 1e-12, "{half:?}");
        assert_eq!(track.at(0).unwrap().theta, PI - 0.1);
    }

    #[test]
    fn outside_of_its_time_and_in_gaps_nothing_is_known() {
        let mut track = Track::default();
        for (at, x) in [(0, 0.0), (S, 1.0), (3 * S, 3.0)] {
            track.push(at, Pose2::new(x, 0.0, 0.0));
        }
        track.sort();
        assert!(track.at(S / 2).is_some() && track.at(3 * S).is_some());
        for outside in [-1, 2 * S, 3 * S + 1] {
            assert_eq!(track.at(outside), None, "{outside}");
        }
        assert_eq!(Track::default().at(0), None);
    }
}
