//! The rule that decides.

use serde::{Deserialize, Serialize};

use super::series::{ConvergenceRule, SeriesParams};

/// Which rule decides that something changed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Detector {
    /// Robust estimates make the map, all-points residuals are watched.
    #[default]
    Fused,
    /// The paper's rule: all-points estimates are optimised with Ω = I.
    Seed,
}

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
