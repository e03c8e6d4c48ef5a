//! Where a scan between keyframes was taken, and whether it says something new.

use super::drive::DriveScan;
use super::front_end::measure_motion;
use super::intermediate::{Companion, IntermediateScan};
use super::keyframe::Keyframe;
use super::local_map::{LocalCloud, LocalMap};
use super::odometry::OdometryMotion;
use crate::geometry::Pose2;
use crate::ids::LidarId;
use crate::scan::{Lidar, surface_points};

/// A scan says something new once the lidar has moved by this much since the last that was kept,
/// metres …
const MOVED_M: f64 = 0.1;
/// … or, for a lidar that sees no farther than 16 m, by this share of its range …
const MOVED_PER_RANGE: f64 = 1.0 / 160.0;
/// … or turned, radians …
const TURNED_RAD: f64 = 0.1;
/// … or waited, seconds, …
const WAITED_S: f64 = 0.5;
/// … so many times from one standpoint.
const WAITS_MAX: usize = 12;

/// A match is used if it ends this near to where odometry had it, metres and radians.
const MATCHED_WITHIN_M: f64 = 0.3;
const MATCHED_WITHIN_RAD: f64 = 0.35;

impl IntermediateScan {
    /// Places a scan behind a trip's last keyframe, by its odometry and, where it is kept, by a
    /// match with the trip's last keyframes (`cloud`: their points in the keyframe's base frame).
    pub(super) fn place(
        scan: &DriveScan,
        last: &Keyframe,
        local_map: &LocalMap<'_>,
        cloud: &LocalCloud,
    ) -> Self {
        let by_odometry = last.odom_from_base.between(&scan.odom_from_base);
        let mut placed = Self {
            stamp: scan.stamp,
            keyframe_from_base: by_odometry,
            odom_from_base: scan.odom_from_base,
            companion: None,
            scan: None,
        };
        if !says_something_new(scan, last, None) {
            return placed;
        }
        let points = surface_points(&scan.scan);
        let sigma_m = scan.scan.lidar().range_sigma_m;
        let odometry = OdometryMotion::told(&by_odometry);
        let motion = measure_motion(local_map, cloud, &points, &odometry, sigma_m);
        let moved = by_odometry.between(&motion.measurement);
        if motion.matched
            && moved.translation().norm() <= MATCHED_WITHIN_M
            && moved.theta.abs() <= MATCHED_WITHIN_RAD
        {
            placed.keyframe_from_base = motion.measurement;
        }
        placed.scan = Some(scan.scan.clone());
        placed
    }

    /// A companion's scan behind a trip's last keyframe; one whose place `is_known` is kept if it says
    /// something new.
    pub(super) fn of_companion(
        keyframe_from_base: Pose2,
        scan: &DriveScan,
        last: &Keyframe,
        is_known: bool,
    ) -> Self {
        let is_kept = is_known && says_something_new(scan, last, scan.lidar.name.as_ref());
        Self {
            stamp: scan.stamp,
            keyframe_from_base,
            odom_from_base: scan.odom_from_base,
            companion: Companion::of(scan, false),
            scan: is_kept.then(|| scan.scan.clone()),
        }
    }

    /// A scan that was placed, behind a trip's last keyframe.
    pub(super) fn at(keyframe_from_base: Pose2, scan: &DriveScan, last: &Keyframe) -> Self {
        let mut kept = last.own_intermediate().filter(|s| s.scan.is_some());
        let from_kept = kept
            .next_back()
            .map_or(Pose2::IDENTITY, |s| s.keyframe_from_base);
        let is_kept = has_moved(scan.scan.lidar(), &from_kept, &keyframe_from_base);
        Self {
            stamp: scan.stamp,
            keyframe_from_base,
            odom_from_base: scan.odom_from_base,
            companion: None,
            scan: is_kept.then(|| scan.scan.clone()),
        }
    }
}

/// By odometry alone, so that it does not depend on what the map knows.
fn says_something_new(scan: &DriveScan, last: &Keyframe, companion: Option<&LidarId>) -> bool {
    let kept = || {
        let kept = last.intermediate.iter().filter(|s| s.scan.is_some());
        kept.filter(|s| s.companion_lidar() == companion)
    };
    let newest = kept().next_back().map(|s| (s.stamp, s.odom_from_base));
    let of_keyframe = (last.stamp, last.odom_from_base);
    let Some((stamp, odom_from_kept)) = newest.or(companion.is_none().then_some(of_keyframe))
    else {
        return true;
    };
    if has_moved(scan.scan.lidar(), &odom_from_kept, &scan.odom_from_base) {
        return true;
    }
    let waits = kept()
        .rev()
        .take_while(|s| !has_moved(scan.scan.lidar(), &s.odom_from_base, &scan.odom_from_base))
        .count();
    waits < WAITS_MAX && scan.stamp.seconds() - stamp.seconds() >= WAITED_S
}

fn has_moved(lidar: &Lidar, before: &Pose2, now: &Pose2) -> bool {
    let motion = before.between(now);
    let moved_m = MOVED_M.min(MOVED_PER_RANGE * lidar.range_max_m);
    motion.translation().norm() >= moved_m || motion.theta.abs() >= TURNED_RAD
}
