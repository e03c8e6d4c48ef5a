//! ROS 2 messages: CDR behind a head of four bytes, which says in which order the bytes are.

use byteorder::{BigEndian, LittleEndian};
use serde::Deserialize;

use super::messages::{OdometryMessage, ScanMessage, TransformMessage, from_above, isometry};
use crate::scan::BEAMS_MAX;

#[derive(Deserialize)]
struct Time {
    sec: i32,
    nanosec: u32,
}

#[derive(Deserialize)]
struct Header {
    stamp: Time,
    frame_id: String,
}

/// `geometry_msgs/msg/Point` and `Vector3`.
#[derive(Deserialize)]
struct Vector {
    x: f64,
    y: f64,
    z: f64,
}

#[derive(Deserialize)]
struct Quaternion {
    x: f64,
    y: f64,
    z: f64,
    w: f64,
}

/// `geometry_msgs/msg/Pose` and `Transform`.
#[derive(Deserialize)]
struct Pose {
    position: Vector,
    orientation: Quaternion,
}

/// `sensor_msgs/msg/LaserScan` without its intensities, which come last.
#[derive(Deserialize)]
struct LaserScan {
    header: Header,
    angle_min: f32,
    _angle_max: f32,
    angle_increment: f32,
    time_increment: f32,
    scan_time: f32,
    range_min: f32,
    range_max: f32,
    ranges: Vec<f32>,
}

/// `nav_msgs/msg/Odometry` up to its pose.
#[derive(Deserialize)]
struct Odometry {
    header: Header,
    child_frame_id: String,
    pose: Pose,
}

/// `tf2_msgs/msg/TFMessage`.
#[derive(Deserialize)]
struct Transforms {
    transforms: Vec<Transform>,
}

/// `geometry_msgs/msg/TransformStamped`.
#[derive(Deserialize)]
struct Transform {
    header: Header,
    child_frame_id: String,
    transform: Pose,
}

impl Time {
    fn nanoseconds(&self) -> i64 {
        i64::from(self.sec) * 1_000_000_000 + i64::from(self.nanosec)
    }
}

impl Pose {
    fn isometry(&self) -> Option<nalgebra::Isometry3<f64>> {
        let (t, q) = (&self.position, &self.orientation);
        isometry([t.x, t.y, t.z], [q.x, q.y, q.z, q.w])
    }
}

/// The beginning of a message; what follows it may be anything.
fn message<'a, T: Deserialize<'a>>(bytes: &'a [u8]) -> Option<T> {
    let (head, body) = bytes.split_at_checked(4)?;
    let read = match head[..2] {
        [0, 0] => cdr_encoding::from_bytes::<T, BigEndian>(body),
        [0, 1] => cdr_encoding::from_bytes::<T, LittleEndian>(body),
        _ => return None,
    };
    read.ok().map(|(message, _)| message)
}

pub(super) fn scan(bytes: &[u8]) -> Option<ScanMessage> {
    let scan: LaserScan = message(bytes)?;
    if scan.ranges.len() > BEAMS_MAX {
        return None;
    }
    Some(ScanMessage {
        stamp_ns: scan.header.stamp.nanoseconds(),
        frame_id: scan.header.frame_id,
        angle_min_rad: scan.angle_min.into(),
        angle_increment_rad: scan.angle_increment.into(),
        range_min_m: decimal(scan.range_min),
        range_max_m: Some(decimal(scan.range_max)),
        time_increment_s: decimal(scan.time_increment),
        scan_time_s: decimal(scan.scan_time),
        frame_from_origin: nalgebra::Isometry3::identity(),
        ranges_m: scan.ranges.into_iter().map(f64::from).collect(),
    })
}

pub(super) fn odometry(bytes: &[u8]) -> Option<OdometryMessage> {
    let odometry: Odometry = message(bytes)?;
    let base_frame = odometry.child_frame_id;
    Some(OdometryMessage {
        stamp_ns: odometry.header.stamp.nanoseconds(),
        base_frame: Some(base_frame).filter(|frame| !frame.is_empty()),
        odom_from_base: from_above(&odometry.pose.isometry()?),
    })
}

pub(super) fn transforms(bytes: &[u8]) -> Vec<TransformMessage> {
    let message = message(bytes).unwrap_or(Transforms {
        transforms: Vec::new(),
    });
    let transforms = message.transforms.into_iter();
    let checked = transforms.filter_map(|transform| {
        Some(TransformMessage {
            stamp_ns: transform.header.stamp.nanoseconds(),
            parent_from_child: transform.transform.isometry()?,
            parent: transform.header.frame_id,
            child: transform.child_frame_id,
        })
    });
    checked.collect()
}

/// A number as somebody wrote it: 0.12 rather than 0.11999999731779099.
fn decimal(value: f32) -> f64 {
    value.to_string().parse().unwrap_or_else(|_| value.into())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A `nav_msgs/msg/Odometry` up to its pose, of a quarter turn.
    fn odometry_bytes(is_little: bool) -> Vec<u8> {
        let mut bytes = vec![0, u8::from(is_little), 0, 0];
        let begin = bytes.len();
        let number = |bytes: &mut Vec<u8>, value: u32| {
            while !(bytes.len() - begin).is_multiple_of(4) {
                bytes.push(0);
            }
            bytes.extend(match is_little {
                true => value.to_le_bytes(),
                false => value.to_be_bytes(),
            });
        };
        number(&mut bytes, 7);
        number(&mut bytes, 5);
        for name in ["odom", "base_link"] {
            number(&mut bytes, name.len() as u32 + 1);
            bytes.extend(name.bytes().chain([0]));
        }
        while !(bytes.len() - begin).is_multiple_of(8) {
            bytes.push(0);
        }
        let half = std::f64::consts::FRAC_1_SQRT_2;
        for value in [1.5, -2.0, 0.0, 0.0, 0.0, half, half] {
            bytes.extend(match is_little {
                true => f64::to_le_bytes(value),
                false => f64::to_be_bytes(value),
            });
        }
        bytes
    }

    #[test]
    fn both_orders_of_bytes_are_read() {
        for is_little in [true, false] {
            let read = odometry(&odometry_bytes(is_little)).unwrap();
            assert_eq!(read.stamp_ns, 7_000_000_005);
            assert_eq!(read.base_frame.as_deref(), Some("base_link"));
            let off = (read.odom_from_base.theta - std::f64::consts::FRAC_PI_2).abs();
            assert!(off < 1e-12 && read.odom_from_base.x == 1.5, "{read:?}");
        }
    }

    #[test]
    fn what_is_cut_or_encoded_otherwise_is_no_message() {
        let bytes = odometry_bytes(true);
        for end in 0..bytes.len() {
            assert_eq!(odometry(&bytes[..end]), None, "{end}");
        }
        let mut other = bytes;
        other[1] = 3;
        assert_eq!(odometry(&other), None);
        assert!(transforms(&[0, 1, 0, 0, 0xff, 0xff, 0xff, 0xff]).is_empty());
    }

    #[test]
    fn numbers_are_those_that_were_written() {
        assert_eq!(decimal(0.12), 0.12);
        assert_eq!(decimal(3.5), 3.5);
    }
}
