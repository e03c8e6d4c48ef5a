//! What receivers of webhooks are sent.

use std::time::Duration;

use mapshift::webhooks::DeliveryOptions;
use serde_json::{Value, json};

use crate::changed_hall::APPEARED;
use crate::client::Request;
use crate::hooked::{
    HOUR, ended, happen, make_due, options, registered, secret, start, start_in, tried,
};
use crate::receiver::Receiver;
use crate::webhooks::{deliveries, path, register};

#[tokio::test]
async fn a_receiver_is_sent_the_signed_alert_in_the_form_of_reads() {
    let service = start(HOUR).await;
    let mut receiver = Receiver::start().await;
    let webhook = registered(&service, &receiver).await;
    let alert = happen(&service).await;
    let call = receiver.call().await;
    assert_eq!(call.path, "/hook");
    let event = call.verified(secret(&webhook));
    let document = service.get("/openapi.json").await.json();
    let documented = &document["components"]["schemas"]["WebhookMessage"]["properties"];
    let keys = |value: &Value| {
        value
            .as_object()
            .unwrap()
            .keys()
            .cloned()
            .collect::<Vec<_>>()
    };
    assert_eq!(keys(&event), keys(documented));
    assert_eq!(event["type"], "alert.updated");
    assert_eq!(event["timestamp"], alert["updated_at"]);
    assert_eq!(event["data"], alert);
    assert_eq!(event["data"]["status"], "acknowledged");
    // Not only the same values, the same text.
    let text = service.get(&format!("/v1/alerts/{APPEARED}")).await.text();
    assert!(call.body.contains(&text));

    let delivery = ended(&service, &webhook).await;
    assert_eq!(delivery["status"], "delivered");
    assert_eq!(delivery["id"], call.header("webhook-id"));
    // The third event: two alerts were raised before anybody listened.
    assert_eq!(
        (&delivery["event_id"], &delivery["type"]),
        (&json!(3), &json!("alert.updated"))
    );
    assert_eq!(
        (&delivery["alert_id"], &delivery["attempts"]),
        (&json!(APPEARED), &json!(1))
    );
    assert_eq!(delivery["last_status_code"], 204);
    assert_eq!(delivery["last_failure"], Value::Null);
    assert_eq!(delivery["next_attempt_at"], Value::Null);
    service.stop().await;
}

#[tokio::test]
async fn events_arrive_in_order() {
    let service = start(HOUR).await;
    let mut receiver = Receiver::start().await;
    let webhook = registered(&service, &receiver).await;
    let mut ids = Vec::new();
    for _ in 0..5 {
        happen(&service).await;
        let call = receiver.call().await;
        call.verified(secret(&webhook));
        ids.push(json!(call.header("webhook-id")));
    }
    ended(&service, &webhook).await;
    let listed = deliveries(&service, &webhook).await;
    let answered: Vec<Value> = listed.iter().rev().map(|one| one["id"].clone()).collect();
    assert_eq!(answered, ids);
    let sequences: Vec<i64> = listed
        .iter()
        .map(|one| one["event_id"].as_i64().unwrap())
        .collect();
    assert_eq!(sequences, [7, 6, 5, 4, 3], "the newest first");
    let page = service
        .get(&format!("{}/deliveries?limit=2", path(&webhook)))
        .await
        .json();
    assert_eq!(page["items"], json!(listed[..2]));
    let next = format!(
        "{}/deliveries?limit=5&cursor={}",
        path(&webhook),
        page["next_cursor"].as_str().unwrap()
    );
    assert_eq!(service.get(&next).await.json()["items"], json!(listed[2..]));
    service.stop().await;
}

#[tokio::test]
async fn updates_that_an_earlier_call_contained_are_not_sent() {
    let service = start(HOUR).await;
    let mut receiver = Receiver::start().await;
    receiver.then_nothing();
    let webhook = registered(&service, &receiver).await;
    happen(&service).await;
    receiver.call().await;
    let mut alert = Value::Null;
    for _ in 0..9 {
        alert = happen(&service).await;
    }
    assert_eq!(deliveries(&service, &webhook).await.len(), 10);
    let directory = service.stop_keeping().await;
    let service = start_in(directory, options(HOUR)).await;
    let event = receiver.call().await.verified(secret(&webhook));
    assert_eq!(event["data"], alert);
    let delivery = ended(&service, &webhook).await;
    assert_eq!(delivery["status"], "delivered");
    assert_eq!(deliveries(&service, &webhook).await, [delivery]);
    happen(&service).await;
    let event = receiver.call().await.verified(secret(&webhook));
    assert_eq!(event["data"]["revision"], 12);
    assert!(!receiver.has_call());
    service.stop().await;
}

/// Each event is tried as it comes; what is tried again is the newest, and tells all of them.
#[tokio::test]
async fn a_receiver_that_was_down_gets_each_alert_once() {
    let service = start(HOUR).await;
    let mut receiver = Receiver::start().await;
    receiver.then(500).then(500).then(500);
    let webhook = registered(&service, &receiver).await;
    let mut ids = Vec::new();
    let mut alert = Value::Null;
    for _ in 0..3 {
        alert = happen(&service).await;
        let call = receiver.call().await;
        assert_eq!(tried(&service, &webhook).await["attempts"], 1);
        let waiting = deliveries(&service, &webhook).await;
        assert_eq!(waiting.len(), 1);
        assert_eq!(waiting[0]["id"], call.header("webhook-id"));
        ids.push(waiting[0]["id"].clone());
    }
    assert!(ids[0] != ids[1] && ids[1] != ids[2]);
    let directory = service.stop_keeping().await;
    make_due(&directory).await;
    let service = start_in(directory, options(HOUR)).await;
    let call = receiver.call().await;
    assert_eq!(ids[2], call.header("webhook-id"));
    assert_eq!(call.verified(secret(&webhook))["data"], alert);
    assert_eq!(ended(&service, &webhook).await["attempts"], 2);
    assert!(!receiver.has_call());
    service.stop().await;
}

#[tokio::test]
async fn a_late_attempt_sends_the_present_state() {
    let service = start(HOUR).await;
    let mut receiver = Receiver::start().await;
    receiver.then(500);
    let webhook = registered(&service, &receiver).await;
    happen(&service).await;
    receiver.call().await;
    tried(&service, &webhook).await;
    let directory = service.stop_keeping().await;
    make_due(&directory).await;
    // Reopened before the second attempt.
    let service = start_in(directory, DeliveryOptions::default()).await;
    let alert = happen(&service).await;
    let directory = service.stop_keeping().await;
    make_due(&directory).await;
    let service = start_in(directory, options(HOUR)).await;
    let event = receiver.call().await.verified(secret(&webhook));
    assert_eq!(event["data"], alert);
    service.stop().await;
}

#[tokio::test]
async fn a_webhook_gets_only_events_of_its_route_and_its_topics() {
    let service = start(HOUR).await;
    let mut receivers = [
        Receiver::start().await,
        Receiver::start().await,
        Receiver::start().await,
    ];
    let bodies = [
        json!({"route_id": "hall"}),
        json!({"route_id": "yard"}),
        json!({"events": ["alert.raised"]}),
    ];
    let mut webhooks = Vec::new();
    for (receiver, mut body) in receivers.iter().zip(bodies) {
        body["url"] = json!(receiver.url);
        webhooks.push(register(&service, body).await);
    }
    happen(&service).await;
    receivers[0].call().await;
    assert_eq!(
        deliveries(&service, &webhooks[1]).await,
        Vec::<Value>::new()
    );
    assert_eq!(
        deliveries(&service, &webhooks[2]).await,
        Vec::<Value>::new()
    );
    service.stop().await;
}

#[tokio::test]
async fn a_test_is_signed_and_tried_once() {
    let service = start(Duration::from_millis(1)).await;
    let mut receiver = Receiver::start().await;
    let body = json!({"url": receiver.url, "events": ["alert.raised"], "route_id": "yard"});
    let webhook = register(&service, body).await;
    let test = Request::new("POST", format!("{}/test", path(&webhook)));
    for (answer, status) in [(204, "delivered"), (500, "failed")] {
        receiver.then(answer);
        let queued = service.send(test.clone()).await;
        assert_eq!(queued.status, 202);
        let queued = queued.json();
        assert_eq!(
            (&queued["status"], &queued["attempts"]),
            (&json!("pending"), &json!(0))
        );
        let call = receiver.call().await;
        assert_eq!(queued["id"], call.header("webhook-id"));
        let event = call.verified(secret(&webhook));
        assert_eq!(event["type"], "webhook.test");
        assert_eq!(event["data"]["webhook_id"], webhook["id"]);
        let delivery = ended(&service, &webhook).await;
        assert_eq!(
            (&delivery["id"], &delivery["status"]),
            (&queued["id"], &json!(status))
        );
        assert_eq!(
            (&delivery["event_id"], &delivery["alert_id"]),
            (&Value::Null, &Value::Null)
        );
    }
    assert!(!receiver.has_call());
    service.stop().await;
}

#[tokio::test]
async fn a_receiver_that_does_not_answer_delays_no_other() {
    let service = start(HOUR).await;
    let (mut hanging, mut quick) = (Receiver::start().await, Receiver::start().await);
    hanging.then_nothing();
    let webhook = registered(&service, &hanging).await;
    registered(&service, &quick).await;
    happen(&service).await;
    hanging.call().await;
    quick.call().await;
    for _ in 0..3 {
        happen(&service).await;
        quick.call().await;
    }
    assert!(!hanging.has_call(), "two calls at once");
    assert_eq!(deliveries(&service, &webhook).await[3]["attempts"], 0);
    service.stop().await;
}
