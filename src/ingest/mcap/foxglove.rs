//! Foxglove's messages as JSON.

use serde::Deserialize;
use serde_json::Value;

use super::messages::{OdometryMessage, ScanMessage, TransformMessage, from_above, isometry};

#[derive(Deserialize, Clone, Copy, Default)]
struct Time {
    #[serde(default)]
    sec: i64,
    #[serde(default)]
    nsec: i64,
}

#[derive(Deserialize, Clone, Copy, Default)]
struct Vector {
    #[serde(default)]
    x: f64,
    #[serde(default)]
    y: f64,
    #[serde(default)]
    z: f64,
}

#[derive(Deserialize, Clone, Copy)]
struct Quaternion {
    #[serde(default)]
    x: f64,
    #[serde(default)]
    y: f64,
    #[serde(default)]
    z: f64,
    #[serde(default)]
    w: f64,
}

#[derive(Deserialize, Clone, Copy)]
struct Pose {
    #[serde(default)]
    position: Vector,
    orientation: Quaternion,
}

#[derive(Deserialize)]
struct LaserScan {
    #[serde(default)]
    timestamp: Time,
    frame_id: String,
    pose: Option<Pose>,
    start_angle: f64,
    end_angle: f64,
    ranges: Vec<Value>,
}

#[derive(Deserialize)]
struct PoseInFrame {
    #[serde(default)]
    timestamp: Time,
    pose: Pose,
}

#[derive(Deserialize)]
struct FrameTransform {
    #[serde(default)]
    timestamp: Time,
    parent_frame_id: String,
    child_frame_id: String,
    #[serde(default)]
    translation: Vector,
    rotation: Quaternion,
}

#[derive(Deserialize)]
struct FrameTransforms {
    transforms: Vec<FrameTransform>,
}

impl Time {
    fn nanoseconds(self) -> i64 {
        self.sec
            .saturating_mul(1_000_000_000)
            .saturating_add(self.nsec)
    }
}

fn isometry_of(translation: Vector, rotation: Quaternion) -> Option<nalgebra::Isometry3<f64>> {
    let (t, q) = (translation, rotation);
    isometry([t.x, t.y, t.z], [q.x, q.y, q.z, q.w])
}

pub(super) fn scan(bytes: &[u8]) -> Option<ScanMessage> {
    let scan: LaserScan = serde_json::from_slice(bytes).ok()?;
    let frame_from_origin = match scan.pose {
        Some(pose) => isometry_of(pose.position, pose.orientation)?,
        None => nalgebra::Isometry3::identity(),
    };
    let steps = scan.ranges.len().saturating_sub(1).max(1);
    Some(ScanMessage {
        stamp_ns: scan.timestamp.nanoseconds(),
        frame_id: scan.frame_id,
        angle_min_rad: scan.start_angle,
        angle_increment_rad: (scan.end_angle - scan.start_angle) / steps as f64,
        range_min_m: 0.0,
        range_max_m: None,
        time_increment_s: 0.0,
        scan_time_s: 0.0,
        frame_from_origin,
        // JSON has no infinity: writers send null, or a word.
        ranges_m: scan
            .ranges
            .iter()
            .map(|range| range.as_f64().unwrap_or(f64::INFINITY))
            .collect(),
    })
}

pub(super) fn odometry(bytes: &[u8]) -> Option<OdometryMessage> {
    let message: PoseInFrame = serde_json::from_slice(bytes).ok()?;
    let pose = isometry_of(message.pose.position, message.pose.orientation)?;
    Some(OdometryMessage {
        stamp_ns: message.timestamp.nanoseconds(),
        base_frame: None,
        odom_from_base: from_above(&pose),
    })
}

pub(super) fn transforms(bytes: &[u8], schema: &str) -> Vec<TransformMessage> {
    let transforms = if schema.ends_with('s') {
        let several = serde_json::from_slice::<FrameTransforms>(bytes);
        several.map_or_else(|_| Vec::new(), |several| several.transforms)
    } else {
        serde_json::from_slice(bytes).into_iter().collect()
    };
    let checked = transforms
        .into_iter()
        .filter_map(|transform: FrameTransform| {
            Some(TransformMessage {
                stamp_ns: transform.timestamp.nanoseconds(),
                parent_from_child: isometry_of(transform.translation, transform.rotation)?,
                parent: transform.parent_frame_id,
                child: transform.child_frame_id,
            })
        });
    checked.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scan_without_returns_is_read() {
        let text = br#"{"timestamp":{"sec":7,"nsec":5},"frame_id":"laser","start_angle":-1,
            "end_angle":1,"ranges":[1.5,null,"Infinity"],"intensities":[]}"#;
        let read = scan(text).unwrap();
        assert_eq!(
            (read.stamp_ns, read.angle_increment_rad),
            (7_000_000_005, 1.0)
        );
        assert_eq!(read.ranges_m, [1.5, f64::INFINITY, f64::INFINITY]);
        assert_eq!(scan(b"{}"), None);
    }

    #[test]
    fn transforms_come_alone_or_together() {
        let one = r#"{"timestamp":{"sec":1},"parent_frame_id":"odom","child_frame_id":"base_link",
            "translation":{"x":1,"y":2,"z":3},"rotation":{"x":0,"y":0,"z":0,"w":1}}"#;
        let several = format!(r#"{{"transforms":[{one},{one}]}}"#);
        assert_eq!(
            transforms(one.as_bytes(), "foxglove.FrameTransform").len(),
            1
        );
        assert_eq!(
            transforms(several.as_bytes(), "foxglove.FrameTransforms").len(),
            2
        );
        assert!(transforms(several.as_bytes(), "foxglove.FrameTransform").is_empty());
    }
}
