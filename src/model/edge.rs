//! Edges of pose graphs.

use super::text_enum;

text_enum! {
    /// What made an edge.
    EdgeKind {
        /// Two keyframes of one drive, one after the other.
        Odometry = "odometry",
        /// A place seen again.
        LoopClosure = "loop_closure",
    }
}

text_enum! {
    /// Whether an edge takes part.
    EdgeStatus {
        /// It is optimised.
        Active = "active",
        /// It contradicts an accepted change; kept for the record.
        Retired = "retired",
        /// It contradicts the rest of the graph beyond belief; kept for the record.
        Quarantined = "quarantined",
    }
}
