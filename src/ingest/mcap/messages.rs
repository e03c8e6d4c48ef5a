//! The messages that are read, whatever their encoding.

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};

use super::container::Channel;
use crate::geometry::Pose2;

/// What a topic carries.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Content {
    /// Sweeps of a lidar.
    Scans,
    /// Where the vehicle's odometry has it.
    Odometry,
    /// Where frames are in other frames.
    Transforms,
}

/// A sweep of a lidar.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct ScanMessage {
    /// As stated; 0 if it is not.
    pub stamp_ns: i64,
    pub frame_id: String,
    pub angle_min_rad: f64,
    /// Negative of a lidar that turns clockwise.
    pub angle_increment_rad: f64,
    pub range_min_m: f64,
    /// `None` if the message does not state it.
    pub range_max_m: Option<f64>,
    pub time_increment_s: f64,
    pub scan_time_s: f64,
    /// Where the scan's origin is in its frame.
    pub frame_from_origin: Isometry3<f64>,
    /// As stated: with NaN, infinities, and values outside of the limits.
    pub ranges_m: Vec<f64>,
}

/// Where the odometry has the vehicle.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct OdometryMessage {
    /// As stated; 0 if it is not.
    pub stamp_ns: i64,
    /// The vehicle's frame; `None` if the message does not name it.
    pub base_frame: Option<String>,
    pub odom_from_base: Pose2,
}

/// Where a frame is in another.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct TransformMessage {
    /// As stated; 0 if it is not.
    pub stamp_ns: i64,
    pub parent: String,
    pub child: String,
    pub parent_from_child: Isometry3<f64>,
}

const READ: [(&str, &str, Content); 7] = [
    ("cdr", "sensor_msgs/msg/LaserScan", Content::Scans),
    ("cdr", "nav_msgs/msg/Odometry", Content::Odometry),
    ("cdr", "tf2_msgs/msg/TFMessage", Content::Transforms),
    ("json", "foxglove.LaserScan", Content::Scans),
    ("json", "foxglove.PoseInFrame", Content::Odometry),
    ("json", "foxglove.FrameTransform", Content::Transforms),
    ("json", "foxglove.FrameTransforms", Content::Transforms),
];

/// What a channel carries, if it is read.
pub(super) fn content_of(channel: &Channel) -> Option<Content> {
    let is_same = |(encoding, schema, _): &&(&str, &str, Content)| {
        *encoding == channel.encoding && *schema == channel.schema
    };
    READ.iter().find(is_same).map(|(_, _, content)| *content)
}

/// A transform of a translation and a quaternion (x, y, z, w); `None` if it is not finite or the
/// quaternion is no rotation.
pub(super) fn isometry(translation: [f64; 3], quaternion: [f64; 4]) -> Option<Isometry3<f64>> {
    let [x, y, z, w] = quaternion;
    let quaternion = Quaternion::new(w, x, y, z);
    let norm = quaternion.norm();
    let is_sound = translation.iter().all(|v| v.is_finite()) && norm.is_finite() && norm > 1e-3;
    is_sound.then(|| {
        let translation = Translation3::from(translation);
        Isometry3::from_parts(translation, UnitQuaternion::new_normalize(quaternion))
    })
}

/// The transform seen from above: translation, and where the x axis points.
pub(super) fn from_above(transform: &Isometry3<f64>) -> Pose2 {
    let forward = transform.rotation * Vector3::x();
    let translation = &transform.translation;
    Pose2::new(translation.x, translation.y, forward.y.atan2(forward.x))
}
