//! Routes and their settings.

use super::text_enum;

text_enum! {
    /// How far a route's reference map has come.
    Stage {
        /// The reference is still being built.
        Mapping = "mapping",
        /// New laps are judged against the reference.
        Monitoring = "monitoring",
    }
}

text_enum! {
    /// Which rule decides that something changed.
    #[derive(Default)]
    Detector {
        /// Robust estimates make the map, all-points residuals are watched.
        #[default]
        Fused = "fused",
        /// The paper's rule: all-points estimates are optimised with Ω = I.
        Seed = "seed",
    }
}
