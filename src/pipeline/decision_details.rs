//! Why a decision was refused, in words for the sender.

use super::decide::{DecisionError, is_allowed};
use crate::change::{AlertAction, ChangeKind};
use crate::store::AlertRecord;

impl DecisionError {
    /// What happened, and what to do instead of the action that was refused.
    pub fn detail(&self, action: AlertAction) -> String {
        match self {
            Self::UnknownAlert => "there is no such alert: GET /v1/alerts lists them".to_owned(),
            Self::Changed(alert) => changed(alert),
            Self::NotAllowed(alert) => not_allowed(alert, action),
            Self::Busy => "the route changes too quickly; send the same again later".to_owned(),
            Self::Store(error) => error.to_string(),
            Self::Failed(_) => "it could not be computed; the service's log says why".to_owned(),
        }
    }
}

/// The alert's status, tier or region has changed; more evidence alone does not count.
fn changed(alert: &AlertRecord) -> String {
    let last = alert.history.last().map(|last| (&last.by, last.at));
    let since = last.map_or_else(String::new, |(by, at)| format!(" since {at:.0} by {by}"));
    format!(
        "the alert is not as If-Match says: it is {} ({}){since}, its decision_revision is {}; check \
         its status, tier and region, and decide again",
        alert.status.name(),
        alert.evidence.tier.name(),
        alert.decision_revision,
    )
}

/// The alert's status does not allow the action, or it is no change of the world and cannot be accepted.
fn not_allowed(alert: &AlertRecord, action: AlertAction) -> String {
    let allowed = AlertAction::ALL.into_iter();
    let allowed = allowed.filter(|action| is_allowed(alert, *action));
    let allowed: Vec<&str> = allowed.map(AlertAction::name).collect();
    let possible = match allowed.as_slice() {
        [] => "nothing can be done with it".to_owned(),
        names => format!("what is possible now: {}", names.join(", ")),
    };
    let reason = match alert.status.allows(action) {
        true if alert.evidence.kind == ChangeKind::MapMismatch => {
            "of kind map_mismatch: the map is wrong there, not the world, and there is nothing to \
             take into it; it is mended, and the alert resolved, once scans prove where the segment \
             belongs"
                .to_owned()
        }
        true => format!(
            "of kind {}: no change of the world",
            alert.evidence.kind.name()
        ),
        false => format!("that is {}", alert.status.name()),
    };
    format!(
        "{} is not possible with an alert {reason}; {possible}",
        action.name()
    )
}
