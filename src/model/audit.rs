//! Who changes what: the words of the audit.

use super::{AlertAction, text_enum};
use crate::ids::KeyId;

/// What the service itself is called where it stands for somebody.
pub const SYSTEM: &str = "system";
/// Who sends requests to a service without keys.
pub(super) const LOCAL: &str = "local";

/// Who makes a change, and from where.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Actor {
    /// The service on its own.
    System,
    /// Somebody who sent a request to a service without keys.
    Local {
        /// The client's address as text.
        address: String,
    },
    /// The holder of a key.
    Key {
        /// The key.
        id: KeyId,
        /// Its holder.
        name: String,
        /// The client's address as text.
        address: String,
    },
    /// Somebody whom a trusted proxy has signed in.
    Proxy {
        /// As the proxy has it.
        name: String,
        /// The proxy's address as text.
        address: String,
    },
}

impl Actor {
    /// Who has this name, address and key; `None` if nobody can have them.
    pub fn of(name: &str, address: Option<String>, key: Option<KeyId>) -> Option<Self> {
        let own_name = || name.to_owned();
        match (name, address, key) {
            (SYSTEM, None, None) => Some(Self::System),
            (SYSTEM, ..) | (_, None, _) => None,
            (LOCAL, Some(address), None) => Some(Self::Local { address }),
            (_, Some(address), Some(id)) => Some(Self::Key {
                id,
                name: own_name(),
                address,
            }),
            (_, Some(address), None) => Some(Self::Proxy {
                name: own_name(),
                address,
            }),
        }
    }

    /// Its name.
    pub fn name(&self) -> &str {
        match self {
            Self::System => SYSTEM,
            Self::Local { .. } => LOCAL,
            Self::Key { name, .. } | Self::Proxy { name, .. } => name,
        }
    }

    /// The name of somebody who has signed in; whoever has not may give any.
    pub fn signed_in(&self) -> Option<&str> {
        match self {
            Self::System | Self::Local { .. } => None,
            Self::Key { name, .. } | Self::Proxy { name, .. } => Some(name),
        }
    }

    /// From where; the service itself has no address.
    pub fn address(&self) -> Option<&str> {
        match self {
            Self::System => None,
            Self::Local { address } | Self::Key { address, .. } | Self::Proxy { address, .. } => {
                Some(address)
            }
        }
    }

    /// The key, if it has one.
    pub fn key(&self) -> Option<KeyId> {
        match self {
            Self::Key { id, .. } => Some(*id),
            _ => None,
        }
    }
}

text_enum! {
    /// What was done.
    AuditAction {
        /// A route was made.
        RouteCreated = "route.created",
        /// Names or settings of a route were changed.
        RouteChanged = "route.changed",
        /// A route was deleted with everything in it.
        RouteDeleted = "route.deleted",
        /// Somebody took an alert up.
        AlertAcknowledged = "alert.acknowledged",
        /// A change was taken into the map.
        AlertAccepted = "alert.accepted",
        /// The map was kept as it is.
        AlertDismissed = "alert.dismissed",
        /// An alert was put back among the open ones.
        AlertReopened = "alert.reopened",
        /// An acceptance was taken back.
        AlertUndone = "alert.undone",
        /// A webhook was registered.
        WebhookCreated = "webhook.created",
        /// A webhook was changed, or disabled because its receiver is gone.
        WebhookChanged = "webhook.changed",
        /// A webhook was deleted, by itself or with its route.
        WebhookDeleted = "webhook.deleted",
        /// Somebody wants uploads taken out of a route.
        RemovalAsked = "removal.asked",
        /// Uploads were taken out.
        RemovalDone = "removal.done",
        /// Uploads could not be taken out; nothing was changed.
        RemovalFailed = "removal.failed",
        /// An upload was queued for another try.
        BatchRetried = "batch.retried",
        /// A vehicle's uploads are kept out of a map from now on.
        VehicleQuarantined = "vehicle.quarantined",
        /// They are kept out no longer.
        VehicleReleased = "vehicle.released",
        /// A key was made.
        KeyCreated = "key.created",
        /// A key is valid no longer.
        KeyRevoked = "key.revoked",
        /// Somebody was asked to see to an alert, or nobody is any more.
        AlertAssigned = "alert.assigned",
        /// Somebody wrote about an alert.
        AlertCommented = "alert.commented",
        /// A zone was made.
        ZoneCreated = "zone.created",
        /// A zone was changed.
        ZoneChanged = "zone.changed",
        /// A zone was deleted.
        ZoneDeleted = "zone.deleted",
        /// The time of a zone was over.
        ZoneEnded = "zone.ended",
        /// A version of a map was released for vehicles.
        VersionReleased = "version.released",
        /// A released version was withdrawn.
        VersionRetired = "version.retired",
        /// A webhook has a new secret.
        WebhookSecretRotated = "webhook.secret_rotated",
    }
}

impl From<AlertAction> for AuditAction {
    fn from(action: AlertAction) -> Self {
        match action {
            AlertAction::Acknowledge => Self::AlertAcknowledged,
            AlertAction::Accept => Self::AlertAccepted,
            AlertAction::Dismiss => Self::AlertDismissed,
            AlertAction::Reopen => Self::AlertReopened,
            AlertAction::Undo => Self::AlertUndone,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_actor_comes_back_from_its_name_and_address() {
        let address = || "192.0.2.7".to_owned();
        let (name, id) = (|| "kim".to_owned(), KeyId(uuid::Uuid::from_u128(7)));
        for actor in [
            Actor::System,
            Actor::Local { address: address() },
            Actor::Key {
                id,
                name: name(),
                address: address(),
            },
            Actor::Proxy {
                name: name(),
                address: address(),
            },
        ] {
            let kept = actor.address().map(str::to_owned);
            assert_eq!(
                Actor::of(actor.name(), kept, actor.key()).as_ref(),
                Some(&actor)
            );
        }
        assert_eq!(Actor::of(SYSTEM, Some(address()), None), None);
        assert_eq!(Actor::of(LOCAL, None, None), None);
        assert_eq!(Actor::of("kim", None, None), None);
    }
}
