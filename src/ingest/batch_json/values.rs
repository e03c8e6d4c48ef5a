//! Checked poses.

use super::raw;
use super::uploaded::COORDINATE_MAX_M;
use crate::geometry::Pose2;
use crate::ingest::body_error::{BatchProblem, Checked, refuse};

/// Largest heading that was never wrapped, radians.
pub(in crate::ingest) const HEADING_MAX_RAD: f64 = 1e4;

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
