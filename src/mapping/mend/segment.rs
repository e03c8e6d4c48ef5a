//! A segment that may lie in the wrong place, and what its keyframes say of that.

use super::super::closure::ClosureMeasurement;
use crate::geometry::{Pose2, Vector2};

/// A segment to be matched anew.
pub(super) struct Segment {
    /// Its keyframes, in the order of the drive.
    pub places: Vec<usize>,
    /// The trip's keyframes, in the order of the drive.
    pub trip: Vec<usize>,
    /// By which it should be moved, if that is known.
    pub shift: Option<Vector2<f64>>,
    /// How far its keyframes lie apart at most, metres.
    pub extent_m: f64,
}

impl Segment {
    /// A segment of a trip that has nothing else.
    #[cfg(test)]
    pub(super) fn of_places(
        places: Vec<usize>,
        shift: Option<Vector2<f64>>,
        extent_m: f64,
    ) -> Self {
        Self {
            trip: places.clone(),
            places,
            shift,
            extent_m,
        }
    }
}

/// Where a keyframe belongs by its own scan.
#[derive(Clone)]
pub(super) struct Vote {
    /// The keyframe.
    pub place: usize,
    /// `map_from_base` where it belongs.
    pub pose: Pose2,
    /// By which it would be moved.
    pub moved: Vector2<f64>,
    /// By which it would be turned, radians.
    pub turned_rad: f64,
    /// Its older partners with what was measured.
    pub closures: Vec<(usize, ClosureMeasurement)>,
}

/// What a keyframe says.
pub(super) enum Said {
    /// It belongs somewhere else.
    Elsewhere(Vote),
    /// It fits as well where it lies.
    Here,
    /// Nothing.
    Nothing,
}
