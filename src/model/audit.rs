//! Who changes what: the words of the audit.

use super::{AlertAction, text_enum};

/// What the service itself is called where it stands for somebody.
pub const SYSTEM: &str = "system";
/// Who sends requests, until there are people with keys.
const LOCAL: &str = "local";

/// Who makes a change, and from where.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Actor {
    /// The service on its own.
    System,
    /// Somebody who sent a request.
    Local {
        /// The client's address as text.
        address: String,
    },
}

impl Actor {
    /// Its name and its address as they are kept; `None` if nobody has that name.
    pub fn of(name: &str, address: Option<String>) -> Option<Self> {
        match (name, address) {
            (SYSTEM, None) => Some(Self::System),
            (LOCAL, Some(address)) => Some(Self::Local { address }),
            _ => None,
        }
    }

    /// Its name.
    pub fn name(&self) -> &str {
        match self {
            Self::System => SYSTEM,
            Self::Local { .. } => LOCAL,
        }
    }

    /// From where; the service itself has no address.
    pub fn address(&self) -> Option<&str> {
        match self {
            Self::System => None,
            Self::Local { address } => Some(address),
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
        /// A version of a map was released for vehicles.
        VersionReleased = "version.released",
        /// A released version was withdrawn.
        VersionRetired = "version.retired",
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
        let address = "192.0.2.7".to_owned();
        for actor in [Actor::System, Actor::Local { address }] {
            let address = actor.address().map(str::to_owned);
            assert_eq!(Actor::of(actor.name(), address).as_ref(), Some(&actor));
        }
        assert_eq!(Actor::of(SYSTEM, Some("192.0.2.7".to_owned())), None);
        assert_eq!(Actor::of(LOCAL, None), None);
        assert_eq!(Actor::of("kim", None), None);
    }
}
