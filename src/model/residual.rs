//! Residual series.

use super::text_enum;

text_enum! {
    /// What the paper's rule says about a closure.
    ResidualVerdict {
        /// f had not settled yet; nothing can be said.
        WarmingUp = "warming_up",
        /// It agrees with the map.
        Consistent = "consistent",
        /// Its ΔF exceeds the threshold near a peak of the smoothed derivative.
        Contradiction = "contradiction",
    }
}

text_enum! {
    /// Which residuals of the closures.
    #[derive(Default)]
    ResidualMeasurement {
        /// What each closure added to the optimum F.
        #[default]
        Robust = "robust",
        /// The residual of each closure's all-points estimate, which is watched and not optimised.
        AllPoints = "all_points",
    }
}
