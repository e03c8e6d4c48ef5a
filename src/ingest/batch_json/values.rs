//! Checked poses and times.

use jiff::Timestamp;

use super::raw;
use super::uploaded::COORDINATE_MAX_M;
use crate::geometry::Pose2;
use crate::ids::StampNs;
use crate::ingest::body_error::{BatchProblem, Checked, refuse};

/// A heading that was never wrapped still means something up to here, radians.
pub(in crate::ingest) const HEADING_MAX_RAD: f64 = 1e4;
/// 2000-01-01T00:00:00Z, seconds since the Unix epoch.
const STAMP_MIN_S: i64 = 946_684_800;
/// 2100-01-01T00:00:00Z, seconds since the Unix epoch.
const STAMP_MAX_S: i64 = 4_102_444_800;

/// A pose, stated at a pointer.
pub(super) fn pose(raw: raw::Pose, pointer: &str) -> Checked<Pose2> {
    for (field, value) in [("x", raw.x), ("y", raw.y)] {
        if value.abs() > COORDINATE_MAX_M {
            let detail = format!(
                "{field} {value} is not within ±{COORDINATE_MAX_M} m: send metres in a frame near the vehicle"
            );
            return refuse(
                BatchProblem::OutOfRange,
                format!("{pointer}/{field}"),
                detail,
            );
        }
    }
    if raw.theta.abs() > HEADING_MAX_RAD {
        let detail = format!(
            "theta {} is not within ±{HEADING_MAX_RAD} rad: send radians",
            raw.theta
        );
        return refuse(BatchProblem::OutOfRange, format!("{pointer}/theta"), detail);
    }
    Ok(Pose2::new(raw.x, raw.y, raw.theta))
}

/// A time as it is kept.
///
/// # Errors
/// [`BatchProblem::OutOfRange`] at the pointer, if it is not between 2000 and 2100.
pub(in crate::ingest) fn stamp(stamp: Timestamp, pointer: String) -> Checked<StampNs> {
    let nanoseconds = i64::try_from(stamp.as_nanosecond()).ok();
    match nanoseconds {
        Some(ns) if (STAMP_MIN_S..STAMP_MAX_S).contains(&stamp.as_second()) => Ok(StampNs(ns)),
        _ => refuse(
            BatchProblem::OutOfRange,
            pointer,
            format!("{stamp} is not between 2000 and 2100: is the vehicle's clock set?"),
        ),
    }
}
