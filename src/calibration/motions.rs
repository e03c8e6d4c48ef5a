//! Motions of one trip, by its wheels and by its scans.

use super::{DrivenPose, OdometryTrack};
use crate::geometry::{Information, Pose2};
use crate::ids::StampNs;

/// A motion ends once the vehicle is so far from where it began, metres …
const WAY_MIN_M: f64 = 0.3;
/// … or has turned so far, radians.
const TURN_MIN_RAD: f64 = 0.2;
/// Longer ones say less for their errors, metres …
const WAY_MAX_M: f64 = 2.0;
/// … radians …
const TURN_MAX_RAD: f64 = 0.9;
/// … and seconds.
const TIME_MAX_S: f64 = 20.0;
/// Largest clock offset that is searched for, seconds.
pub(super) const OFFSET_MAX_S: f64 = 0.5;

/// How the base moved between two scans, as matching has it with the stated mount.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScanMotion {
    /// Stamp of the first scan.
    pub from: StampNs,
    /// Stamp of the second scan.
    pub to: StampNs,
    /// `from_from_to`, base frames.
    pub motion: Pose2,
    /// Of the motion, for errors in the base frame at its end; zero along directions that the
    /// scans do not fix.
    pub information: Information,
}

/// A trip's motions by its scans, with its odometry.
#[derive(Debug, Clone)]
pub struct Motions {
    mount: Pose2,
    odometry: OdometryTrack,
    by_scans: Vec<ScanMotion>,
}

impl Motions {
    /// Motions in the order of time. `mount` is `base_from_lidar` as stated, which the motions were
    /// measured with. What moved hardly, too far or too long is left out, and so is what lies at an
    /// end of the odometry: with a clock offset there is none for it.
    pub fn new(
        mount: Pose2,
        odometry: OdometryTrack,
        by_scans: impl IntoIterator<Item = ScanMotion>,
    ) -> Self {
        let margin_ns = (1e9 * OFFSET_MAX_S) as i64;
        let span = odometry.span().unwrap_or((StampNs(0), StampNs(0)));
        let is_usable = |m: &ScanMotion| {
            let inside = m.from.0 >= span.0.0.saturating_add(margin_ns)
                && m.to.0 <= span.1.0.saturating_sub(margin_ns);
            let took_s = m.to.seconds() - m.from.seconds();
            let way_m = m.motion.translation().norm();
            let turn_rad = m.motion.theta.abs();
            let moved = way_m >= 0.3 * WAY_MIN_M || turn_rad >= 0.3 * TURN_MIN_RAD;
            let near = way_m <= WAY_MAX_M && turn_rad <= TURN_MAX_RAD && took_s <= TIME_MAX_S;
            inside && took_s > 0.0 && moved && near && m.motion.is_finite()
        };
        let by_scans = by_scans.into_iter().filter(is_usable).collect();
        Self {
            mount,
            odometry,
            by_scans,
        }
    }

    /// From the poses of a trip in the order of time, whose motions have the stated information.
    pub fn of_poses(mount: Pose2, poses: &[DrivenPose], information: &Information) -> Self {
        let odometry = OdometryTrack::through(poses.iter().map(|p| (p.stamp, p.odom_from_base)));
        let mut by_scans = Vec::new();
        let mut start: Option<(StampNs, Pose2)> = None;
        for pose in poses {
            let Some(map_from_base) = pose.map_from_base else {
                continue;
            };
            let here = (pose.stamp, map_from_base);
            let (from, there) = *start.get_or_insert(here);
            let motion = there.between(&map_from_base);
            if is_complete(&motion) {
                by_scans.push(ScanMotion {
                    from,
                    to: pose.stamp,
                    motion,
                    information: *information,
                });
                start = Some(here);
            }
        }
        Self::new(mount, odometry, by_scans)
    }

    /// `base_from_lidar` as stated.
    pub fn mount(&self) -> &Pose2 {
        &self.mount
    }

    /// The trip's odometry.
    pub fn odometry(&self) -> &OdometryTrack {
        &self.odometry
    }

    /// The motions by scans, in the order of time.
    pub fn by_scans(&self) -> &[ScanMotion] {
        &self.by_scans
    }

    /// What the wheels say of a motion, with a clock offset.
    pub(super) fn by_wheels(&self, motion: &ScanMotion, offset_ns: i64) -> Option<Pose2> {
        let (from, to) = (motion.from.0 - offset_ns, motion.to.0 - offset_ns);
        self.odometry.motion(from, to)
    }
}

/// Whether a vehicle has moved so far that its motion is worth comparing.
pub fn is_complete(motion: &Pose2) -> bool {
    motion.translation().norm() >= WAY_MIN_M || motion.theta.abs() >= TURN_MIN_RAD
}
