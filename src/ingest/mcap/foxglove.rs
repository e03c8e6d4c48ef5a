//! Foxglove's messages as JSON.

use std::fmt;

use serde::Deserialize;
use serde::de::{Deserializer, Error, SeqAccess, Visitor};

use super::messages::{OdometryMessage, ScanMessage, TransformMessage, from_above, isometry};
use crate::scan::BEAMS_MAX;

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
    ranges: Ranges,
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

/// Ranges, metres: no more than a scan may have, so that longer lists are not kept.
struct Ranges(Vec<f64>);

/// A range, metres. JSON has no infinity: writers send null, or a word. Other words are not a number.
struct Range(f64);

impl<'de> Deserialize<'de> for Ranges {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct RangesVisitor;
        impl<'de> Visitor<'de> for RangesVisitor {
            type Value = Ranges;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, "at most {BEAMS_MAX} ranges")
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Ranges, A::Error> {
                let mut ranges_m = Vec::new();
                while let Some(Range(range_m)) = seq.next_element()? {
                    if ranges_m.len() == BEAMS_MAX {
                        return Err(A::Error::invalid_length(BEAMS_MAX + 1, &self));
                    }
                    ranges_m.push(range_m);
                }
                Ok(Ranges(ranges_m))
            }
        }
        deserializer.deserialize_seq(RangesVisitor)
    }
}

impl<'de> Deserialize<'de> for Range {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct RangeVisitor;
        impl Visitor<'_> for RangeVisitor {
            type Value = Range;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a number, null or a word")
            }

            fn visit_f64<E: Error>(self, range_m: f64) -> Result<Range, E> {
                Ok(Range(range_m))
            }

            fn visit_i64<E: Error>(self, range_m: i64) -> Result<Range, E> {
                Ok(Range(range_m as f64))
            }

            fn visit_u64<E: Error>(self, range_m: u64) -> Result<Range, E> {
                Ok(Range(range_m as f64))
            }

            fn visit_unit<E: Error>(self) -> Result<Range, E> {
                Ok(Range(f64::INFINITY))
            }

            fn visit_str<E: Error>(self, word: &str) -> Result<Range, E> {
                Ok(Range(match word {
                    "Infinity" => f64::INFINITY,
                    _ => f64::NAN,
                }))
            }
        }
        deserializer.deserialize_any(RangeVisitor)
    }
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
    let Ranges(ranges_m) = scan.ranges;
    let steps = ranges_m.len().saturating_sub(1).max(1);
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
        ranges_m,
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

    fn scan_with(ranges: &str) -> Option<ScanMessage> {
        let text =
            format!(r#"{{"frame_id":"laser","start_angle":-1,"end_angle":1,"ranges":[{ranges}]}}"#);
        scan(text.as_bytes())
    }

    #[test]
    fn words_that_are_no_infinity_are_invalid() {
        let read = scan_with(r#""NaN","-Infinity","far",2"#).unwrap();
        assert!(read.ranges_m[..3].iter().all(|range_m| range_m.is_nan()));
        assert_eq!(read.ranges_m[3], 2.0);
        assert_eq!(scan_with("[1],2"), None);
    }

    #[test]
    fn more_ranges_than_a_scan_may_have_are_no_scan() {
        let most = scan_with(&vec!["1"; BEAMS_MAX].join(",")).unwrap();
        assert_eq!(most.ranges_m.len(), BEAMS_MAX);
        assert_eq!(scan_with(&vec!["1"; BEAMS_MAX + 1].join(",")), None);
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
