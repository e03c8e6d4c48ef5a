//! Parameters of the residual series by detector.

use super::series::{ConvergenceRule, SeriesParams};
use crate::model::Detector;

impl Detector {
    /// Whether the map is to be what the paper would make of what was sent: closures weigh alike, and nothing
    /// is corrected, guarded or archived. A detector says so here; others are given a map that is kept well.
    pub fn keeps_as_sent(self) -> bool {
        self == Self::Seed
    }

    /// How this rule reads a residual series.
    pub fn series_params(self) -> SeriesParams {
        match self.keeps_as_sent() {
            true => SeriesParams {
                convergence: ConvergenceRule::PAPER,
                ..SeriesParams::default()
            },
            false => SeriesParams::default(),
        }
    }
}
