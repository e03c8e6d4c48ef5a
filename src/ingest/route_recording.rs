//! A route as an MCAP recording of ROS 2 messages: its grid, poses, scans and alerts.
//!
//! | topic | type | what |
//! |---|---|---|
//! | `/map` | `nav_msgs/msg/OccupancyGrid` | the map, once |
//! | `/tf` | `tf2_msgs/msg/TFMessage` | `map` → `VEHICLE/base` → `VEHICLE/lidar`, at every keyframe |
//! | `/scan` | `sensor_msgs/msg/LaserScan` | the scan of every keyframe, in `VEHICLE/lidar` |
//! | `/alerts` | `visualization_msgs/msg/MarkerArray` | an alert's region and title, when it was first seen |
//!
//! Begin with [`RouteRecording::create`].

mod messages;

use std::collections::BTreeMap;
use std::io::{Seek, Write};

use byteorder::LittleEndian;
use mcap::records::MessageHeader;
use mcap::{Compression, WriteOptions, Writer};

use crate::geometry::{Pose2, Vector2};
use messages::{
    Color, CompressedImage, Header, LINE_STRIP, LaserScan, Marker, MarkerArray, MeshFile, Message,
    OccupancyGrid, TEXT_VIEW_FACING, TfMessage, Time, TransformStamped, Vector,
};

const MAP_FRAME: &str = "map";
/// CDR with the least significant byte first, as every message says in its first four bytes.
const ENCAPSULATION: [u8; 4] = [0, 1, 0, 0];
const OUTLINE_WIDTH_M: f64 = 0.05;
const TEXT_HEIGHT_M: f64 = 0.3;
/// Orange: pending.
const PENDING: Color = Color {
    r: 0.9,
    g: 0.4,
    b: 0.0,
    a: 1.0,
};
/// Grey: decided or resolved.
const ENDED: Color = Color {
    r: 0.5,
    g: 0.5,
    b: 0.5,
    a: 0.8,
};

/// A map as a grid.
#[derive(Debug, Clone, PartialEq)]
pub struct ExportedGrid {
    /// Edge of a cell, metres.
    pub resolution_m: f64,
    /// The lower left corner, map frame.
    pub origin: Vector2<f64>,
    /// Cells along x.
    pub width: u32,
    /// Cells along y.
    pub height: u32,
    /// 0 free, 100 occupied, −1 unknown; row by row from the lowest y.
    pub cells: Vec<i8>,
}

/// A keyframe's pose, and its scan if it has one.
#[derive(Debug, Clone, PartialEq)]
pub struct ExportedKeyframe {
    /// Nanoseconds since 1970.
    pub stamp_ns: i64,
    /// The vehicle: the prefix of its frames.
    pub vehicle: String,
    /// `map_from_base`.
    pub map_from_base: Pose2,
    /// Its scan.
    pub scan: Option<ExportedScan>,
}

/// A keyframe's scan.
#[derive(Debug, Clone, PartialEq)]
pub struct ExportedScan {
    /// `base_from_lidar`.
    pub base_from_lidar: Pose2,
    /// Direction of the first beam, radians.
    pub angle_min_rad: f64,
    /// Direction of the last beam, radians.
    pub angle_max_rad: f64,
    /// Angle between two beams, radians.
    pub angle_increment_rad: f64,
    /// The shortest range, metres.
    pub range_min_m: f64,
    /// The longest range, metres.
    pub range_max_m: f64,
    /// Metres along each beam; `None` is no return, not a number an invalid reading.
    pub ranges_m: Vec<Option<f64>>,
}

/// An alert about a place.
#[derive(Debug, Clone, PartialEq)]
pub struct ExportedAlert {
    /// When it was first seen, nanoseconds since 1970.
    pub stamp_ns: i64,
    /// Its kind.
    pub kind: String,
    /// Its title.
    pub title: String,
    /// Its location, map frame.
    pub location: Vector2<f64>,
    /// A polygon round it, map frame, not closed.
    pub region: Vec<Vector2<f64>>,
    /// Whether it is pending.
    pub pending: bool,
}

/// Why a recording could not be written.
#[derive(Debug, thiserror::Error)]
pub enum RouteRecordingError {
    /// The file could not be written.
    #[error("the recording could not be written")]
    File(#[from] mcap::McapError),
    /// A message could not be written.
    #[error("a message of the recording could not be encoded")]
    Message(#[from] cdr_encoding::Error),
}

/// A topic of the recording.
struct Topic {
    channel_id: u16,
    messages: u32,
}

/// A recording that is being written; incomplete before [`RouteRecording::finish`].
pub struct RouteRecording<W: Write + Seek> {
    writer: Writer<W>,
    map: Topic,
    tf: Topic,
    scan: Topic,
    alerts: Topic,
}

impl<W: Write + Seek> RouteRecording<W> {
    /// Begins a recording; `library` names the program that writes it.
    ///
    /// # Errors
    /// [`RouteRecordingError`].
    pub fn create(into: W, library: &str) -> Result<Self, RouteRecordingError> {
        let mut writer = WriteOptions::new()
            .profile("ros2")
            .library(library)
            .compression(Some(Compression::Zstd))
            .create(into)?;
        Ok(Self {
            map: Topic::add::<OccupancyGrid, W>(&mut writer, "/map")?,
            tf: Topic::add::<TfMessage, W>(&mut writer, "/tf")?,
            scan: Topic::add::<LaserScan, W>(&mut writer, "/scan")?,
            alerts: Topic::add::<MarkerArray, W>(&mut writer, "/alerts")?,
            writer,
        })
    }

    /// Writes the map as it is from a time on.
    ///
    /// # Errors
    /// [`RouteRecordingError`].
    pub fn grid(&mut self, stamp_ns: i64, grid: ExportedGrid) -> Result<(), RouteRecordingError> {
        let origin = Pose2::new(grid.origin.x, grid.origin.y, 0.0);
        let message = OccupancyGrid {
            header: header(stamp_ns, MAP_FRAME),
            map_load_time: time(stamp_ns),
            resolution: grid.resolution_m as f32,
            width: grid.width,
            height: grid.height,
            origin: origin.into(),
            data: grid.cells,
        };
        self.map.write(&mut self.writer, stamp_ns, &message)
    }

    /// Writes where a vehicle was, and its scan.
    ///
    /// # Errors
    /// [`RouteRecordingError`].
    pub fn keyframe(&mut self, keyframe: &ExportedKeyframe) -> Result<(), RouteRecordingError> {
        let stamp_ns = keyframe.stamp_ns;
        let base = format!("{}/base", keyframe.vehicle);
        let lidar = format!("{}/lidar", keyframe.vehicle);
        let mut transforms = vec![TransformStamped {
            header: header(stamp_ns, MAP_FRAME),
            child_frame_id: base.clone(),
            transform: keyframe.map_from_base.into(),
        }];
        if let Some(scan) = &keyframe.scan {
            transforms.push(TransformStamped {
                header: header(stamp_ns, &base),
                child_frame_id: lidar.clone(),
                transform: scan.base_from_lidar.into(),
            });
        }
        let message = TfMessage { transforms };
        self.tf.write(&mut self.writer, stamp_ns, &message)?;
        let Some(scan) = &keyframe.scan else {
            return Ok(());
        };
        // REP-117: no return is an infinite range, an invalid reading is not a number.
        let range = |range: &Option<f64>| range.map_or(f32::INFINITY, |range_m| range_m as f32);
        let message = LaserScan {
            header: header(stamp_ns, &lidar),
            angle_min: scan.angle_min_rad as f32,
            angle_max: scan.angle_max_rad as f32,
            angle_increment: scan.angle_increment_rad as f32,
            time_increment: 0.0,
            scan_time: 0.0,
            range_min: scan.range_min_m as f32,
            range_max: scan.range_max_m as f32,
            ranges: scan.ranges_m.iter().map(range).collect(),
            intensities: Vec::new(),
        };
        self.scan.write(&mut self.writer, stamp_ns, &message)
    }

    /// Writes an alert.
    ///
    /// # Errors
    /// [`RouteRecordingError`].
    pub fn alert(&mut self, alert: &ExportedAlert) -> Result<(), RouteRecordingError> {
        // Ids are unique within a namespace, which is the kind and what is drawn.
        let id = i32::try_from(self.alerts.messages).unwrap_or(i32::MAX);
        let corners = alert.region.iter().chain(alert.region.first());
        let outline = Marker {
            points: corners.map(|corner| Vector::from(*corner)).collect(),
            scale: uniform(OUTLINE_WIDTH_M),
            ..marker(alert, "region", id, LINE_STRIP)
        };
        let title = Marker {
            text: alert.title.clone(),
            scale: uniform(TEXT_HEIGHT_M),
            pose: Pose2::new(alert.location.x, alert.location.y, 0.0).into(),
            ..marker(alert, "title", id, TEXT_VIEW_FACING)
        };
        let markers = vec![outline, title];
        let message = MarkerArray { markers };
        self.alerts
            .write(&mut self.writer, alert.stamp_ns, &message)
    }

    /// Writes the index and ends the recording.
    ///
    /// # Errors
    /// [`RouteRecordingError`].
    pub fn finish(mut self) -> Result<W, RouteRecordingError> {
        self.writer.finish()?;
        Ok(self.writer.into_inner())
    }
}

impl Topic {
    fn add<M: Message, W: Write + Seek>(
        writer: &mut Writer<W>,
        topic: &str,
    ) -> Result<Self, RouteRecordingError> {
        let definition = M::DEFINITION.as_bytes();
        let schema_id = writer.add_schema(M::NAME, "ros2msg", definition)?;
        let channel_id = writer.add_channel(schema_id, topic, "cdr", &BTreeMap::new())?;
        Ok(Self {
            channel_id,
            messages: 0,
        })
    }

    fn write<M: Message, W: Write + Seek>(
        &mut self,
        writer: &mut Writer<W>,
        stamp_ns: i64,
        message: &M,
    ) -> Result<(), RouteRecordingError> {
        let mut data = ENCAPSULATION.to_vec();
        data.extend(cdr_encoding::to_vec::<M, LittleEndian>(message)?);
        let time_ns = u64::try_from(stamp_ns).unwrap_or_default();
        let header = MessageHeader {
            channel_id: self.channel_id,
            sequence: self.messages,
            log_time: time_ns,
            publish_time: time_ns,
        };
        writer.write_to_known_channel(&header, &data)?;
        self.messages += 1;
        Ok(())
    }
}

fn time(stamp_ns: i64) -> Time {
    const SECOND_NS: i64 = 1_000_000_000;
    Time {
        sec: i32::try_from(stamp_ns.div_euclid(SECOND_NS)).unwrap_or(i32::MAX),
        nanosec: stamp_ns.rem_euclid(SECOND_NS) as u32,
    }
}

fn header(stamp_ns: i64, frame: &str) -> Header {
    Header {
        stamp: time(stamp_ns),
        frame_id: frame.to_owned(),
    }
}

fn uniform(size_m: f64) -> Vector {
    Vector {
        x: size_m,
        y: size_m,
        z: size_m,
    }
}

/// A marker without what it shows.
fn marker(alert: &ExportedAlert, part: &str, id: i32, shape: i32) -> Marker {
    Marker {
        header: header(alert.stamp_ns, MAP_FRAME),
        ns: format!("{}/{part}", alert.kind),
        id,
        shape,
        action: 0,
        pose: Pose2::IDENTITY.into(),
        scale: Vector::default(),
        color: match alert.pending {
            true => PENDING,
            false => ENDED,
        },
        // For ever.
        lifetime: Time::default(),
        frame_locked: false,
        points: Vec::new(),
        colors: Vec::new(),
        texture_resource: String::new(),
        texture: CompressedImage::default(),
        uv_coordinates: Vec::new(),
        text: String::new(),
        mesh_resource: String::new(),
        mesh_file: MeshFile::default(),
        mesh_use_embedded_materials: false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Cursor;

    fn keyframe() -> ExportedKeyframe {
        ExportedKeyframe {
            stamp_ns: 1_700_000_000_250_000_000,
            vehicle: "agv-07".to_owned(),
            map_from_base: Pose2::new(1.0, 2.0, std::f64::consts::FRAC_PI_2),
            scan: Some(ExportedScan {
                base_from_lidar: Pose2::new(0.2, 0.0, 0.0),
                angle_min_rad: -1.0,
                angle_max_rad: 1.0,
                angle_increment_rad: 1.0,
                range_min_m: 0.05,
                range_max_m: 20.0,
                ranges_m: vec![Some(1.5), None, Some(2.5)],
            }),
        }
    }

    #[test]
    fn the_file_has_its_topics_an_index_and_the_bytes_of_a_scan() {
        let mut recording = RouteRecording::create(Cursor::new(Vec::new()), "test").unwrap();
        recording.keyframe(&keyframe()).unwrap();
        recording
            .alert(&ExportedAlert {
                stamp_ns: 1_700_000_000_000_000_000,
                kind: "appeared".to_owned(),
                title: "Appeared".to_owned(),
                location: Vector2::new(1.0, 1.0),
                region: vec![Vector2::new(0.0, 0.0), Vector2::new(1.0, 0.0)],
                pending: true,
            })
            .unwrap();
        let bytes = recording.finish().unwrap().into_inner();

        let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
        let statistics = summary.stats.unwrap();
        assert_eq!(statistics.message_count, 3);
        assert_eq!((statistics.channel_count, statistics.schema_count), (4, 4));
        assert!(!summary.chunk_indexes.is_empty());
        let messages: Result<Vec<_>, _> = mcap::MessageStream::new(&bytes).unwrap().collect();
        let messages = messages.unwrap();
        let scan = messages
            .iter()
            .find(|m| m.channel.topic == "/scan")
            .unwrap();
        assert_eq!(scan.log_time, 1_700_000_000_250_000_000);
        let end = [
            3u32.to_le_bytes(),
            1.5f32.to_le_bytes(),
            f32::INFINITY.to_le_bytes(),
            2.5f32.to_le_bytes(),
            0u32.to_le_bytes(),
        ];
        assert!(scan.data.ends_with(&end.concat()));
        assert_eq!(scan.data[..4], ENCAPSULATION);
    }
}
