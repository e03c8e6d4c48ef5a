//! What a checked batch holds, and how much at most.

use super::ranges::RangeCounts;
use crate::ids::{TripId, VehicleId};
use crate::mapping::{DriveScan, InitialPose};

/// Most scans in one batch.
pub const SCANS_MAX: usize = 5_000;
/// Most lidars of one vehicle.
pub const LIDARS_MAX: usize = 8;
/// Most beams in one batch, all scans together.
pub const BEAMS_TOTAL_MAX: usize = 4_000_000;
/// Largest |x| and |y| of a pose, metres.
pub const COORDINATE_MAX_M: f64 = 1e6;

/// One upload, checked.
#[derive(Debug, Clone, PartialEq)]
pub struct UploadedBatch {
    /// The vehicle.
    pub vehicle_id: VehicleId,
    /// The trip.
    pub trip_id: TripId,
    /// 0, 1, 2 … within the trip.
    pub sequence: i64,
    /// Approximate pose of the base at the first scan.
    pub initial_pose: Option<InitialPose>,
    /// 1 to [`SCANS_MAX`] in the order of time. The stamps of each lidar strictly increase, and its scans have the
    /// same number of beams.
    pub scans: Vec<DriveScan>,
    /// Counts of readings by kind.
    pub ranges: RangeCounts,
    /// A JSON object of the sender's own, as its text.
    pub extensions: Option<String>,
    /// Flags in alphabetical order: `above_range_max`, `below_range_min`, `clock_skew`,
    /// `clockwise_scans`, `empty_scans`, `late`, `simulated_time`, `wild_odometry`.
    pub flags: Vec<String>,
}
