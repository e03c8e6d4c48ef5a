//! Writes batches of scans as the API accepts them.

use jiff::Timestamp;
use serde::Serialize;

use super::batch_json::BEAMS_TOTAL_MAX;
use super::recorded::{RecordedLidar, RecordedScan};
use super::recording::RecordingError;
use crate::geometry::Pose2;
use crate::ids::{StampNs, TripId, VehicleId};
use crate::mapping::InitialPose;

/// The common properties of a batch's scans.
#[derive(Debug, Clone, Copy)]
pub struct BatchHead<'a> {
    /// The vehicle.
    pub vehicle_id: &'a VehicleId,
    /// The trip.
    pub trip_id: &'a TripId,
    /// Approximate pose at the trip's first scan; only the trip's first batch states it.
    pub initial_pose: Option<InitialPose>,
    /// The vehicle's lidars: one without a name, or several with one.
    pub lidars: &'a [RecordedLidar],
}

/// A scan to write.
#[derive(Debug, Clone, Copy)]
pub struct ScanToWrite<'a> {
    /// Index of its lidar.
    pub lidar: usize,
    /// When it was taken.
    pub stamp: StampNs,
    /// `odom_from_base`.
    pub odom_from_base: Pose2,
    /// Metres, `None` for no return.
    pub ranges_m: &'a [Option<f64>],
}

/// Why a batch cannot be written.
#[derive(Debug, thiserror::Error)]
pub enum WriteError {
    /// A stamp is not a valid time.
    #[error("the stamp of a scan is no time")]
    Stamp(#[from] jiff::Error),
    /// It cannot be written as JSON.
    #[error("a batch cannot be written as JSON")]
    Json(#[from] serde_json::Error),
    /// The recording cannot be read.
    #[error(transparent)]
    Recording(#[from] RecordingError),
}

/// The batch `sequence` of a trip: the same bytes for the same content.
///
/// # Errors
/// [`WriteError`] if a stamp is not a valid time.
pub fn write_batch<'a>(
    head: &BatchHead<'_>,
    sequence: usize,
    scans: impl IntoIterator<Item = ScanToWrite<'a>>,
) -> Result<Vec<u8>, WriteError> {
    let is_alone = matches!(head.lidars, [lidar] if lidar.name.is_none());
    let scans = scans.into_iter().map(|scan| {
        let lidar = head.lidars.get(scan.lidar);
        let name = lidar.and_then(|lidar| lidar.name.as_ref());
        Ok(ScanJson {
            stamp: Timestamp::from_nanosecond(i128::from(scan.stamp.0))?,
            lidar: name.map(|name| name.as_str()),
            odometry: pose_json(&scan.odom_from_base),
            ranges: scan.ranges_m,
        })
    });
    let body = BatchJson {
        vehicle_id: head.vehicle_id.as_str(),
        trip_id: head.trip_id.as_str(),
        sequence,
        lidar: head.lidars.first().filter(|_| is_alone).map(lidar_json),
        lidars: (!is_alone).then(|| head.lidars.iter().map(lidar_json).collect()),
        initial_pose: head.initial_pose.filter(|_| sequence == 0).map(|initial| {
            let pose = initial.pose;
            InitialPoseJson {
                x: pose.x,
                y: pose.y,
                theta: pose.theta,
                sigma_xy: initial.sigma_xy_m,
                sigma_theta: initial.sigma_theta_rad,
            }
        }),
        scans: scans.collect::<Result<_, jiff::Error>>()?,
    };
    Ok(serde_json::to_vec(&body)?)
}

/// The scans of a recording as the batches of a trip.
pub struct BatchWriter<'a, I> {
    head: BatchHead<'a>,
    scans: I,
    scans_max: usize,
    sequence: usize,
}

/// A batch of a recording.
pub struct WrittenBatch {
    /// 0, 1, 2 … within the trip.
    pub sequence: usize,
    /// The body as the API accepts it.
    pub json: Vec<u8>,
    /// Number of its scans.
    pub scans: usize,
    /// The stamps of the first scan and of the last one.
    pub stamps: [StampNs; 2],
}

impl<'a, I> BatchWriter<'a, I>
where
    I: Iterator<Item = Result<(usize, RecordedScan), RecordingError>>,
{
    /// Writes up to this many scans into a batch, or as many as its beams allow.
    pub fn new(head: BatchHead<'a>, scans: I, scans_max: usize) -> Self {
        let beams = head.lidars.iter().map(|lidar| lidar.beams).max();
        let by_beams = BEAMS_TOTAL_MAX / beams.unwrap_or(1).max(1);
        Self {
            head,
            scans,
            scans_max: scans_max.min(by_beams).max(1),
            sequence: 0,
        }
    }

    /// The source of the scans.
    pub fn scans(&self) -> &I {
        &self.scans
    }

    fn next_batch(&mut self) -> Result<Option<WrittenBatch>, WriteError> {
        let scans = self.scans.by_ref().take(self.scans_max);
        let scans: Vec<(usize, RecordedScan)> = scans.collect::<Result<_, RecordingError>>()?;
        let (Some((_, first)), Some((_, last))) = (scans.first(), scans.last()) else {
            return Ok(None);
        };
        let to_write = scans.iter().map(|(lidar, scan)| ScanToWrite {
            lidar: *lidar,
            stamp: scan.stamp,
            odom_from_base: scan.odom_from_base,
            ranges_m: &scan.ranges_m,
        });
        let batch = WrittenBatch {
            sequence: self.sequence,
            json: write_batch(&self.head, self.sequence, to_write)?,
            scans: scans.len(),
            stamps: [first.stamp, last.stamp],
        };
        self.sequence += 1;
        Ok(Some(batch))
    }
}

impl<I> Iterator for BatchWriter<'_, I>
where
    I: Iterator<Item = Result<(usize, RecordedScan), RecordingError>>,
{
    type Item = Result<WrittenBatch, WriteError>;

    fn next(&mut self) -> Option<Self::Item> {
        self.next_batch().transpose()
    }
}

#[derive(Serialize)]
struct BatchJson<'a> {
    vehicle_id: &'a str,
    trip_id: &'a str,
    sequence: usize,
    #[serde(skip_serializing_if = "Option::is_none")]
    lidar: Option<LidarJson<'a>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    lidars: Option<Vec<LidarJson<'a>>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    initial_pose: Option<InitialPoseJson>,
    scans: Vec<ScanJson<'a>>,
}

#[derive(Serialize)]
struct LidarJson<'a> {
    #[serde(skip_serializing_if = "Option::is_none")]
    id: Option<&'a str>,
    angle_min: f64,
    angle_increment: f64,
    range_min: f64,
    range_max: f64,
    mount: PoseJson,
    range_sigma: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    time_increment: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    scan_time: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    band: Option<BandJson>,
}

#[derive(Serialize)]
struct BandJson {
    from: f64,
    to: f64,
    clear_from: f64,
    clear_to: f64,
}

/// A pose in the form of the API.
#[derive(Serialize)]
pub struct PoseJson {
    x: f64,
    y: f64,
    theta: f64,
}

#[derive(Serialize)]
struct InitialPoseJson {
    x: f64,
    y: f64,
    theta: f64,
    sigma_xy: f64,
    sigma_theta: f64,
}

#[derive(Serialize)]
struct ScanJson<'a> {
    stamp: Timestamp,
    #[serde(skip_serializing_if = "Option::is_none")]
    lidar: Option<&'a str>,
    odometry: PoseJson,
    ranges: &'a [Option<f64>],
}

/// A pose in the form of the API.
pub fn pose_json(pose: &Pose2) -> PoseJson {
    PoseJson {
        x: pose.x,
        y: pose.y,
        theta: pose.theta,
    }
}

fn lidar_json(lidar: &RecordedLidar) -> LidarJson<'_> {
    let geometry = &lidar.geometry;
    let known = |seconds: f64| (seconds > 0.0).then_some(seconds);
    LidarJson {
        id: lidar.name.as_ref().map(|name| name.as_str()),
        angle_min: geometry.angle_min_rad,
        angle_increment: geometry.angle_increment_rad,
        range_min: geometry.range_min_m,
        range_max: geometry.range_max_m,
        mount: pose_json(&geometry.mount),
        range_sigma: geometry.range_sigma_m,
        time_increment: known(lidar.time_increment_s),
        scan_time: known(lidar.scan_time_s),
        band: geometry.band.map(|view| BandJson {
            from: view.band.from_m,
            to: view.band.to_m,
            clear_from: view.clear_from_m,
            clear_to: view.clear_to_m,
        }),
    }
}
