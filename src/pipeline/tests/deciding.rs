use super::bench::{Bench, box_finding, route};
use crate::change::{AlertAction, AlertStatus, ChangeKind, Finding};
use crate::geometry::Vector2;
use crate::ids::EdgeId;
use crate::model::Actor;
use crate::pipeline::{DecisionError, Order};
use crate::store::{
    AcceptanceChange, Decided, Decision, EdgeChange, MapDecision, MapPicture, StoreError,
};

async fn refusal(bench: &Bench, order: Order) -> DecisionError {
    bench.decisions.decide(order).await.unwrap_err()
}

#[tokio::test(flavor = "multi_thread")]
async fn only_what_was_seen_can_be_decided_about() {
    let (bench, alert) = Bench::with_alert().await;
    let acknowledged = bench.decide(&alert, AlertAction::Acknowledge).await;
    assert_eq!(acknowledged.status, AlertStatus::Acknowledged);
    for action in AlertAction::ALL {
        let stale = refusal(&bench, Bench::order(&alert, action)).await;
        assert!(matches!(stale, DecisionError::Changed(now) if *now == acknowledged));
    }
    for action in [AlertAction::Acknowledge, AlertAction::Undo] {
        let refused = refusal(&bench, Bench::order(&acknowledged, action)).await;
        assert!(
            matches!(refused, DecisionError::NotAllowed(_)),
            "{refused:?}"
        );
    }
    let mut unknown = Bench::order(&alert, AlertAction::Accept);
    unknown.alert_id = crate::ids::AlertId(uuid::Uuid::nil());
    let unknown = refusal(&bench, unknown).await;
    assert!(matches!(unknown, DecisionError::UnknownAlert));
    assert_eq!(bench.alerts().await, [acknowledged]);
}

#[tokio::test(flavor = "multi_thread")]
async fn more_evidence_refuses_no_decision_and_another_place_does() {
    let (bench, alert) = Bench::with_alert().await;
    bench.lap("later", 2, 1, |map| vec![box_finding(map)]).await;
    let grown = bench.alerts().await.remove(0);
    assert!(grown.revision > alert.revision, "{grown:?}");
    assert_eq!(grown.decision_revision, alert.decision_revision);
    let acknowledged = bench.decide(&alert, AlertAction::Acknowledge).await;
    assert_eq!(
        (acknowledged.status, acknowledged.decision_revision),
        (AlertStatus::Acknowledged, alert.decision_revision + 1)
    );
    let moved = |finding: Finding| Finding {
        region: (finding.region.iter())
            .map(|corner| corner + Vector2::new(0.3, 0.0))
            .collect(),
        ..finding
    };
    bench
        .lap("last", 3, 1, |map| vec![moved(box_finding(map))])
        .await;
    let moved = bench.alerts().await.remove(0);
    assert_eq!(moved.id, alert.id);
    assert_eq!(
        moved.decision_revision,
        acknowledged.decision_revision + 1,
        "{moved:?}"
    );
    let refused = refusal(&bench, Bench::order(&acknowledged, AlertAction::Dismiss)).await;
    assert!(matches!(refused, DecisionError::Changed(now) if *now == moved));
}

#[tokio::test(flavor = "multi_thread")]
async fn of_two_who_decide_at_once_one_must_read_again() {
    let (bench, alert) = Bench::with_alert().await;
    let accept = bench
        .decisions
        .decide(Bench::order(&alert, AlertAction::Accept));
    let dismiss = bench
        .decisions
        .decide(Bench::order(&alert, AlertAction::Dismiss));
    let (accept, dismiss) = tokio::join!(accept, dismiss);
    assert!(accept.is_ok() != dismiss.is_ok());
    let loser = accept.err().or(dismiss.err()).unwrap();
    assert!(matches!(loser, DecisionError::Changed(_)), "{loser:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_dismissed_alert_keeps_the_map_and_comes_back_only_by_hand() {
    let (bench, alert) = Bench::with_alert().await;
    let before = bench.state().await;
    let dismissed = bench.decide(&alert, AlertAction::Dismiss).await;
    assert!(bench.state().await == before);
    bench.lap("later", 2, 1, |map| vec![box_finding(map)]).await;
    let alerts = bench.alerts().await;
    assert_eq!(alerts.len(), 1);
    assert_eq!(alerts[0].status, AlertStatus::Dismissed);
    assert!(alerts[0].evidence.last_seen > dismissed.evidence.last_seen);
    let record = bench.engine.store.route(&route()).await.unwrap().unwrap();
    assert_eq!((record.counts.open_alerts, record.map_version), (0, 1));
    let reopened = bench.decide(&alerts[0], AlertAction::Reopen).await;
    assert_eq!(reopened.status, AlertStatus::Open);
    let bench = bench.restarted().await;
    assert_eq!(bench.alerts().await, [reopened]);
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_no_change_of_the_world_cannot_be_accepted() {
    let suspect = |finding: Finding| Finding {
        kind: ChangeKind::VehicleSuspect,
        ..finding
    };
    let shifted = |finding: Finding| Finding {
        kind: ChangeKind::MapMismatch,
        shift: Some(Vector2::new(0.4, 0.0)),
        ..finding
    };
    let missing = |finding: Finding| Finding {
        kind: ChangeKind::MapMismatch,
        ..finding
    };
    for of_no_change in [suspect as fn(Finding) -> Finding, shifted, missing] {
        let bench = Bench::new().await;
        bench.lap("before", 0, 1, |_| Vec::new()).await;
        bench
            .lap("after", 1, 1, |map| vec![of_no_change(box_finding(map))])
            .await;
        let alert = bench.alerts().await.remove(0);
        let refused = refusal(&bench, Bench::order(&alert, AlertAction::Accept)).await;
        assert!(matches!(refused, DecisionError::NotAllowed(_)));
        bench.decide(&alert, AlertAction::Dismiss).await;
    }
}

/// All of a decision is in one transaction: what cannot be written to its end leaves no trace.
#[tokio::test(flavor = "multi_thread")]
async fn half_a_decision_is_none() {
    let (bench, alert) = Bench::with_alert().await;
    let store = &bench.engine.store;
    let record = store.route(&route()).await.unwrap().unwrap();
    let before = (bench.state().await, record.clone(), bench.alerts().await);
    let mut next = alert.clone();
    next.revision += 1;
    next.status = AlertStatus::Accepted;
    let mut entry = next.history[0].clone();
    entry.status = AlertStatus::Accepted;
    next.history.push(entry);
    let nowhere = EdgeChange {
        id: EdgeId(9_999),
        status: crate::graph::EdgeStatus::Retired,
        subgraph_id: None,
    };
    let map = MapDecision {
        accepted: AcceptanceChange::Removed,
        changed_nodes: Vec::new(),
        changed_edges: vec![nowhere],
        superseded: MapPicture {
            png: vec![1],
            pgm: vec![2],
            yaml: String::new(),
        },
        max_displacement_m: 0.0,
    };
    let mut decision = Decision {
        base_revision: record.revision,
        action: AlertAction::Undo,
        actor: Actor::System,
        alerts: vec![next],
        map: Some(map),
    };
    for _ in 0..2 {
        let refused = store.apply_decision(decision.clone()).await;
        assert!(matches!(refused, Err(StoreError::InvalidResult(_))));
        // The second time it fails at its last step: nothing was accepted that could be undone.
        decision.map.as_mut().unwrap().changed_edges.clear();
    }
    decision.base_revision -= 1;
    let stale = store.apply_decision(decision).await.unwrap();
    assert_eq!(stale, Decided::Stale);
    let record = store.route(&route()).await.unwrap().unwrap();
    let after = (bench.state().await, record, bench.alerts().await);
    assert!(after == before);
    assert_eq!(store.map_versions(&route(), 0, 9).await.unwrap().len(), 1);
}
