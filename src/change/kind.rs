//! What kind of contradiction between the map and the world was found.

use serde::{Deserialize, Serialize};

/// The kinds of findings.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ChangeKind {
    /// Something stands where earlier looks saw free space.
    Appeared,
    /// Free space is seen where earlier looks saw something.
    Disappeared,
    /// Closures contradict the map, without scans that say what changed.
    Residual,
    /// So much differs, or so many closures are missing, that the map does not fit the place.
    MapMismatch,
    /// A vehicle has changed, or is off in a way that cannot be corrected.
    VehicleSuspect,
}

impl ChangeKind {
    /// Whether a place is free that was occupied, or the reverse.
    pub fn is_of_state(self) -> bool {
        matches!(self, Self::Appeared | Self::Disappeared)
    }

    /// Its name in files and in the API.
    pub fn name(self) -> &'static str {
        match self {
            Self::Appeared => "appeared",
            Self::Disappeared => "disappeared",
            Self::Residual => "residual",
            Self::MapMismatch => "map_mismatch",
            Self::VehicleSuspect => "vehicle_suspect",
        }
    }
}
