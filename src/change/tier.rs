//! How far an alert is to be believed.

use serde::{Deserialize, Serialize};

/// One pass is a hint, two are evidence.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Tier {
    /// One pass by one vehicle shows the new state so far: shown, not sent.
    Tentative,
    /// Two passes, or two vehicles, show the new state.
    Confirmed,
}

impl Tier {
    /// Every tier.
    pub const ALL: [Self; 2] = [Self::Tentative, Self::Confirmed];

    /// Its name in files and in the API.
    pub fn name(self) -> &'static str {
        match self {
            Self::Tentative => "tentative",
            Self::Confirmed => "confirmed",
        }
    }
}
