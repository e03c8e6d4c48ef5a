//! Parts of maps for tests.

use std::sync::Arc;

use super::keyframe::Keyframe;
use crate::geometry::Pose2;
use crate::ids::{NodeId, StampNs, TripId};
use crate::scan::{LaserScan, Lidar};

/// A keyframe whose lidar sees nothing.
pub(super) fn blind_keyframe(id: i64, trip: TripId, stamp: StampNs) -> Keyframe {
    let lidar = Lidar {
        angle_min_rad: 0.0,
        angle_increment_rad: 1.0,
        range_min_m: 0.1,
        range_max_m: 5.0,
        mount: Pose2::IDENTITY,
        range_sigma_m: 0.01,
        band: None,
    };
    let scan = LaserScan::new(Arc::new(lidar), [None; 3]).unwrap();
    Keyframe::new(NodeId(id), trip, stamp, Pose2::IDENTITY, scan)
}
