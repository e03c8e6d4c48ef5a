//! Resolves the alerts of misplaced segments that were moved.

use std::borrow::Cow;

use super::fold::gap;
use super::{AlertState, AlertStatus, AlertUpdate, Finding, Step};
use crate::geometry::Vector2;

/// Resolves the alerts of misplaced segments that closures have moved, each given as its mismatch with the
/// vector by which it was moved (map frame, metres). Returns the alerts that change.
///
/// A mismatch that was never reported becomes an alert that is resolved at once, as a record. Call this
/// before the remaining findings are folded.
pub fn resolve_mended(
    existing: &[AlertState],
    mended: &[(&Finding, Vector2<f64>)],
) -> Vec<AlertUpdate> {
    let mut taken = vec![false; existing.len()];
    let updates = mended.iter().map(|(mismatch, moved)| {
        let reports_it = |k: &usize| {
            let alert = &existing[*k];
            alert.status.is_pending()
                && alert.evidence.trips == mismatch.trips
                && gap(&alert.evidence, mismatch).is_some()
        };
        let known = (0..existing.len()).find(|k| !taken[*k] && reports_it(k));
        if let Some(k) = known {
            taken[k] = true;
        }
        let first_seen = known.map(|k| existing[k].first_seen);
        let raised = known.is_none().then_some(Step {
            status: AlertStatus::Open,
            note: None,
        });
        let resolved = Step {
            status: AlertStatus::Resolved,
            note: Some(Cow::Owned(note_of(moved))),
        };
        AlertUpdate {
            existing: known,
            state: AlertState {
                status: AlertStatus::Resolved,
                evidence: (*mismatch).clone(),
                first_seen: first_seen.map_or(mismatch.since, |seen| seen.min(mismatch.since)),
            },
            steps: raised.into_iter().chain([resolved]).collect(),
        }
    });
    updates.collect()
}

fn note_of(moved: &Vector2<f64>) -> String {
    // Without the sign of a zero.
    let [x, y] = [moved.x, moved.y].map(|v| (100.0 * v).round() / 100.0 + 0.0);
    format!("closures mended the map: the segment was moved by ({x:.2}, {y:.2}) m")
}

#[cfg(test)]
mod tests {
    use super::super::testing::finding;
    use super::*;
    use crate::change::{ChangeKind, fold};

    fn mismatch(place: [f64; 2]) -> Finding {
        Finding {
            shift: Some(Vector2::new(-0.3, 0.0)),
            ..finding(ChangeKind::MapMismatch, place, 2.0, 10)
        }
    }

    fn applied(existing: &[AlertState], updates: &[AlertUpdate]) -> Vec<AlertState> {
        let mut states = existing.to_vec();
        for update in updates {
            match update.existing {
                Some(k) => states[k] = update.state.clone(),
                None => states.push(update.state.clone()),
            }
        }
        states
    }

    #[test]
    fn an_open_mismatch_says_what_mended_it_and_stays_resolved() {
        let reported = mismatch([0.0, 0.0]);
        let raised = applied(&[], &fold(&[], std::slice::from_ref(&reported)));
        let moved = Vector2::new(-0.312, -0.001);
        let updates = resolve_mended(&raised, &[(&reported, moved)]);
        assert_eq!((updates.len(), updates[0].existing), (1, Some(0)));
        let notes: Vec<_> = updates[0].steps.iter().map(|s| s.note.clone()).collect();
        let expected = "closures mended the map: the segment was moved by (-0.31, 0.00) m";
        assert_eq!(notes, [Some(expected.into())]);
        let mended = applied(&raised, &updates);
        assert_eq!(mended[0].status, AlertStatus::Resolved);
        assert!(fold(&mended, &[]).is_empty());
    }

    #[test]
    fn a_mending_of_what_was_never_reported_can_be_looked_up() {
        let elsewhere = mismatch([20.0, 0.0]);
        let existing = applied(&[], &fold(&[], &[elsewhere]));
        let never_reported = mismatch([0.0, 0.0]);
        let updates = resolve_mended(&existing, &[(&never_reported, Vector2::zeros())]);
        assert_eq!((updates.len(), updates[0].existing), (1, None));
        let statuses: Vec<_> = updates[0].steps.iter().map(|s| s.status).collect();
        assert_eq!(statuses, [AlertStatus::Open, AlertStatus::Resolved]);
    }
}
