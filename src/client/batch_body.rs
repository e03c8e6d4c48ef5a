//! The body of a batch upload.

use std::io::Write;

use anyhow::Context;
use flate2::Compression;
use flate2::write::GzEncoder;
use serde::Serialize;

use crate::geometry::Pose2;
use crate::ids::{BatchId, StampNs, TripId, VehicleId};
use crate::ingest::{BatchHead, RecordedLidar, ScanToWrite, write_batch};
use crate::mapping::InitialPose;
use crate::model::BatchKind;
use crate::scan::Lidar;

/// Uncertainty of a stated initial position, metres.
const INITIAL_SIGMA_XY_M: f64 = 0.5;
/// Uncertainty of a stated initial heading, radians.
const INITIAL_SIGMA_THETA_RAD: f64 = 0.15;

/// The vehicle, its trip and its lidar.
#[derive(Debug, Clone)]
pub struct Trip {
    pub vehicle_id: VehicleId,
    pub trip_id: TripId,
    pub lidar: Lidar,
    /// `map_from_base` of the trip's first scan, roughly.
    pub initial_pose: Option<Pose2>,
}

/// A scan to send.
pub struct ScanToSend<'a> {
    pub stamp: StampNs,
    pub odom_from_base: Pose2,
    pub ranges_m: &'a [Option<f64>],
}

/// A batch ready to be sent, repeatedly if need be.
#[derive(Debug, Clone)]
pub struct EncodedBatch {
    pub kind: BatchKind,
    pub id: BatchId,
    /// The same bytes for the same content.
    pub gzip: Vec<u8>,
}

impl Trip {
    /// The trip's batch `sequence`. Its id follows from the trip and the sequence, so that a
    /// repeated upload is recognised.
    pub fn encode<'a>(
        &self,
        sequence: usize,
        scans: impl IntoIterator<Item = ScanToSend<'a>>,
    ) -> anyhow::Result<EncodedBatch> {
        let lidars = [RecordedLidar {
            name: None,
            geometry: self.lidar.clone(),
            beams: 0,
            time_increment_s: 0.0,
            scan_time_s: 0.0,
        }];
        let head = BatchHead {
            vehicle_id: &self.vehicle_id,
            trip_id: &self.trip_id,
            initial_pose: self.initial_pose.map(rough),
            lidars: &lidars,
        };
        let scans = scans.into_iter().map(|scan| ScanToWrite {
            lidar: 0,
            stamp: scan.stamp,
            odom_from_base: scan.odom_from_base,
            ranges_m: scan.ranges_m,
        });
        let json = write_batch(&head, sequence, scans)?;
        EncodedBatch::of_json(BatchKind::Scans, &self.trip_id, sequence, &json)
    }
}

impl EncodedBatch {
    /// The trip's batch `sequence`, of what it holds as JSON.
    pub fn of(
        kind: BatchKind,
        trip_id: &TripId,
        sequence: usize,
        body: &impl Serialize,
    ) -> anyhow::Result<Self> {
        Self::of_json(kind, trip_id, sequence, &serde_json::to_vec(body)?)
    }

    /// The trip's batch `sequence`, of its JSON.
    pub fn of_json(
        kind: BatchKind,
        trip_id: &TripId,
        sequence: usize,
        json: &[u8],
    ) -> anyhow::Result<Self> {
        let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
        encoder.write_all(json)?;
        Ok(Self {
            kind,
            id: batch_id(trip_id, sequence)?,
            gzip: encoder.finish()?,
        })
    }
}

/// A stated initial pose with its uncertainty.
pub fn rough(pose: Pose2) -> InitialPose {
    InitialPose {
        pose,
        sigma_xy_m: INITIAL_SIGMA_XY_M,
        sigma_theta_rad: INITIAL_SIGMA_THETA_RAD,
    }
}

/// The id of a trip's batch.
fn batch_id(trip_id: &TripId, sequence: usize) -> anyhow::Result<BatchId> {
    BatchId::new(format!("{trip_id}-{sequence:05}"))
        .with_context(|| format!("the trip's name {trip_id} is too long: choose one with --trip"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Read;

    fn trip() -> Trip {
        Trip {
            vehicle_id: VehicleId::new("agv-07").unwrap(),
            trip_id: TripId::new("monday").unwrap(),
            lidar: Lidar {
                angle_min_rad: -1.5,
                angle_increment_rad: 0.5,
                range_min_m: 0.05,
                range_max_m: 20.0,
                mount: Pose2::new(0.2, 0.0, 0.0),
                range_sigma_m: 0.01,
                band: None,
            },
            initial_pose: Some(Pose2::new(3.5, 3.4, 0.25)),
        }
    }

    fn encode(sequence: usize) -> EncodedBatch {
        let scan = ScanToSend {
            stamp: StampNs(976_052_890_244_111_000),
            odom_from_base: Pose2::new(1.0, -2.0, 0.5),
            ranges_m: &[Some(1.92), None, Some(1.95)],
        };
        trip().encode(sequence, [scan]).unwrap()
    }

    fn unzip(batch: &EncodedBatch) -> String {
        let mut text = String::new();
        let mut decoder = flate2::read::GzDecoder::new(batch.gzip.as_slice());
        decoder.read_to_string(&mut text).unwrap();
        text
    }

    #[test]
    fn the_body_is_what_the_interface_takes() {
        let batch = encode(0);
        assert_eq!(batch.id.as_str(), "monday-00000");
        let expected = concat!(
            r#"{"vehicle_id":"agv-07","trip_id":"monday","sequence":0,"#,
            r#""lidar":{"angle_min":-1.5,"angle_increment":0.5,"range_min":0.05,"#,
            r#""range_max":20.0,"mount":{"x":0.2,"y":0.0,"theta":0.0},"range_sigma":0.01},"#,
            r#""initial_pose":{"x":3.5,"y":3.4,"theta":0.25,"sigma_xy":0.5,"sigma_theta":0.15},"#,
            r#""scans":[{"stamp":"2000-12-05T21:48:10.244111Z","#,
            r#""odometry":{"x":1.0,"y":-2.0,"theta":0.5},"ranges":[1.92,null,1.95]}]}"#,
        );
        assert_eq!(unzip(&batch), expected);
    }

    #[test]
    fn a_repeat_has_the_same_id_and_bytes() {
        let (once, again) = (encode(7), encode(7));
        assert_eq!((once.id, once.gzip), (again.id, again.gzip));
        assert!(!unzip(&encode(1)).contains("initial_pose"));
    }
}
