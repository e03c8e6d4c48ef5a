//! What a route's map shows.

use super::text_enum;

text_enum! {
    /// What of the world a map shows.
    #[derive(Default)]
    MapLayer {
        /// What people have accepted: changes that wait for a decision, or were dismissed, are left out.
        #[default]
        Accepted = "accepted",
        /// Everything that was observed.
        Observed = "observed",
    }
}
