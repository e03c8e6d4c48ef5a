//! Decisions that change a map: accepted changes, versions, and undo.

use mapshift::change::{AcceptedChange, AlertAction, AlertStatus, Tier};
use mapshift::ids::{AlertId, EdgeId, NodeId};
use mapshift::model::VersionAction;
use mapshift::store::{
    Acceptance, AcceptanceChange, AlertRecord, Decided, Decision, HistoryEntry, MapDecision,
    MapPicture, MapVersionRecord, StoreError,
};

use crate::support::{Fixture, at, by, route};
use crate::tiers::{alert, write};

pub fn taken_in(alert: &AlertRecord, map_version: i64) -> Acceptance {
    Acceptance {
        change: AcceptedChange {
            alert_id: alert.id,
            region: alert.evidence.region.clone(),
            since: alert.evidence.since,
            map_version,
            nodes: vec![NodeId(1), NodeId(7)],
            first_edge_id: EdgeId(3),
        },
        undo: vec![map_version as u8; 300],
    }
}

/// A decision about the present revisions of alerts; the picture of the superseded map encodes the second.
async fn decision(
    fixture: &Fixture,
    alerts: &[AlertId],
    action: AlertAction,
    accepted: AcceptanceChange,
    second: i64,
) -> Decision {
    let status = match action {
        AlertAction::Accept => AlertStatus::Accepted,
        _ => AlertStatus::Open,
    };
    let mut nexts = Vec::new();
    for id in alerts {
        let mut next = fixture.store.alert(*id).await.unwrap().unwrap();
        (next.revision, next.status, next.updated_at) = (next.revision + 1, status, at(second));
        next.history.push(HistoryEntry {
            status,
            at: at(second),
            by: "kim".to_owned(),
            note: None,
            reason: None,
        });
        nexts.push(next);
    }
    Decision {
        base_revision: fixture.revision(&route()).await,
        action,
        actor: by().clone(),
        alerts: nexts,
        map: Some(MapDecision {
            accepted,
            changed_nodes: Vec::new(),
            changed_edges: Vec::new(),
            superseded: MapPicture {
                pgm: second.to_le_bytes().to_vec(),
                ..MapPicture::default()
            },
            max_displacement_m: 0.25,
        }),
    }
}

async fn decide(fixture: &Fixture, decision: Decision) {
    let decided = fixture.store.apply_decision(decision).await;
    assert_eq!(decided.unwrap(), Decided::Committed);
}

async fn three_alerts() -> (Fixture, Vec<AlertRecord>) {
    let fixture = Fixture::new().await;
    let alerts: Vec<AlertRecord> = (1..=3).map(|n| alert(n, Tier::Confirmed)).collect();
    for (alert, batch) in alerts.iter().zip(["b1", "b2", "b3"]) {
        write(&fixture, batch, alert).await.unwrap();
    }
    (fixture, alerts)
}

#[tokio::test]
async fn what_is_accepted_is_in_the_map_until_it_is_taken_back() {
    let (fixture, alerts) = three_alerts().await;
    let store = &fixture.store;
    let together = vec![taken_in(&alerts[2], 2), taken_in(&alerts[0], 2)];
    let ids = [alerts[2].id, alerts[0].id];
    let added = AcceptanceChange::Added(together.clone());
    let accept = decision(&fixture, &ids, AlertAction::Accept, added, 100).await;
    decide(&fixture, accept.clone()).await;
    // The same once more is about a route that has moved on.
    assert_eq!(store.apply_decision(accept).await.unwrap(), Decided::Stale);
    let (one, middle) = (vec![taken_in(&alerts[1], 3)], [alerts[1].id]);
    let added = AcceptanceChange::Added(one.clone());
    decide(
        &fixture,
        decision(&fixture, &middle, AlertAction::Accept, added, 110).await,
    )
    .await;

    let accepted = store.accepted_changes(&route()).await.unwrap();
    let expected =
        [&together[1], &together[0], &one[0]].map(|acceptance| acceptance.change.clone());
    assert_eq!(accepted, expected);
    assert_eq!(
        store.load_graph(&route()).await.unwrap().unwrap().accepted,
        expected
    );
    for acceptance in together.iter().chain(&one) {
        let found = store.acceptance(acceptance.change.alert_id).await.unwrap();
        assert_eq!(found.as_ref(), Some(acceptance));
    }

    let undo = decision(
        &fixture,
        &ids[..1],
        AlertAction::Undo,
        AcceptanceChange::Removed,
        120,
    );
    decide(&fixture, undo.await).await;
    assert_eq!(store.acceptance(ids[0]).await.unwrap(), None);
    let accepted = store.accepted_changes(&route()).await.unwrap();
    assert_eq!(accepted, [expected[0].clone(), expected[2].clone()]);
    // What is not in the map is not taken out of it, and the attempt leaves nothing.
    let before = store.route(&route()).await.unwrap();
    let again = decision(
        &fixture,
        &ids[..1],
        AlertAction::Undo,
        AcceptanceChange::Removed,
        130,
    );
    let refused = store.apply_decision(again.await).await;
    assert!(
        matches!(refused, Err(StoreError::InvalidResult(_))),
        "{refused:?}"
    );
    assert_eq!(store.route(&route()).await.unwrap(), before);
}

#[tokio::test]
async fn every_decision_about_the_map_begins_a_version_and_keeps_the_one_before() {
    let (fixture, alerts) = three_alerts().await;
    let store = &fixture.store;
    let ids: Vec<AlertId> = alerts.iter().map(|alert| alert.id).collect();
    for (number, version, second) in [(0, 2, 100), (1, 3, 110)] {
        let added = AcceptanceChange::Added(vec![taken_in(&alerts[number], version)]);
        let accept = decision(
            &fixture,
            &ids[number..=number],
            AlertAction::Accept,
            added,
            second,
        );
        decide(&fixture, accept.await).await;
    }
    let undo = decision(
        &fixture,
        &ids[..1],
        AlertAction::Undo,
        AcceptanceChange::Removed,
        120,
    );
    decide(&fixture, undo.await).await;

    let versions = store.map_versions(&route(), 0, 10).await.unwrap();
    let said = |version: &MapVersionRecord| {
        let cause = version.cause.as_ref();
        let cause = cause.map(|cause| (cause.alert_id, cause.action));
        (version.version, cause, version.superseded_at)
    };
    let found: Vec<_> = versions.iter().map(said).collect();
    let caused = |number: usize, action| Some((Some(ids[number]), action));
    assert_eq!(
        found,
        [
            (1, None, Some(at(100))),
            (2, caused(0, VersionAction::Accept), Some(at(110))),
            (3, caused(1, VersionAction::Accept), Some(at(120))),
            (4, caused(0, VersionAction::Undo), None),
        ]
    );
    assert!(
        versions
            .windows(2)
            .all(|pair| pair[0].superseded_at == Some(pair[1].created_at))
    );
    for version in &versions {
        let found = store.map_version(&route(), version.version).await.unwrap();
        assert_eq!(found.as_ref(), Some(version));
        let picture = store
            .map_version_picture(&route(), version.version)
            .await
            .unwrap();
        let ended = version
            .superseded_at
            .map(|at| at.as_second() - 1_800_000_000);
        assert_eq!(
            picture.map(|picture| picture.pgm),
            ended.map(|s| s.to_le_bytes().to_vec())
        );
    }
    assert_eq!(store.map_version(&route(), 5).await.unwrap(), None);

    // After one moment and until another: the first is left out, the second is not.
    for (after, until, expected) in [
        (0, 99, vec![]),
        (99, 110, vec![ids[0], ids[1]]),
        (100, 110, vec![ids[1]]),
        (110, 200, vec![ids[0]]),
        (120, 200, vec![]),
    ] {
        let found = store
            .alerts_in_map_between(&route(), at(after), at(until))
            .await;
        assert_eq!(found.unwrap(), expected, "{after} to {until}");
    }
}
