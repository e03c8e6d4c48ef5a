//! What a match need not find out.

use crate::geometry::{Information, Pose2};

/// What is known of the pose beforehand.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Prior {
    /// `reference_from_base`.
    pub pose: Pose2,
    /// Of the pose, for errors in the base frame.
    pub information: Information,
}
