use std::slice::from_ref;

use super::bench::Bench;
use crate::change::AlertStatus;
use crate::ids::AlertId;
use crate::model::AlertAction;
use crate::pipeline::engine::now;
use crate::pipeline::rebuilt_alerts::rebuilt_alerts;
use crate::store::{AlertRecord, SYSTEM};

/// An alert as it is raised again, with other revisions.
fn raised_again(alert: &AlertRecord) -> AlertRecord {
    AlertRecord {
        revision: 9,
        decision_revision: 4,
        ..alert.clone()
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn an_alert_that_is_raised_again_as_it_was_stays_as_it_is() {
    let (_bench, alert) = Bench::with_alert().await;
    let changed = rebuilt_alerts(from_ref(&alert), &[raised_again(&alert)], now());
    assert_eq!(changed, []);
}

#[tokio::test(flavor = "multi_thread")]
async fn an_alert_with_other_evidence_gets_its_next_revision_and_keeps_its_history() {
    let (_bench, alert) = Bench::with_alert().await;
    let mut made = raised_again(&alert);
    made.evidence.confidence /= 2.0;
    let [changed] = &rebuilt_alerts(from_ref(&alert), from_ref(&made), now())[..] else {
        panic!("one alert changes");
    };
    assert_eq!(changed.evidence, made.evidence);
    assert_eq!(
        (changed.revision, changed.decision_revision),
        (alert.revision + 1, alert.decision_revision)
    );
    assert_eq!(changed.history, alert.history);
}

#[tokio::test(flavor = "multi_thread")]
async fn an_alert_that_is_not_raised_again_is_resolved_but_a_dismissal_stays() {
    let (bench, alert) = Bench::with_alert().await;
    let [resolved] = &rebuilt_alerts(from_ref(&alert), &[], now())[..] else {
        panic!("one alert changes");
    };
    assert_eq!(
        (
            resolved.status,
            resolved.revision,
            resolved.decision_revision
        ),
        (
            AlertStatus::Resolved,
            alert.revision + 1,
            alert.decision_revision + 1
        )
    );
    assert!(resolved.evidence.nodes.is_empty() && resolved.evidence.edges.is_empty());
    let last = resolved.history.last().unwrap();
    assert_eq!(
        (last.status, last.by.as_str()),
        (AlertStatus::Resolved, SYSTEM)
    );
    assert!(last.note.is_some());
    // Once more, nothing is new.
    assert_eq!(rebuilt_alerts(from_ref(resolved), &[], now()), []);

    let dismissed = bench.decide(&alert, AlertAction::Dismiss).await;
    let [kept] = &rebuilt_alerts(from_ref(&dismissed), &[], now())[..] else {
        panic!("its evidence is gone");
    };
    assert_eq!(kept.status, AlertStatus::Dismissed);
    assert_eq!(kept.history, dismissed.history);
}

#[tokio::test(flavor = "multi_thread")]
async fn an_alert_that_nobody_has_seen_begins_with_its_first_revision() {
    let (_bench, alert) = Bench::with_alert().await;
    let made = AlertRecord {
        id: AlertId(uuid::Uuid::from_u128(7)),
        ..raised_again(&alert)
    };
    let [new] = &rebuilt_alerts(&[], from_ref(&made), now())[..] else {
        panic!("one alert is new");
    };
    assert_eq!(
        (new.id, new.revision, new.decision_revision),
        (made.id, 1, 1)
    );
}
