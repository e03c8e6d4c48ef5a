//! What webhooks are sent beside alerts, and by which secrets.

use mapshift::change::{AlertStatus, ChangeKind, Tier};
use mapshift::ids::{OperationId, RouteId, VehicleId, WebhookId};
use mapshift::model::{Actor, BatchStatus, VehicleState, WebhookEvent, WebhookTopic};
use mapshift::store::{
    Edited, HistoryEntry, Meant, NewSecret, NewWebhook, OperationRequest, Quarantine, Registered,
    RemovalRequest, SYSTEM, Store, Subject, WebhookSecret,
};
use uuid::Uuid;

use crate::support::{Fixture, at, batch_id, by, put_route, route, upload};
use crate::tiers::{alert, write};

const WEBHOOK: WebhookId = WebhookId(Uuid::from_u128(1));

fn vehicle() -> VehicleId {
    VehicleId::new("v").unwrap()
}

async fn register(store: &Store, number: u128, events: &[WebhookTopic], route: Option<RouteId>) {
    let webhook = NewWebhook {
        id: WebhookId(Uuid::from_u128(number)),
        url: "https://example.com/".into(),
        secret: WebhookSecret([1; 32]),
        events: events.to_vec(),
        route_id: route,
        description: None,
        include_tentative: false,
        created_at: at(0),
    };
    let registered = store.register_webhook(webhook, by()).await.unwrap();
    assert_eq!(registered, Registered::Created);
}

/// What a webhook is sent, the oldest first.
async fn sent(store: &Store, number: u128) -> Vec<(WebhookTopic, Subject)> {
    let webhook = WebhookId(Uuid::from_u128(number));
    let mut sent = store.deliveries(webhook, None, 100).await.unwrap();
    sent.reverse();
    let sent = sent.into_iter().map(|one| match one.event {
        WebhookEvent::Topic(topic) => (topic, one.subject.unwrap()),
        WebhookEvent::Test => panic!("nobody asked for a test"),
    });
    sent.collect()
}

async fn state(store: &Store) -> VehicleState {
    let found = store.vehicle(&route(), &vehicle()).await.unwrap();
    found.unwrap().state()
}

/// A batch of the vehicle that ends so.
async fn end(fixture: &Fixture, id: &str, status: BatchStatus) {
    fixture.journal(upload(id, id, 0)).await;
    let job = fixture.claim(0).await.unwrap();
    let result = fixture.result(&job, status).await;
    fixture.store.apply_result(result).await.unwrap();
}

fn of_batch(id: &str) -> (WebhookTopic, Subject) {
    let subject = Subject::Batch(route(), batch_id(id));
    (WebhookTopic::BatchQuarantined, subject)
}

fn of_vehicle() -> (WebhookTopic, Subject) {
    let subject = Subject::Vehicle(route(), vehicle());
    (WebhookTopic::VehicleSuspect, subject)
}

#[tokio::test]
async fn every_way_into_quarantine_is_sent_once() {
    let fixture = Fixture::new().await;
    let store = &fixture.store;
    put_route(store, "other").await;
    let wanted = [WebhookTopic::BatchQuarantined];
    register(store, 1, &wanted, None).await;
    register(store, 2, &wanted, Some(RouteId::new("other").unwrap())).await;
    register(store, 3, &WebhookTopic::DEFAULT, None).await;
    end(&fixture, "merged", BatchStatus::Merged).await;
    assert_eq!(sent(store, 1).await, []);
    // By its result, on arrival, and because it cannot be worked on.
    end(&fixture, "b0", BatchStatus::Quarantined).await;
    fixture.journal(upload("taken", "merged", 0)).await;
    assert_eq!(fixture.status("taken").await, BatchStatus::Quarantined);
    fixture.journal(upload("hopeless", "t", 0)).await;
    let job = fixture.claim(0).await.unwrap();
    let given_up = store.give_up_job(job.job_id, job.generation, "no", at(1));
    given_up.await.unwrap();
    let expected = [of_batch("b0"), of_batch("taken"), of_batch("hopeless")];
    assert_eq!(sent(store, 1).await, expected);
    assert_eq!(sent(store, 2).await, [], "of another route");
    assert_eq!(sent(store, 3).await, [], "alerts alone");
    // With its batches goes what was to be sent of them.
    store
        .delete_route(&route(), None, by(), at(2))
        .await
        .unwrap();
    assert_eq!(sent(store, 1).await, []);
}

#[tokio::test]
async fn a_vehicle_is_sent_when_it_becomes_suspect_and_not_while_it_is() {
    let fixture = Fixture::new().await;
    let store = &fixture.store;
    register(store, 1, &[WebhookTopic::VehicleSuspect], None).await;
    end(&fixture, "b0", BatchStatus::Quarantined).await;
    end(&fixture, "b1", BatchStatus::Quarantined).await;
    assert_eq!(
        (state(store).await, sent(store, 1).await),
        (VehicleState::Trusted, vec![])
    );
    for batch in ["b2", "b3", "b4"] {
        end(&fixture, batch, BatchStatus::Quarantined).await;
        assert_eq!(state(store).await, VehicleState::Suspect);
        assert_eq!(sent(store, 1).await, [of_vehicle()]);
    }
    // Ten good batches later it is trusted, and can become suspect again.
    for k in 0..10 {
        end(&fixture, &format!("good-{k}"), BatchStatus::Merged).await;
    }
    assert_eq!(state(store).await, VehicleState::Trusted);
    for k in 0..3 {
        end(&fixture, &format!("bad-{k}"), BatchStatus::Quarantined).await;
    }
    assert_eq!(sent(store, 1).await, vec![of_vehicle(); 2]);
    // Kept out by hand, which is more; and suspect again once it is released, which is less.
    let quarantine = |quarantine, second| async move {
        let (route, vehicle) = (route(), vehicle());
        let put = store.put_quarantine(&route, &vehicle, quarantine, by(), at(second));
        assert!(put.await.unwrap());
    };
    let reason = Quarantine {
        since: at(20),
        note: None,
    };
    quarantine(Some(reason.clone()), 20).await;
    quarantine(Some(reason), 21).await;
    assert_eq!(state(store).await, VehicleState::Quarantined);
    assert_eq!(sent(store, 1).await, vec![of_vehicle(); 3]);
    quarantine(None, 22).await;
    assert_eq!(state(store).await, VehicleState::Suspect);
    assert_eq!(sent(store, 1).await, vec![of_vehicle(); 3]);
}

#[tokio::test]
async fn an_alert_that_suspects_a_vehicle_makes_it_suspect_until_it_is_decided_about() {
    let fixture = Fixture::new().await;
    let store = &fixture.store;
    register(store, 1, &[WebhookTopic::VehicleSuspect], None).await;
    let mut suspected = alert(1, Tier::Confirmed);
    suspected.evidence.kind = ChangeKind::VehicleSuspect;
    write(&fixture, "b0", &suspected).await.unwrap();
    assert_eq!(state(store).await, VehicleState::Suspect);
    assert_eq!(sent(store, 1).await, [of_vehicle()]);
    let mut step = async |batch: &str, status| {
        suspected.revision += 1;
        suspected.decision_revision += 1;
        suspected.status = status;
        suspected.history.push(HistoryEntry {
            status,
            at: at(1),
            by: SYSTEM.to_owned(),
            note: None,
            reason: None,
        });
        write(&fixture, batch, &suspected).await.unwrap();
    };
    step("b1", AlertStatus::Acknowledged).await;
    assert_eq!(sent(store, 1).await.len(), 1);
    step("b2", AlertStatus::Resolved).await;
    assert_eq!(state(store).await, VehicleState::Trusted);
    step("b3", AlertStatus::Open).await;
    assert_eq!(sent(store, 1).await, vec![of_vehicle(); 2]);
}

#[tokio::test]
async fn an_operation_is_sent_when_it_has_ended() {
    let fixture = Fixture::new().await;
    let store = &fixture.store;
    register(store, 1, &WebhookTopic::ALL, Some(route())).await;
    let id = OperationId(Uuid::from_u128(9));
    let request = OperationRequest::Removal(RemovalRequest {
        meant: Meant::Batches(vec![batch_id("b0")]),
        dry_run: true,
        erase: false,
        note: None,
    });
    let route = route();
    let asked = store.ask_for(id, Some(&route), request, by(), at(1));
    asked.await.unwrap();
    assert_eq!(sent(store, 1).await, []);
    for _ in 0..2 {
        let failed = Err("no such batch".to_owned());
        store.end_operation(id, failed, at(2)).await.unwrap();
    }
    let expected = (WebhookTopic::OperationFinished, Subject::Operation(id));
    assert_eq!(sent(store, 1).await, [expected]);
}

#[tokio::test]
async fn a_replaced_secret_is_kept_for_as_long_as_it_is_valid() {
    let fixture = Fixture::new().await;
    let store = &fixture.store;
    register(store, 1, &WebhookTopic::ALL, None).await;
    store.queue_webhook_test(WEBHOOK, at(0)).await.unwrap();
    let secrets = async || {
        let next = store.next_deliveries().await.unwrap().remove(0);
        let previous = next
            .previous_secret
            .map(|(secret, until)| (secret.0[0], until));
        (next.secret.0[0], previous)
    };
    let rotate = async |key: u8, revision, previous_until| {
        let secret = NewSecret {
            secret: WebhookSecret([key; 32]),
            previous_until,
        };
        let rotated = store.rotate_webhook_secret(WEBHOOK, revision, secret, by(), at(1));
        rotated.await.unwrap()
    };
    assert_eq!(secrets().await, (1, None));
    assert_eq!(rotate(2, Some(1), Some(at(9))).await, Edited::Done);
    assert_eq!(secrets().await, (2, Some((1, at(9)))));
    // The same request once more is refused, so that the secret before stays valid.
    assert_eq!(rotate(3, Some(1), Some(at(9))).await, Edited::Stale);
    assert_eq!(secrets().await, (2, Some((1, at(9)))));
    store.delete_previous_secrets(at(8)).await.unwrap();
    let webhook = store.webhook(WEBHOOK).await.unwrap().unwrap();
    assert_eq!(
        (webhook.revision, webhook.previous_secret_until),
        (2, Some(at(9)))
    );
    store.delete_previous_secrets(at(9)).await.unwrap();
    assert_eq!(secrets().await, (2, None));
    assert_eq!(rotate(4, None, None).await, Edited::Done);
    assert_eq!(secrets().await, (4, None));
    let nobody = WebhookId(Uuid::from_u128(7));
    let secret = NewSecret {
        secret: WebhookSecret([0; 32]),
        previous_until: None,
    };
    let unknown = store.rotate_webhook_secret(nobody, None, secret, &Actor::System, at(1));
    assert_eq!(unknown.await.unwrap(), Edited::Unknown);
}
