//! Residual series.

use super::text_enum;

text_enum! {
    /// The verdict of the paper's rule on a closure.
    ResidualVerdict {
        /// f had not converged yet: no verdict.
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
        /// The increase of the optimum F by each closure.
        #[default]
        Robust = "robust",
        /// The residual of each closure's all-points estimate, which is compared but not optimised.
        AllPoints = "all_points",
    }
}
