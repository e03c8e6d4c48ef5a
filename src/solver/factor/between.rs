//! One measured motion between two poses (GTSAM's `BetweenFactor`).

use super::local_error::Frame;
use crate::geometry::{Information, Pose2};

/// A measured motion between two poses, by their places.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Factor {
    pub(crate) from: usize,
    pub(crate) to: usize,
    pub(crate) measurement: Frame,
    pub(crate) information: Information,
    /// What the information is multiplied by: 1 except in a robust solve.
    pub(crate) weight: f64,
}

impl Factor {
    /// eᵀΩe without the weight.
    pub(crate) fn cost(&self, poses: &[Pose2]) -> f64 {
        let error = Pose2::edge_error(&poses[self.from], &poses[self.to], &self.measurement.pose);
        self.information.squared_norm(&error)
    }
}
