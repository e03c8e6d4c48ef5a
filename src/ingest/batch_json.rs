//! The body of a batch upload: JSON to validated scans.

mod flags;
mod lidars;
mod ranges;
mod raw;
mod uploaded;
mod validate;
mod values;

use jiff::Timestamp;

pub use super::body_error::{BatchBodyError, BatchProblem};
pub(super) use flags::clock_flags;
pub use ranges::RangeCounts;
pub(super) use raw::Pose;
pub use uploaded::{BEAMS_TOTAL_MAX, COORDINATE_MAX_M, LIDARS_MAX, SCANS_MAX, UploadedBatch};
pub(super) use values::HEADING_MAX_RAD;

use super::json::{Object, from_json};

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
mod intake_tests;
#[cfg(test)]
mod tests;
