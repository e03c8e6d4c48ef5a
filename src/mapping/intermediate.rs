//! Scans between keyframes: they say what stands where, and never enter the graph.

use super::drive::DriveScan;
use crate::geometry::Pose2;
use crate::ids::{LidarId, StampNs};
use crate::scan::LaserScan;

/// The lidar beside the one that takes a trip's keyframes, of a scan that it took.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Companion {
    /// As the vehicle names it.
    pub lidar: LidarId,
    /// Whether the scan was taken so near in time to its keyframe's that its points count as the
    /// keyframe's.
    pub lends: bool,
}

/// A scan that was taken after a keyframe and before the next one of its trip, or by another lidar
/// at about the time of the keyframe.
#[derive(Debug, Clone, PartialEq)]
pub struct IntermediateScan {
    /// When it was taken.
    pub stamp: StampNs,
    /// Pose of the base in the frame of the keyframe's base: it moves rigidly with the keyframe.
    pub keyframe_from_base: Pose2,
    /// Pose of the base in the vehicle's own odometry frame.
    pub odom_from_base: Pose2,
    /// Of a lidar beside the one that took the keyframe; `None` for a scan of that one.
    pub companion: Option<Companion>,
    /// What was seen; `None` where it would repeat the scan before.
    pub scan: Option<LaserScan>,
}

impl IntermediateScan {
    /// A scan of which nobody knows where it was taken.
    pub(super) fn unseen(keyframe_from_base: Pose2, scan: &DriveScan) -> Self {
        Self {
            stamp: scan.stamp,
            keyframe_from_base,
            odom_from_base: scan.odom_from_base,
            companion: None,
            scan: None,
        }
    }

    /// A companion's scan that lends its points to the keyframe of a primary scan; `None` if it
    /// has no name.
    pub(super) fn lending(scan: &DriveScan, primary: &DriveScan) -> Option<Self> {
        Some(Self {
            stamp: scan.stamp,
            keyframe_from_base: primary.odom_from_base.between(&scan.odom_from_base),
            odom_from_base: scan.odom_from_base,
            companion: Some(Companion::of(scan, true)?),
            scan: Some(scan.scan.clone()),
        })
    }

    /// The pose and the scan of a companion that lends its keyframe its points.
    pub fn lent(&self) -> Option<(Pose2, &LaserScan)> {
        let companion = self.companion.as_ref()?;
        let scan = self.scan.as_ref()?;
        companion.lends.then_some((self.keyframe_from_base, scan))
    }

    /// The companion that took it; `None` for the lidar that took its keyframe.
    pub fn companion_lidar(&self) -> Option<&LidarId> {
        self.companion.as_ref().map(|companion| &companion.lidar)
    }

    /// About how much memory it takes, bytes.
    pub(super) fn size_bytes(&self) -> usize {
        size_of::<Self>() + self.scan.as_ref().map_or(0, |s| size_of_val(s.ticks()))
    }
}

impl Companion {
    pub(super) fn of(scan: &DriveScan, lends: bool) -> Option<Self> {
        let lidar = scan.lidar.name.clone()?;
        Some(Self { lidar, lends })
    }
}
