//! What becomes of a route's alerts when its map was made anew without uploads that were removed.

use std::collections::BTreeMap;

use jiff::Timestamp;

use super::decision_revision;
use crate::ids::AlertId;
use crate::model::AlertStatus;
use crate::store::{AlertRecord, HistoryEntry, SYSTEM};

const RESTED_ON_REMOVED: &str = "what it rested on was removed";
const JUDGED_ANEW: &str = "the map was made anew without what was removed";

/// The alerts that are new, and the next revisions of those that change. `kept` are the route's alerts, and
/// `made` those that were raised while its map was made anew.
pub(super) fn rebuilt_alerts(
    kept: &[AlertRecord],
    made: &[AlertRecord],
    at: Timestamp,
) -> Vec<AlertRecord> {
    let mut made: BTreeMap<AlertId, &AlertRecord> =
        made.iter().map(|alert| (alert.id, alert)).collect();
    let mut changed: Vec<AlertRecord> = kept
        .iter()
        .filter_map(|kept| match made.remove(&kept.id) {
            Some(made) => judged_anew(kept, made, at),
            None => given_up(kept, at),
        })
        .collect();
    changed.extend(made.into_values().map(raised_anew));
    changed
}

/// An alert that was raised again; `None` if it is as it was.
fn judged_anew(kept: &AlertRecord, made: &AlertRecord, at: Timestamp) -> Option<AlertRecord> {
    let mut next = AlertRecord {
        status: made.status,
        evidence: made.evidence.clone(),
        first_seen: made.first_seen,
        vehicles: made.vehicles.clone(),
        passes: made.passes.clone(),
        clearance: made.clearance,
        residual: made.residual,
        related: made.related.clone(),
        ..kept.clone()
    };
    if next == *kept {
        return None;
    }
    revise(kept, &mut next, JUDGED_ANEW, at);
    Some(next)
}

/// An alert that was not raised again: it is resolved, unless it was decided that there is no change.
fn given_up(kept: &AlertRecord, at: Timestamp) -> Option<AlertRecord> {
    let mut next = kept.clone();
    if kept.status != AlertStatus::Dismissed {
        next.status = AlertStatus::Resolved;
    }
    next.evidence.nodes.clear();
    next.evidence.edges.clear();
    next.passes = None;
    next.residual = None;
    if next == *kept {
        return None;
    }
    revise(kept, &mut next, RESTED_ON_REMOVED, at);
    Some(next)
}

fn revise(kept: &AlertRecord, next: &mut AlertRecord, note: &str, at: Timestamp) {
    next.revision += 1;
    next.updated_at = at.max(kept.updated_at);
    decision_revision::count(Some(kept), next);
    if next.status != kept.status {
        next.history.push(HistoryEntry {
            status: next.status,
            at: next.updated_at,
            by: SYSTEM.to_owned(),
            note: Some(note.to_owned()),
            reason: None,
        });
    }
}

/// An alert that nobody has seen yet begins with its first revision.
fn raised_anew(made: &AlertRecord) -> AlertRecord {
    AlertRecord {
        revision: 1,
        decision_revision: 1,
        decision_region: made.evidence.region.clone(),
        ..made.clone()
    }
}
