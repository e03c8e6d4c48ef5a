//! The life cycle of an alert: which action is allowed in which status, and where it leads.

use crate::model::{AlertAction, AlertStatus};

impl AlertStatus {
    /// Whether it waits for a decision: open or acknowledged.
    pub fn is_pending(self) -> bool {
        matches!(self, Self::Open | Self::Acknowledged)
    }

    /// Whether an action is allowed in this status. It leads to [`AlertAction::leads_to`]; an undo leads back
    /// to the status before the acceptance.
    ///
    /// A resolved alert can be reopened by hand; the next batch without its finding resolves it again.
    pub fn allows(self, action: AlertAction) -> bool {
        match action {
            AlertAction::Acknowledge => self == Self::Open,
            AlertAction::Accept | AlertAction::Dismiss => self.is_pending(),
            AlertAction::Reopen => {
                matches!(self, Self::Acknowledged | Self::Dismissed | Self::Resolved)
            }
            AlertAction::Undo => self == Self::Accepted,
        }
    }
}

impl AlertAction {
    /// The status that follows; `None` for an undo, which leads back to where the alert was.
    pub fn leads_to(self) -> Option<AlertStatus> {
        match self {
            Self::Acknowledge => Some(AlertStatus::Acknowledged),
            Self::Accept => Some(AlertStatus::Accepted),
            Self::Dismiss => Some(AlertStatus::Dismissed),
            Self::Reopen => Some(AlertStatus::Open),
            Self::Undo => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_of_what_is_allowed() {
        use AlertAction::{Accept, Acknowledge, Dismiss, Reopen, Undo};
        use AlertStatus::{Accepted, Acknowledged, Dismissed, Open, Resolved};
        let table: [(AlertStatus, &[AlertAction]); 5] = [
            (Open, &[Acknowledge, Accept, Dismiss]),
            (Acknowledged, &[Accept, Dismiss, Reopen]),
            (Accepted, &[Undo]),
            (Dismissed, &[Reopen]),
            (Resolved, &[Reopen]),
        ];
        for (status, allowed) in table {
            let found = AlertAction::ALL.into_iter().filter(|a| status.allows(*a));
            assert_eq!(found.collect::<Vec<_>>(), allowed, "{status:?}");
        }
    }

    #[test]
    fn no_action_leads_to_where_the_alert_is() {
        for status in AlertStatus::ALL {
            for action in AlertAction::ALL {
                assert!(!status.allows(action) || action.leads_to() != Some(status));
            }
        }
    }
}
