//! The names of kinds, states, actions and verdicts.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::change::{AlertAction, AlertStatus, BeamVerdict, ChangeKind, Tier};

/// What changed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub(super) enum AlertKindName {
    /// Something stands where free space was.
    Appeared,
    /// Free space is where something stood.
    Disappeared,
    /// Closures contradict the map; no scans say what changed.
    Residual,
    /// The map does not fit the place at all.
    MapMismatch,
    /// A vehicle has changed, or is off in a way that cannot be corrected: no change of the world.
    VehicleSuspect,
}

/// How far an alert is to be believed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub(super) enum AlertTierName {
    /// One pass by one vehicle shows the new state so far. Webhooks are not called for it unless
    /// they ask for that.
    Tentative,
    /// Two passes, or two vehicles, show the new state.
    Confirmed,
}

/// What became of an alert.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub(super) enum AlertStatusName {
    /// Nobody has looked at it.
    Open,
    /// Somebody has taken it up.
    Acknowledged,
    /// The map shows the new state.
    Accepted,
    /// The map is right; the same thing is not raised again.
    Dismissed,
    /// Later laps show the old state again, or refute it.
    Resolved,
}

/// What can be done with an alert: the last part of a path.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub(super) enum AlertActionName {
    /// Take it up.
    Acknowledge,
    /// Take the change into the map.
    Accept,
    /// Keep the map, and do not raise the same thing again.
    Dismiss,
    /// Put it back among the open ones.
    Reopen,
    /// Take an acceptance back.
    Undo,
}

/// What one scan says of a point of another.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub(super) enum BeamVerdictName {
    /// It has a surface there.
    Agrees,
    /// It saw through the place.
    Contradicts,
    /// Something nearer hid the place from it.
    Occluded,
    /// It did not look there.
    Unseen,
    /// The beam has no return; nothing to judge.
    NoReturn,
}

macro_rules! same_names {
    ($core:ident, $name:ident, $($variant:ident),+) => {
        impl From<$core> for $name {
            fn from(value: $core) -> Self {
                match value { $($core::$variant => Self::$variant,)+ }
            }
        }

        impl From<$name> for $core {
            fn from(value: $name) -> Self {
                match value { $($name::$variant => Self::$variant,)+ }
            }
        }
    };
}

same_names!(
    ChangeKind,
    AlertKindName,
    Appeared,
    Disappeared,
    Residual,
    MapMismatch,
    VehicleSuspect
);
same_names!(Tier, AlertTierName, Tentative, Confirmed);
same_names!(
    AlertStatus,
    AlertStatusName,
    Open,
    Acknowledged,
    Accepted,
    Dismissed,
    Resolved
);
same_names!(
    AlertAction,
    AlertActionName,
    Acknowledge,
    Accept,
    Dismiss,
    Reopen,
    Undo
);
same_names!(
    BeamVerdict,
    BeamVerdictName,
    Agrees,
    Contradicts,
    Occluded,
    Unseen,
    NoReturn
);
