//! The ROS 2 messages of a recording, field by field in the order of their definitions.

use serde::Serialize;

use crate::geometry::{Pose2, Vector2};

/// A message with the name and the text of its definition.
pub(super) trait Message: Serialize {
    const NAME: &'static str;
    const DEFINITION: &'static str;
}

macro_rules! message {
    ($message:ty, $name:literal, $file:literal) => {
        impl Message for $message {
            const NAME: &'static str = $name;
            const DEFINITION: &'static str = include_str!(concat!("definitions/", $file));
        }
    };
}

message!(
    OccupancyGrid,
    "nav_msgs/msg/OccupancyGrid",
    "occupancy_grid.msg"
);
message!(TfMessage, "tf2_msgs/msg/TFMessage", "tf_message.msg");
message!(LaserScan, "sensor_msgs/msg/LaserScan", "laser_scan.msg");
message!(
    MarkerArray,
    "visualization_msgs/msg/MarkerArray",
    "marker_array.msg"
);

/// `builtin_interfaces/msg/Time`, and `Duration`, which looks the same.
#[derive(Debug, Default, Clone, Copy, Serialize)]
pub(super) struct Time {
    pub sec: i32,
    pub nanosec: u32,
}

#[derive(Debug, Default, Clone, Serialize)]
pub(super) struct Header {
    pub stamp: Time,
    pub frame_id: String,
}

/// `geometry_msgs/msg/Point` and `Vector3`.
#[derive(Debug, Default, Clone, Copy, Serialize)]
pub(super) struct Vector {
    pub x: f64,
    pub y: f64,
    pub z: f64,
}

#[derive(Debug, Clone, Copy, Serialize)]
pub(super) struct Quaternion {
    x: f64,
    y: f64,
    z: f64,
    w: f64,
}

/// `geometry_msgs/msg/Pose` and `Transform`.
#[derive(Debug, Clone, Copy, Serialize)]
pub(super) struct Pose {
    position: Vector,
    orientation: Quaternion,
}

impl From<Vector2<f64>> for Vector {
    fn from(point: Vector2<f64>) -> Self {
        Self {
            x: point.x,
            y: point.y,
            z: 0.0,
        }
    }
}

impl From<Pose2> for Pose {
    fn from(pose: Pose2) -> Self {
        let (sin, cos) = (0.5 * pose.theta).sin_cos();
        Self {
            position: pose.translation().into(),
            orientation: Quaternion {
                x: 0.0,
                y: 0.0,
                z: sin,
                w: cos,
            },
        }
    }
}

#[derive(Debug, Serialize)]
pub(super) struct OccupancyGrid {
    pub header: Header,
    pub map_load_time: Time,
    pub resolution: f32,
    pub width: u32,
    pub height: u32,
    pub origin: Pose,
    pub data: Vec<i8>,
}

#[derive(Debug, Serialize)]
pub(super) struct TfMessage {
    pub transforms: Vec<TransformStamped>,
}

#[derive(Debug, Serialize)]
pub(super) struct TransformStamped {
    pub header: Header,
    pub child_frame_id: String,
    pub transform: Pose,
}

#[derive(Debug, Serialize)]
pub(super) struct LaserScan {
    pub header: Header,
    pub angle_min: f32,
    pub angle_max: f32,
    pub angle_increment: f32,
    pub time_increment: f32,
    pub scan_time: f32,
    pub range_min: f32,
    pub range_max: f32,
    pub ranges: Vec<f32>,
    pub intensities: Vec<f32>,
}

#[derive(Debug, Serialize)]
pub(super) struct MarkerArray {
    pub markers: Vec<Marker>,
}

/// Shapes of a [`Marker`].
pub(super) const LINE_STRIP: i32 = 4;
pub(super) const TEXT_VIEW_FACING: i32 = 9;

#[derive(Debug, Serialize)]
pub(super) struct Marker {
    pub header: Header,
    pub ns: String,
    pub id: i32,
    #[serde(rename = "type")]
    pub shape: i32,
    pub action: i32,
    pub pose: Pose,
    pub scale: Vector,
    pub color: Color,
    pub lifetime: Time,
    pub frame_locked: bool,
    pub points: Vec<Vector>,
    pub colors: Vec<Color>,
    pub texture_resource: String,
    pub texture: CompressedImage,
    pub uv_coordinates: Vec<[f32; 2]>,
    pub text: String,
    pub mesh_resource: String,
    pub mesh_file: MeshFile,
    pub mesh_use_embedded_materials: bool,
}

/// `std_msgs/msg/ColorRGBA`.
#[derive(Debug, Clone, Copy, Serialize)]
pub(super) struct Color {
    pub r: f32,
    pub g: f32,
    pub b: f32,
    pub a: f32,
}

#[derive(Debug, Default, Serialize)]
pub(super) struct CompressedImage {
    header: Header,
    format: String,
    data: Vec<u8>,
}

#[derive(Debug, Default, Serialize)]
pub(super) struct MeshFile {
    filename: String,
    data: Vec<u8>,
}
