//! What a route's map shows, and its versions.

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

text_enum! {
    /// Where a version of a map is in its life.
    VersionState {
        /// The present one: it grows with every batch.
        Draft = "draft",
        /// For vehicles: it never changes.
        Released = "released",
        /// Not for vehicles any more, or never: it never changes either.
        Retired = "retired",
    }
}

text_enum! {
    /// What begins a version of a map.
    VersionAction {
        /// A change was taken into the map.
        Accept = "accept",
        /// That was taken back.
        Undo = "undo",
        /// The version before was released.
        Release = "release",
    }
}
