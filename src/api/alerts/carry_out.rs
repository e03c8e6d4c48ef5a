//! Carrying a decision out.

use jiff::Timestamp;

use super::known_alert;
use crate::api::ApiState;
use crate::api::problem::{Problem, ProblemKind};
use crate::change::AlertAction;
use crate::store::{AlertRecord, Decided, Decision, HistoryEntry};

/// A decision is computed anew so often while batches come in between.
const TRIES: usize = 20;

/// Who decides, and why.
pub(super) struct Reason {
    pub by: String,
    pub note: Option<String>,
}

/// Writes what an action makes of an alert; `None` if the alert has changed meanwhile.
pub(super) async fn carry_out(
    state: &ApiState,
    alert: AlertRecord,
    action: AlertAction,
    reason: &Reason,
) -> Result<Option<AlertRecord>, Problem> {
    let Some(status) = action.leads_to().filter(|_| action != AlertAction::Accept) else {
        return Err(Problem::new(
            ProblemKind::NotReady,
            "decisions about the map are not possible yet",
        ));
    };
    let mut next = alert.clone();
    next.revision += 1;
    next.status = status;
    next.updated_at = Timestamp::now().max(alert.updated_at);
    next.history.push(HistoryEntry {
        status,
        at: next.updated_at,
        by: reason.by.clone(),
        note: reason.note.clone(),
    });
    for _ in 0..TRIES {
        let route = state.known_route(&alert.route_id).await?;
        let decision = Decision {
            base_revision: route.revision,
            alert: next.clone(),
            map: None,
        };
        if state.store.apply_decision(decision).await? == Decided::Committed {
            return known_alert(state, alert.id).await.map(Some);
        }
        if known_alert(state, alert.id).await?.revision != alert.revision {
            return Ok(None);
        }
    }
    let detail = "batches come in too quickly; send the same again later";
    Err(Problem::new(ProblemKind::Overloaded, detail))
}
