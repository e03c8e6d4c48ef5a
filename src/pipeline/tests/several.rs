use super::bench::{BOX_AT, Bench, box_finding, finding_at, route};
use crate::change::{AlertAction, AlertStatus};
use crate::geometry::Vector2;
use crate::ids::AlertId;
use crate::model::{Actor, DecisionResult};
use crate::store::{AlertRecord, DecisionOutcome, DecisionRequest, DecisionsRequest};

/// Another place, along another side of the way.
const ELSEWHERE: Vector2<f64> = Vector2::new(11.4, 8.0);

/// A map with two alerts, the oldest first.
async fn with_two_alerts() -> (Bench, [AlertRecord; 2]) {
    let bench = Bench::new().await;
    bench.lap("before", 0, 2, |_| Vec::new()).await;
    let found = |map: &_| vec![finding_at(map, BOX_AT), finding_at(map, ELSEWHERE)];
    bench.lap("after", 1, 1, found).await;
    let mut alerts = bench.alerts().await;
    alerts.reverse();
    (bench, alerts.try_into().unwrap())
}

fn one(alert: &AlertRecord, action: AlertAction) -> DecisionRequest {
    DecisionRequest {
        alert_id: alert.id,
        action,
        decision_revisions: Some(vec![alert.decision_revision]),
        note: Some("as planned".to_owned()),
        reason: None,
    }
}

async fn decide(bench: &Bench, decisions: Vec<DecisionRequest>) -> Vec<DecisionOutcome> {
    let request = DecisionsRequest {
        decisions,
        by: "keeper".to_owned(),
        actor: Actor::Local {
            address: "192.0.2.7".to_owned(),
        },
        routes: None,
    };
    bench.decisions.decide_all(request).await.unwrap()
}

fn results(outcomes: &[DecisionOutcome]) -> Vec<(DecisionResult, Option<i64>)> {
    let of = |outcome: &DecisionOutcome| (outcome.result, outcome.map_version);
    outcomes.iter().map(of).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_accepted_together_makes_one_version() {
    let (bench, alerts) = with_two_alerts().await;
    let before = bench.state().await;
    let accept = || {
        let accepts = alerts.iter().rev();
        let accepts = accepts.map(|alert| one(alert, AlertAction::Accept));
        accepts.collect::<Vec<_>>()
    };
    let outcomes = decide(&bench, accept()).await;
    let done = (DecisionResult::Done, Some(2));
    assert_eq!(results(&outcomes), [done, done]);
    let asked: Vec<AlertId> = outcomes.iter().map(|outcome| outcome.alert_id).collect();
    assert_eq!(asked, [alerts[1].id, alerts[0].id]);
    let store = &bench.engine.store;
    let versions = store.map_versions(&route(), 0, 9).await.unwrap();
    assert_eq!(versions.len(), 2);
    let accepted = store.accepted_changes(&route()).await.unwrap();
    let accepted: Vec<_> = accepted
        .iter()
        .map(|c| (c.alert_id, c.map_version))
        .collect();
    assert_eq!(accepted, [(alerts[0].id, 2), (alerts[1].id, 2)]);
    let together = bench.state().await;

    // Again, nothing more happens.
    let again = decide(&bench, accept()).await;
    let already = (DecisionResult::AlreadyDone, None);
    assert_eq!(results(&again), [already, already]);

    // One after the other comes to the same map, in two versions.
    let (other, alerts_there) = with_two_alerts().await;
    for alert in &alerts_there {
        other.decide(alert, AlertAction::Accept).await;
    }
    let separately = other.state().await;
    assert!(separately.pgm == together.pgm && separately.g2o == together.g2o);

    // Taken back the other way round, the map is what it was, to the bit; also after a restart.
    let bench = bench.restarted().await;
    assert!(bench.state().await == together);
    for alert in bench.alerts().await {
        bench.decide(&alert, AlertAction::Undo).await;
    }
    assert!(bench.state().await == before);
}

#[tokio::test(flavor = "multi_thread")]
async fn each_is_carried_out_or_not_on_its_own() {
    let (bench, [first, second]) = with_two_alerts().await;
    bench.decide(&first, AlertAction::Acknowledge).await;
    let mut any = one(&second, AlertAction::Accept);
    any.decision_revisions = None;
    let outcomes = decide(&bench, vec![one(&first, AlertAction::Accept), any]).await;
    assert_eq!(
        results(&outcomes),
        [
            (DecisionResult::Changed, None),
            (DecisionResult::Done, Some(2))
        ]
    );
    let detail = outcomes[0].detail.as_deref().unwrap();
    assert!(detail.contains("it is acknowledged"), "{detail}");
    let statuses: Vec<_> = bench.alerts().await.iter().map(|a| a.status).collect();
    assert_eq!(statuses, [AlertStatus::Accepted, AlertStatus::Acknowledged]);
}

/// What is decided about stays as it is while vehicles drive on.
#[tokio::test(flavor = "multi_thread")]
async fn more_evidence_refuses_nothing() {
    let (bench, alerts) = with_two_alerts().await;
    let found = |map: &_| vec![box_finding(map), finding_at(map, ELSEWHERE)];
    bench.lap("later", 2, 1, found).await;
    let accepts = alerts.iter().map(|alert| one(alert, AlertAction::Accept));
    let outcomes = decide(&bench, accepts.collect()).await;
    let done = (DecisionResult::Done, Some(2));
    assert_eq!(results(&outcomes), [done, done]);
}
