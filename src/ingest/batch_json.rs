//! The body of a batch upload: JSON to validated scans.

mod flags;
mod lidars;
mod raw;
mod validate;

use jiff::Timestamp;

use crate::ids::{TripId, VehicleId};
use crate::mapping::{DriveScan, InitialPose};

pub(super) use flags::clock_flags;
pub(super) use raw::Pose;
pub(super) use validate::{Checked, HEADING_MAX_RAD, refuse, stamp};

use super::json::{JsonError, JsonMistake, Object, from_json};

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
    /// Who drove.
    pub vehicle_id: VehicleId,
    /// Which drive.
    pub trip_id: TripId,
    /// 0, 1, 2 … within the trip.
    pub sequence: i64,
    /// Where the first scan's base is, roughly.
    pub initial_pose: Option<InitialPose>,
    /// 1 to [`SCANS_MAX`] in the order of time; of each lidar their stamps strictly increase, and
    /// all have the same number of beams.
    pub scans: Vec<DriveScan>,
    /// What was noticed, in alphabetical order: `clock_skew`, `empty_scans`, `late`,
    /// `wild_odometry`.
    pub flags: Vec<String>,
}

/// What kind of mistake a body holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BatchProblem {
    /// Not JSON, or unknown or repeated fields.
    MalformedJson,
    /// A field is missing, or has the wrong type or form.
    InvalidField,
    /// Beams, angles or ranges that fit no lidar.
    ScanGeometry,
    /// A number or a time beyond belief.
    OutOfRange,
    /// Stamps that do not increase.
    TimestampOrder,
    /// Nodes and edges that make no graph.
    EdgeGraph,
    /// More than a batch may have.
    TooLarge,
}

/// Why a body was refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{pointer}: {detail}")]
pub struct BatchBodyError {
    /// The kind of mistake.
    pub problem: BatchProblem,
    /// JSON pointer (RFC 6901) to the first faulty field.
    pub pointer: String,
    /// For the sender: what is wrong and what to send instead.
    pub detail: String,
}

impl From<JsonError> for BatchBodyError {
    fn from(error: JsonError) -> Self {
        Self {
            problem: match error.mistake {
                JsonMistake::Malformed => BatchProblem::MalformedJson,
                JsonMistake::Field => BatchProblem::InvalidField,
                JsonMistake::Range => BatchProblem::OutOfRange,
            },
            pointer: error.pointer,
            detail: error.detail,
        }
    }
}

/// Reads and checks a batch. The result depends on the body and on `received_at` alone, which
/// decides the flags `clock_skew` and `late`.
///
/// # Errors
/// [`BatchBodyError`] with the first mistake.
pub fn decode(body: &[u8], received_at: Timestamp) -> Result<UploadedBatch, BatchBodyError> {
    let Object(raw): Object<raw::Batch> = from_json(body)?;
    validate::batch(raw, received_at)
}

#[cfg(test)]
mod tests;
