//! Long work that somebody asked for.

use super::text_enum;

text_enum! {
    /// How far an operation has come.
    OperationStatus {
        /// It waits for its turn.
        Queued = "queued",
        /// Its result says what was done.
        Succeeded = "succeeded",
        /// Nothing was done; the reason says why.
        Failed = "failed",
    }
}

text_enum! {
    /// What an operation does.
    OperationKind {
        /// Takes uploads out of a route.
        Removal = "removal",
        /// Carries out decisions about several alerts.
        Decisions = "decisions",
    }
}
