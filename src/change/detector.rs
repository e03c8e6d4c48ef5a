//! Parameters of the residual series by detector.

use super::series::{ConvergenceRule, SeriesParams};
use crate::model::Detector;

impl Detector {
    /// How this rule reads a residual series.
    pub fn series_params(self) -> SeriesParams {
        match self {
            Self::Fused => SeriesParams::default(),
            Self::Seed => SeriesParams {
                convergence: ConvergenceRule::PAPER,
                ..SeriesParams::default()
            },
        }
    }
}
