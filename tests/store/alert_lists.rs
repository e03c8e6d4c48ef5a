//! Alerts by batch, the changes that they keep out of a map, the end of their events, and reports.

use std::collections::BTreeMap;

use mapshift::change::{AlertAction, AlertStatus, PendingChange, Tier};
use mapshift::ids::{AlertId, BatchId, NodeId};
use mapshift::model::{BatchStatus, DismissReason};
use mapshift::store::{
    AlertRecord, Decided, Decision, HistoryEntry, ReportCounts, ReportScope, Store, ZoneMade,
};
use uuid::Uuid;

use crate::support::{Fixture, at, batch_id, by, put_route, route, upload};
use crate::tiers::{alert, mute, write};

/// An alert that is raised at a second, and later ones with other nodes as evidence.
fn raised(number: u128, second: i64, nodes: &[i64]) -> AlertRecord {
    let mut alert = alert(number, Tier::Confirmed);
    (alert.raised_at, alert.updated_at) = (at(second), at(second));
    alert.history[0].at = at(second);
    alert.evidence.nodes = nodes.iter().copied().map(NodeId).collect();
    alert
}

fn id(number: u128) -> AlertId {
    AlertId(Uuid::from_u128(number))
}

/// Decides about an alert without a change of the map.
async fn decide(store: &Store, number: u128, status: AlertStatus, second: i64, by_whom: &str) {
    let mut next = store.alert(id(number)).await.unwrap().unwrap();
    (next.revision, next.status, next.updated_at) = (next.revision + 1, status, at(second));
    let reason = (status == AlertStatus::Dismissed).then_some(DismissReason::Temporary);
    next.history.push(HistoryEntry {
        status,
        at: at(second),
        by: by_whom.to_owned(),
        note: None,
        reason,
    });
    let record = store.route(&route()).await.unwrap().unwrap();
    let action = match status {
        AlertStatus::Acknowledged => AlertAction::Acknowledge,
        AlertStatus::Dismissed => AlertAction::Dismiss,
        _ => AlertAction::Reopen,
    };
    let decision = Decision {
        base_revision: record.revision,
        action,
        actor: by().clone(),
        alerts: vec![next],
        map: None,
    };
    assert_eq!(
        store.apply_decision(decision).await.unwrap(),
        Decided::Committed
    );
}

/// A batch rests under every alert that names one of its nodes.
#[tokio::test]
async fn the_alerts_of_a_batch_are_those_that_name_its_nodes() {
    let fixture = Fixture::new().await;
    let store = &fixture.store;
    for (batch, alerts) in [
        ("b0", vec![]),
        ("b1", vec![raised(1, 10, &[2, 5]), raised(2, 10, &[6])]),
        ("b2", vec![raised(3, 20, &[1, 6, 9])]),
    ] {
        fixture.journal(upload(batch, batch, 0)).await;
        let job = fixture.claim(0).await.unwrap();
        let mut result = fixture.chain(&job, 3).await;
        result.alerts = alerts;
        store.apply_result(result).await.unwrap();
    }
    // Nodes 1 to 3 came with b0, 4 to 6 with b1, 7 to 9 with b2.
    let expected: BTreeMap<BatchId, Vec<AlertId>> = [
        ("b0", vec![id(1), id(3)]),
        ("b1", vec![id(1), id(2), id(3)]),
        ("b2", vec![id(3)]),
    ]
    .map(|(batch, alerts)| (batch_id(batch), alerts))
    .into();
    for (batch, alerts) in &expected {
        assert_eq!(
            &store.batch_alerts(&route(), batch).await.unwrap(),
            alerts,
            "{batch}"
        );
    }
    let mut asked: Vec<BatchId> = expected.keys().cloned().collect();
    asked.push(batch_id("unknown"));
    assert_eq!(
        store.alerts_by_batch(&route(), &asked).await.unwrap(),
        expected
    );
    let unknown = store.batch_alerts(&route(), &batch_id("unknown")).await;
    assert_eq!(unknown.unwrap(), []);
}

#[tokio::test]
async fn pending_changes_follow_from_the_alerts_of_a_route() {
    let fixture = Fixture::new().await;
    let store = &fixture.store;
    for (number, batch) in [(1, "b1"), (2, "b2"), (3, "b3")] {
        write(&fixture, batch, &raised(number, 10, &[1]))
            .await
            .unwrap();
    }
    decide(store, 2, AlertStatus::Dismissed, 20, "kim").await;
    let mut resolved = store.alert(id(3)).await.unwrap().unwrap();
    resolved.revision += 1;
    resolved.status = AlertStatus::Resolved;
    resolved.history.push(HistoryEntry {
        status: AlertStatus::Resolved,
        ..resolved.history[0].clone()
    });
    write(&fixture, "b4", &resolved).await.unwrap();
    let mut expected = Vec::new();
    for number in 1..=3 {
        let alert = store.alert(id(number)).await.unwrap().unwrap();
        expected.extend(PendingChange::of(alert.status, &alert.evidence));
    }
    assert_eq!(expected.len(), 2);
    let pending = store.pending_changes(&route()).await.unwrap();
    assert_eq!(pending, expected);
}

#[tokio::test]
async fn the_last_event_is_the_end_of_the_stream_and_of_every_part_of_it() {
    let fixture = Fixture::new().await;
    let store = &fixture.store;
    assert_eq!(store.last_alert_event().await.unwrap(), 0);
    for (number, batch) in [(1, "b1"), (2, "b2")] {
        write(&fixture, batch, &raised(number, 10, &[1]))
            .await
            .unwrap();
    }
    decide(store, 1, AlertStatus::Acknowledged, 20, "kim").await;
    let whole = store.alert_events(None, 0, 100).await.unwrap();
    let said: Vec<_> = whole
        .iter()
        .map(|event| (event.alert_id, event.revision))
        .collect();
    assert_eq!(said, [(id(1), 1), (id(2), 1), (id(1), 2)]);
    let last = store.last_alert_event().await.unwrap();
    assert_eq!(whole.last().map(|event| event.sequence), Some(last));
    for event in &whole {
        let rest = store
            .alert_events(Some(&route()), event.sequence, 100)
            .await;
        let after = whole.iter().filter(|other| other.sequence > event.sequence);
        assert_eq!(rest.unwrap(), after.copied().collect::<Vec<_>>());
    }
}

/// Every list is what its count says, cut short, and about the time and the route asked for.
#[tokio::test]
async fn a_report_says_what_happened_in_its_time() {
    let fixture = Fixture::new().await;
    let store = &fixture.store;
    put_route(store, "q").await;
    for (number, second, batch) in [(1, 10, "b1"), (2, 20, "b2"), (3, 30, "b3"), (4, 40, "b4")] {
        write(&fixture, batch, &raised(number, second, &[1]))
            .await
            .unwrap();
    }
    decide(store, 1, AlertStatus::Acknowledged, 25, "kim").await;
    decide(store, 1, AlertStatus::Dismissed, 35, "kim").await;
    decide(store, 2, AlertStatus::Dismissed, 45, "sam").await;
    decide(
        store,
        4,
        AlertStatus::Dismissed,
        46,
        mapshift::store::SYSTEM,
    )
    .await;

    let scope = |since, until, limit| ReportScope {
        since: at(since),
        until: at(until),
        route_id: Some(route()),
        limit,
    };
    let report = store.report(&scope(20, 40, 10)).await.unwrap();
    let raised: Vec<AlertId> = report.raised.iter().map(|alert| alert.id).collect();
    assert_eq!(raised, [id(3), id(2)]);
    let decided: Vec<_> = report
        .decided
        .iter()
        .map(|d| (d.alert_id, d.action, d.at))
        .collect();
    assert_eq!(
        decided,
        [
            (id(1), AlertAction::Dismiss, at(35)),
            (id(1), AlertAction::Acknowledge, at(25)),
        ]
    );
    let open: Vec<AlertId> = report.open.iter().map(|alert| alert.id).collect();
    assert_eq!(open, [id(3)]);
    let dismissals: Vec<_> = report
        .dismissals
        .iter()
        .map(|d| (d.reason, d.count))
        .collect();
    assert_eq!(dismissals, [(Some(DismissReason::Temporary), 1)]);
    let counts = ReportCounts {
        raised: 2,
        decided: 2,
        open: 1,
        muted: 0,
    };
    assert_eq!(report.counts, counts);

    // Cut short, the counts stay; of another route, or of no time, there is nothing.
    let short = store.report(&scope(20, 40, 1)).await.unwrap();
    assert_eq!(
        (short.raised.len(), short.decided.len(), short.counts),
        (1, 1, counts)
    );
    let elsewhere = ReportScope {
        route_id: Some(mapshift::ids::RouteId::new("q").unwrap()),
        ..scope(0, 100, 10)
    };
    let elsewhere = store.report(&elsewhere).await.unwrap();
    assert_eq!(elsewhere.counts, ReportCounts::default());
    let all = ReportScope {
        route_id: None,
        ..scope(0, 100, 10)
    };
    assert_eq!(store.report(&all).await.unwrap().counts.decided, 3);

    // A muted alert waits still, and is not among those that are shown.
    let zone = mapshift::ids::ZoneId(Uuid::from_u128(7));
    let made = store
        .create_zone(&route(), zone, mute(), by(), at(50))
        .await;
    assert_eq!(made.unwrap(), ZoneMade::Created);
    let muted = store.report(&scope(20, 40, 10)).await.unwrap();
    assert_eq!(
        (muted.counts.open, muted.counts.muted, muted.open.len()),
        (0, 1, 0)
    );
    assert_eq!(fixture.status("b1").await, BatchStatus::Merged);
}
