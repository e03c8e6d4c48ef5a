//! What becomes of events that receivers of webhooks do not take.

use std::time::Duration;

use jiff::Timestamp;
use mapshift::webhooks::DeliveryOptions;
use serde_json::{Value, json};

use crate::client::Request;
use crate::hooked::{
    HOUR, ended, happen, make_due, options, registered, secret, start, start_in, tried,
};
use crate::receiver::{CANARY, Receiver};
use crate::webhooks::{change, deliveries, path};

#[tokio::test]
async fn a_failed_call_is_repeated_until_it_is_accepted() {
    let service = start(Duration::from_millis(20)).await;
    let mut receiver = Receiver::start().await;
    receiver.then(500).then(404);
    let webhook = registered(&service, &receiver).await;
    happen(&service).await;
    let calls = [
        receiver.call().await,
        receiver.call().await,
        receiver.call().await,
    ];
    let delivery = ended(&service, &webhook).await;
    assert_eq!(delivery["status"], "delivered");
    assert_eq!(delivery["attempts"], 3);
    for call in &calls {
        call.verified(secret(&webhook));
        assert_eq!(delivery["id"], call.header("webhook-id"));
        assert_eq!(call.body, calls[0].body);
    }
    assert!(!receiver.has_call());
    service.stop().await;
}

#[tokio::test]
async fn after_the_last_attempt_the_next_event_is_sent() {
    let service = start(Duration::from_millis(1)).await;
    let mut receiver = Receiver::start().await;
    receiver.then(500).then(500).then(302).then(503);
    let webhook = registered(&service, &receiver).await;
    happen(&service).await;
    let delivery = ended(&service, &webhook).await;
    assert_eq!(
        (&delivery["status"], &delivery["attempts"]),
        (&json!("failed"), &json!(4))
    );
    assert_eq!(delivery["last_status_code"], 503);
    for _ in 0..4 {
        receiver.call().await;
    }
    happen(&service).await;
    receiver.call().await;
    assert_eq!(ended(&service, &webhook).await["status"], "delivered");
    assert_eq!(deliveries(&service, &webhook).await.len(), 2);
    service.stop().await;
}

#[tokio::test]
async fn a_restart_between_two_attempts_loses_nothing() {
    let service = start(HOUR).await;
    let mut receiver = Receiver::start().await;
    receiver.then(500);
    let webhook = registered(&service, &receiver).await;
    happen(&service).await;
    let first = receiver.call().await;
    let delivery = tried(&service, &webhook).await;
    assert_eq!(
        (&delivery["status"], &delivery["attempts"]),
        (&json!("pending"), &json!(1))
    );
    assert_eq!(delivery["last_status_code"], 500);
    let directory = service.stop_keeping().await;
    make_due(&directory).await;
    let service = start_in(directory, options(HOUR)).await;
    let second = receiver.call().await;
    assert_eq!(first.header("webhook-id"), second.header("webhook-id"));
    second.verified(secret(&webhook));
    let delivery = ended(&service, &webhook).await;
    assert_eq!(
        (&delivery["status"], &delivery["attempts"]),
        (&json!("delivered"), &json!(2))
    );
    service.stop().await;
    assert!(!receiver.has_call());
}

#[tokio::test]
async fn a_call_under_way_at_the_stop_is_repeated() {
    let service = start(HOUR).await;
    let mut receiver = Receiver::start().await;
    receiver.then_nothing();
    let webhook = registered(&service, &receiver).await;
    happen(&service).await;
    let first = receiver.call().await;
    let directory = service.stop_keeping().await;
    let service = start_in(directory, options(HOUR)).await;
    let second = receiver.call().await;
    assert_eq!(first.header("webhook-id"), second.header("webhook-id"));
    let delivery = ended(&service, &webhook).await;
    assert_eq!(delivery["attempts"], 1, "the first was never noted");
    service.stop().await;
}

#[tokio::test]
async fn a_deleted_webhook_is_no_longer_called() {
    let service = start(Duration::from_millis(300)).await;
    let (mut deleted, mut witness) = (Receiver::start().await, Receiver::start().await);
    deleted.then(500).then(500);
    let webhook = registered(&service, &deleted).await;
    registered(&service, &witness).await;
    happen(&service).await;
    witness.call().await;
    deleted.call().await;
    let delete = Request::new("DELETE", path(&webhook));
    assert_eq!(service.send(delete).await.status, 204);
    // Whatever the deletion met on its way has come by the time the witness has seen more.
    for _ in 0..3 {
        happen(&service).await;
        witness.call().await;
    }
    let mut late = 0;
    while deleted.has_call() {
        deleted.call().await;
        late += 1;
    }
    assert!(
        late <= 1,
        "{late} calls, of which one can have been under way"
    );
    service.stop().await;
}

#[tokio::test]
async fn redirects_are_not_followed_and_answers_are_not_shown() {
    let service = start(HOUR).await;
    let (mut receiver, elsewhere) = (Receiver::start().await, Receiver::start().await);
    receiver.then_with(307, vec![("location", elsewhere.url.clone())]);
    let webhook = registered(&service, &receiver).await;
    happen(&service).await;
    receiver.call().await;
    let delivery = tried(&service, &webhook).await;
    assert_eq!(
        (&delivery["status"], &delivery["last_status_code"]),
        (&json!("pending"), &json!(307))
    );
    assert!(!elsewhere.has_call());
    for path in [
        path(&webhook),
        format!("{}/deliveries", path(&webhook)),
        "/v1/webhooks".to_owned(),
        "/metrics".to_owned(),
    ] {
        let answered = service.get(&path).await;
        let everything = format!("{:?} {}", answered.headers, answered.text());
        assert!(!everything.contains(CANARY), "{everything}");
        assert!(!everything.contains(&elsewhere.url), "{everything}");
    }
    let directory = service.stop_keeping().await;
    for file in std::fs::read_dir(directory.path().join("data")).unwrap() {
        let bytes = std::fs::read(file.unwrap().path()).unwrap();
        let kept = bytes
            .windows(CANARY.len())
            .any(|window| window == CANARY.as_bytes());
        assert!(!kept, "an answer was kept");
    }
}

#[tokio::test]
async fn a_receiver_that_answers_gone_is_disabled() {
    let service = start(Duration::from_millis(1)).await;
    let mut receiver = Receiver::start().await;
    receiver.then(410);
    let webhook = registered(&service, &receiver).await;
    happen(&service).await;
    receiver.call().await;
    let delivery = ended(&service, &webhook).await;
    assert_eq!(
        (&delivery["status"], &delivery["attempts"]),
        (&json!("failed"), &json!(1))
    );
    let gone = service.get(&path(&webhook)).await.json();
    assert_eq!(gone["active"], false);
    assert_eq!(gone["gone_at"], delivery["last_attempt_at"]);
    happen(&service).await;
    assert_eq!(
        deliveries(&service, &webhook).await.len(),
        1,
        "not kept for later"
    );
    let test = service
        .send(Request::new("POST", format!("{}/test", path(&webhook))))
        .await;
    assert_eq!(
        (test.status, test.problem().as_str()),
        (409, "webhook-disabled")
    );

    let enabled = change(&service, &webhook, "\"2\"", json!({"active": true}))
        .await
        .json();
    assert_eq!(
        (&enabled["active"], &enabled["gone_at"]),
        (&json!(true), &Value::Null)
    );
    happen(&service).await;
    receiver.call().await;
    assert!(!receiver.has_call());
    service.stop().await;
}

#[tokio::test]
async fn retry_after_of_a_receiver_is_respected() {
    let service = start(Duration::from_millis(1)).await;
    let mut receiver = Receiver::start().await;
    receiver.then_with(503, vec![("retry-after", "3600".to_owned())]);
    let webhook = registered(&service, &receiver).await;
    happen(&service).await;
    receiver.call().await;
    let delivery = tried(&service, &webhook).await;
    let time = |field: &str| {
        delivery[field]
            .as_str()
            .unwrap()
            .parse::<Timestamp>()
            .unwrap()
    };
    let wait = time("last_attempt_at").duration_until(time("next_attempt_at"));
    assert!((3_600..4_000).contains(&wait.as_secs()), "{delivery}");
    service.stop().await;
}

#[tokio::test]
async fn stricter_settings_apply_to_registered_webhooks() {
    let service = start(HOUR).await;
    let receiver = Receiver::start().await;
    let webhook = registered(&service, &receiver).await;
    let directory = service.stop_keeping().await;
    let service = start_in(directory, DeliveryOptions::default()).await;
    happen(&service).await;
    let delivery = tried(&service, &webhook).await;
    assert_eq!(delivery["last_failure"], "url_refused");
    assert_eq!(delivery["last_status_code"], Value::Null);
    assert!(!receiver.has_call());
    service.stop().await;
}
