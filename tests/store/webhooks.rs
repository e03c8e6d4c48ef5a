//! Webhooks and what waits for them. Tests of a webhook stand in for events: they are queued alike.
//!
//! With SQL past the store, for SQLite: many deliveries at once.

use jiff::Timestamp;
use mapshift::ids::WebhookId;
use mapshift::model::{DeliveryFailure, DeliveryStatus, WebhookTopic};
use mapshift::store::{
    Attempt, AttemptEnd, AttemptVerdict, DeliveryRecord, Edited, NewWebhook, NextDelivery,
    Registered, Store, TestQueued, WebhookSecret, WebhookUpdate,
};

use crate::support::{Fixture, at, by, open, route};

fn id(number: u128) -> WebhookId {
    WebhookId(uuid::Uuid::from_u128(number))
}

async fn register(store: &Store, number: u128) {
    let webhook = NewWebhook {
        id: id(number),
        url: format!("https://example.com/{number}"),
        secret: WebhookSecret([number as u8; 32]),
        events: vec![WebhookTopic::AlertRaised],
        route_id: None,
        description: None,
        include_tentative: false,
        created_at: at(0),
    };
    let registered = store.register_webhook(webhook, by()).await.unwrap();
    assert_eq!(registered, Registered::Created);
}

async fn queue(store: &Store, number: u128, now: Timestamp) -> DeliveryRecord {
    match store.queue_webhook_test(id(number), now).await.unwrap() {
        TestQueued::Queued(delivery) => delivery,
        other => panic!("{other:?}"),
    }
}

async fn next(store: &Store) -> Vec<NextDelivery> {
    store.next_deliveries().await.unwrap()
}

async fn only(store: &Store, number: u128) -> DeliveryRecord {
    let [delivery] = store
        .deliveries(id(number), None, 10)
        .await
        .unwrap()
        .try_into()
        .unwrap();
    delivery
}

fn attempt(next: &NextDelivery, end: AttemptEnd, verdict: AttemptVerdict) -> Attempt {
    Attempt {
        delivery_key: next.key,
        attempts: next.attempts + 1,
        webhook_revision: next.webhook_revision,
        alert_revision: None,
        ended_at: at(10),
        end,
        verdict,
    }
}

#[tokio::test]
async fn what_waits_is_handed_out_one_for_each_webhook_and_outlives_the_process() {
    let Fixture { store, directory } = Fixture::new().await;
    for number in 1..=3 {
        register(&store, number).await;
    }
    let second = queue(&store, 2, at(5)).await;
    let first = queue(&store, 1, at(7)).await;
    assert_eq!(queue(&store, 1, at(8)).await, first, "one test at a time");
    assert_eq!(first.status, DeliveryStatus::Pending);
    assert_eq!((first.attempts, first.next_attempt_at), (0, Some(at(7))));
    let waiting = next(&store).await;
    let told: Vec<(&str, i64)> = waiting
        .iter()
        .map(|next| (&*next.id, next.attempts))
        .collect();
    assert_eq!(told, [(&*second.id, 0), (&*first.id, 0)]);
    assert_eq!(waiting[0].secret, WebhookSecret([2; 32]));
    assert_eq!(waiting[0].url, "https://example.com/2");

    store.close().await.unwrap();
    let again = open(&directory).await;
    assert_eq!(next(&again).await, waiting);
    again.close().await.unwrap();
}

#[tokio::test]
async fn an_attempt_is_noted_once() {
    let fixture = Fixture::new().await;
    let store = &fixture.store;
    register(store, 1).await;
    queue(store, 1, at(0)).await;
    let [first] = next(store).await.try_into().unwrap();
    let timeout = AttemptEnd::Failure(DeliveryFailure::Timeout);
    let failed = attempt(&first, timeout, AttemptVerdict::RetryAt(at(60)));
    store.record_attempt(failed.clone()).await.unwrap();
    let retried = only(store, 1).await;
    assert_eq!(
        (retried.attempts, retried.next_attempt_at),
        (1, Some(at(60)))
    );
    assert_eq!(
        (retried.last_end, retried.attempted_at),
        (Some(timeout), Some(at(10)))
    );

    // The same once more, and the answer of somebody who began as early: neither counts.
    store.record_attempt(failed).await.unwrap();
    let late = attempt(&first, AttemptEnd::Answer(500), AttemptVerdict::Failed);
    store.record_attempt(late).await.unwrap();
    assert_eq!(only(store, 1).await, retried);

    let [second] = next(store).await.try_into().unwrap();
    assert_eq!((second.attempts, second.due_at), (1, at(60)));
    let taken = attempt(&second, AttemptEnd::Answer(204), AttemptVerdict::Delivered);
    store.record_attempt(taken).await.unwrap();
    let delivered = only(store, 1).await;
    assert_eq!(delivered.status, DeliveryStatus::Delivered);
    assert_eq!((delivered.attempts, delivered.next_attempt_at), (2, None));
    assert_eq!(delivered.last_end, Some(AttemptEnd::Answer(204)));
    assert_eq!(next(store).await, []);
}

#[tokio::test]
async fn a_webhook_that_was_edited_meanwhile_is_not_disabled() {
    let fixture = Fixture::new().await;
    let store = &fixture.store;
    for edited in [false, true] {
        let number = 1 + u128::from(edited);
        register(store, number).await;
        queue(store, number, at(0)).await;
        let [next] = next(store).await.try_into().unwrap();
        if edited {
            let update = WebhookUpdate {
                url: Some("https://example.com/elsewhere".into()),
                ..WebhookUpdate::default()
            };
            let done = store
                .update_webhook(id(number), Some(1), update, by(), at(5))
                .await;
            assert_eq!(done.unwrap(), Edited::Done);
        }
        let gone = attempt(&next, AttemptEnd::Answer(410), AttemptVerdict::Gone);
        store.record_attempt(gone).await.unwrap();
        assert_eq!(only(store, number).await.status, DeliveryStatus::Failed);
        let webhook = store.webhook(id(number)).await.unwrap().unwrap();
        assert_eq!(webhook.active, edited);
        assert_eq!(webhook.gone_at, (!edited).then_some(at(10)));
        assert_eq!(webhook.revision, 2);
    }
}

#[tokio::test]
async fn a_webhook_that_is_not_active_is_sent_nothing_until_it_is_again() {
    let fixture = Fixture::new().await;
    let store = &fixture.store;
    register(store, 1).await;
    queue(store, 1, at(0)).await;
    let set = |active| WebhookUpdate {
        active: Some(active),
        ..WebhookUpdate::default()
    };
    store
        .update_webhook(id(1), None, set(false), by(), at(1))
        .await
        .unwrap();
    assert_eq!(next(store).await, []);
    let refused = store.queue_webhook_test(id(1), at(2)).await.unwrap();
    assert_eq!(refused, TestQueued::Disabled);
    store
        .update_webhook(id(1), None, set(true), by(), at(3))
        .await
        .unwrap();
    assert_eq!(next(store).await.len(), 1);
}

#[tokio::test]
async fn edits_are_fenced_and_tell_what_is_not_there() {
    let fixture = Fixture::new().await;
    let store = &fixture.store;
    register(store, 1).await;
    let edit = |number, revision| {
        let update = WebhookUpdate::default();
        store.update_webhook(id(number), revision, update, by(), at(1))
    };
    assert_eq!(edit(1, Some(2)).await.unwrap(), Edited::Stale);
    assert_eq!(edit(1, Some(1)).await.unwrap(), Edited::Done);
    assert_eq!(edit(2, None).await.unwrap(), Edited::Unknown);
    assert_eq!(
        store
            .delete_webhook(id(1), Some(1), by(), at(2))
            .await
            .unwrap(),
        Edited::Stale
    );
    assert_eq!(
        store
            .delete_webhook(id(1), Some(2), by(), at(2))
            .await
            .unwrap(),
        Edited::Done
    );
    assert_eq!(
        store
            .delete_webhook(id(1), None, by(), at(2))
            .await
            .unwrap(),
        Edited::Unknown
    );
    assert_eq!(
        store.queue_webhook_test(id(1), at(2)).await.unwrap(),
        TestQueued::Unknown
    );
}

#[tokio::test]
async fn old_deliveries_are_deleted_whatever_became_of_them() {
    let fixture = Fixture::new().await;
    let store = &fixture.store;
    for (number, second) in [(1, 100), (2, 200), (3, 300)] {
        register(store, number).await;
        queue(store, number, at(second)).await;
    }
    let first = &next(store).await[0];
    let taken = attempt(first, AttemptEnd::Answer(200), AttemptVerdict::Delivered);
    store.record_attempt(taken).await.unwrap();
    assert_eq!(store.delete_deliveries(at(100)).await.unwrap(), 0);
    assert_eq!(store.delete_deliveries(at(300)).await.unwrap(), 2);
    assert_eq!(store.delete_deliveries(at(300)).await.unwrap(), 0);
    assert_eq!(next(store).await.len(), 1);
    assert_eq!(store.webhooks(None, 10).await.unwrap().len(), 3);
}

#[tokio::test]
async fn of_what_was_delivered_the_newest_are_kept_and_of_failures_all() {
    let fixture = Fixture::new().await;
    let store = &fixture.store;
    register(store, 1).await;
    register(store, 2).await;
    // The oldest has failed, all others were delivered.
    let insert = "WITH RECURSIVE numbers(k) AS (SELECT 0 UNION ALL SELECT k + 1 FROM numbers \
         WHERE k < 1700) \
         INSERT INTO webhook_deliveries (webhook_key, id, event, at_us, status, attempts, \
         attempted_at_us) SELECT 1, 'msg_' || k, 'webhook.test', 1800000000000000, \
         iif(k = 0, 'failed', 'delivered'), 1, 0 FROM numbers";
    let mut raw = fixture.raw().await;
    sqlx::query(insert).execute(&mut raw).await.unwrap();
    queue(store, 2, at(0)).await;
    let deleted = [
        store.delete_deliveries(at(0)).await.unwrap(),
        store.delete_deliveries(at(0)).await.unwrap(),
        store.delete_deliveries(at(0)).await.unwrap(),
    ];
    assert_eq!(deleted, [500, 200, 0]);
    let left = store.deliveries(id(1), None, 2_000).await.unwrap();
    assert_eq!(left.len(), 1_001);
    assert_eq!(left[1_000].id, "msg_0");
    assert_eq!(left[999].id, "msg_701");
    assert_eq!(next(store).await.len(), 1);
}

#[tokio::test]
async fn a_webhook_of_a_route_that_is_not_there_is_not_registered() {
    let fixture = Fixture::new().await;
    let store = &fixture.store;
    let of = |number, name: &str| NewWebhook {
        id: id(number),
        url: "https://example.com/".into(),
        secret: WebhookSecret([0; 32]),
        events: WebhookTopic::ALL.to_vec(),
        route_id: Some(mapshift::ids::RouteId::new(name).unwrap()),
        description: Some("of a route".into()),
        include_tentative: true,
        created_at: at(0),
    };
    let unknown = store
        .register_webhook(of(1, "nowhere"), by())
        .await
        .unwrap();
    assert_eq!(unknown, Registered::UnknownRoute);
    assert_eq!(store.webhook(id(1)).await.unwrap(), None);
    let known = store.register_webhook(of(2, "r"), by()).await.unwrap();
    assert_eq!(known, Registered::Created);
    let webhook = store.webhook(id(2)).await.unwrap().unwrap();
    assert_eq!(webhook.route_id, Some(route()));
    assert!(webhook.include_tentative);
    assert_eq!(webhook.events, WebhookTopic::ALL);
    assert_eq!(
        store
            .delete_route(&route(), None, by(), at(1))
            .await
            .unwrap(),
        mapshift::store::Deleted::Done
    );
    assert_eq!(store.webhooks(None, 10).await.unwrap(), []);
}
