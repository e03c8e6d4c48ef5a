//! What receivers of webhooks get, and what becomes of events that they do not take.

use std::time::Duration;

use jiff::Timestamp;
use mapshift::api::Limits;
use mapshift::delivery::{DeliveryOptions, ReceiverPolicy};
use serde_json::{Value, json};
use sqlx::{Connection, SqliteConnection};
use tempfile::TempDir;

use crate::changed_hall::{self, APPEARED};
use crate::client::Request;
use crate::receiver::{CANARY, Receiver};
use crate::service::Service;
use crate::webhooks::{change, deliveries, path, register};

const HOUR: Duration = Duration::from_hours(1);
/// What is waited for longer than this is missing.
const PATIENCE: Duration = Duration::from_secs(60);

/// To receivers on this machine, with the same pause after each of some failures.
fn options(pause: Duration) -> DeliveryOptions {
    DeliveryOptions {
        policy: ReceiverPolicy::PrivateToo,
        pauses: vec![pause; 3],
        ..DeliveryOptions::default()
    }
}

async fn start(pause: Duration) -> Service {
    start_in(changed_hall::directory().await, options(pause)).await
}

async fn start_in(directory: TempDir, options: DeliveryOptions) -> Service {
    Service::start_delivering(directory, Limits::default(), options).await
}

async fn told(service: &Service, receiver: &Receiver) -> Value {
    register(service, json!({"url": receiver.url})).await
}

fn secret(webhook: &Value) -> &str {
    webhook["secret"].as_str().unwrap()
}

/// Makes something happen to the alert: the next of acknowledging and reopening.
async fn happen(service: &Service) -> Value {
    let alert = format!("/v1/alerts/{APPEARED}");
    let action = match service.get(&alert).await.json()["status"].as_str() {
        Some("open") => "acknowledge",
        _ => "reopen",
    };
    let request = Request::new("POST", format!("{alert}/{action}")).header("if-match", "*");
    let answer = service.send(request).await;
    assert_eq!(answer.status, 200, "{}", answer.text());
    answer.json()
}

/// Waits until the newest delivery is as wanted.
async fn newest(service: &Service, webhook: &Value, is_wanted: impl Fn(&Value) -> bool) -> Value {
    let look = async {
        loop {
            let newest = deliveries(service, webhook).await.into_iter().next();
            match newest {
                Some(newest) if is_wanted(&newest) => return newest,
                _ => tokio::time::sleep(Duration::from_millis(20)).await,
            }
        }
    };
    let found = tokio::time::timeout(PATIENCE, look).await;
    found.expect("the delivery gets there")
}

async fn ended(service: &Service, webhook: &Value) -> Value {
    newest(service, webhook, |delivery| delivery["status"] != "pending").await
}

async fn tried(service: &Service, webhook: &Value) -> Value {
    newest(service, webhook, |delivery| delivery["attempts"] != 0).await
}

#[tokio::test]
async fn a_receiver_is_sent_the_alert_as_readers_see_it_signed() {
    let service = start(HOUR).await;
    let mut receiver = Receiver::start().await;
    let webhook = told(&service, &receiver).await;
    let alert = happen(&service).await;
    let call = receiver.call().await;
    assert_eq!(call.path, "/hook");
    let event = call.verified(secret(&webhook));
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
    let webhook = told(&service, &receiver).await;
    let mut ids = Vec::new();
    for _ in 0..5 {
        happen(&service).await;
        let call = receiver.call().await;
        call.verified(secret(&webhook));
        ids.push(json!(call.header("webhook-id")));
    }
    ended(&service, &webhook).await;
    let listed = deliveries(&service, &webhook).await;
    let told: Vec<Value> = listed.iter().rev().map(|one| one["id"].clone()).collect();
    assert_eq!(told, ids);
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
async fn what_fails_is_sent_again_until_it_is_taken() {
    let service = start(Duration::from_millis(20)).await;
    let mut receiver = Receiver::start().await;
    receiver.then(500).then(404);
    let webhook = told(&service, &receiver).await;
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

/// Ten events, and as few calls as tell the state after each of them.
#[tokio::test]
async fn updates_that_a_call_has_told_already_are_not_sent() {
    let service = start(HOUR).await;
    let mut receiver = Receiver::start().await;
    receiver.then(500);
    let webhook = told(&service, &receiver).await;
    happen(&service).await;
    receiver.call().await;
    tried(&service, &webhook).await;
    let directory = service.stop_keeping().await;
    // Nothing is sent meanwhile: these settings lead nowhere.
    let mut nowhere = options(HOUR);
    nowhere.policy = ReceiverPolicy::Public;
    let service = start_in(directory, nowhere).await;
    let mut alert = Value::Null;
    for _ in 0..9 {
        alert = happen(&service).await;
    }
    assert_eq!(deliveries(&service, &webhook).await.len(), 10);
    let directory = service.stop_keeping().await;
    make_due(&directory).await;
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

#[tokio::test]
async fn a_late_attempt_tells_the_present_state() {
    let service = start(HOUR).await;
    let mut receiver = Receiver::start().await;
    receiver.then(500);
    let webhook = told(&service, &receiver).await;
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
async fn after_the_last_attempt_it_has_failed_and_the_next_event_is_sent() {
    let service = start(Duration::from_millis(1)).await;
    let mut receiver = Receiver::start().await;
    receiver.then(500).then(500).then(302).then(503);
    let webhook = told(&service, &receiver).await;
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

/// Moves every attempt that waits to the beginning of time.
async fn make_due(directory: &TempDir) {
    let path = directory.path().join("data/mapshift.db");
    let mut database = SqliteConnection::connect(path.to_str().unwrap())
        .await
        .unwrap();
    let statement = "UPDATE webhook_deliveries SET next_attempt_at_us = 0 WHERE status = 'pending'";
    sqlx::query(statement).execute(&mut database).await.unwrap();
    database.close().await.unwrap();
}

#[tokio::test]
async fn a_restart_between_a_failure_and_its_repetition_loses_nothing() {
    let service = start(HOUR).await;
    let mut receiver = Receiver::start().await;
    receiver.then(500);
    let webhook = told(&service, &receiver).await;
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
async fn what_was_under_way_at_the_stop_is_sent_again() {
    let service = start(HOUR).await;
    let mut receiver = Receiver::start().await;
    receiver.then_nothing();
    let webhook = told(&service, &receiver).await;
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
async fn a_deleted_webhook_is_called_no_more() {
    let service = start(Duration::from_millis(300)).await;
    let (mut deleted, mut witness) = (Receiver::start().await, Receiver::start().await);
    deleted.then(500).then(500);
    let webhook = told(&service, &deleted).await;
    told(&service, &witness).await;
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
async fn a_redirect_is_not_followed_and_nothing_of_an_answer_is_told() {
    let service = start(HOUR).await;
    let (mut receiver, mut elsewhere) = (Receiver::start().await, Receiver::start().await);
    receiver.then_with(307, vec![("location", elsewhere.url.clone())]);
    let webhook = told(&service, &receiver).await;
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
        let told = service.get(&path).await;
        let everything = format!("{:?} {}", told.headers, told.text());
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
async fn who_says_gone_is_left_alone_until_somebody_enables_it() {
    let service = start(Duration::from_millis(1)).await;
    let mut receiver = Receiver::start().await;
    receiver.then(410);
    let webhook = told(&service, &receiver).await;
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
async fn a_webhook_is_told_of_its_route_and_its_events_alone() {
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
async fn a_receiver_that_does_not_answer_holds_up_nobody_else() {
    let service = start(HOUR).await;
    let (mut hanging, mut quick) = (Receiver::start().await, Receiver::start().await);
    hanging.then_nothing();
    let webhook = told(&service, &hanging).await;
    told(&service, &quick).await;
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

#[tokio::test]
async fn a_receiver_that_asks_for_time_gets_it() {
    let service = start(Duration::from_millis(1)).await;
    let mut receiver = Receiver::start().await;
    receiver.then_with(503, vec![("retry-after", "3600".to_owned())]);
    let webhook = told(&service, &receiver).await;
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
async fn what_settings_allowed_once_is_not_sent_under_stricter_ones() {
    let service = start(HOUR).await;
    let mut receiver = Receiver::start().await;
    let webhook = told(&service, &receiver).await;
    let directory = service.stop_keeping().await;
    let service = start_in(directory, DeliveryOptions::default()).await;
    happen(&service).await;
    let delivery = tried(&service, &webhook).await;
    assert_eq!(delivery["last_failure"], "url_refused");
    assert_eq!(delivery["last_status_code"], Value::Null);
    assert!(!receiver.has_call());
    service.stop().await;
}
