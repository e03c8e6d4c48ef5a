//! What webhooks are sent beside alerts, with links to the page, and signed while a secret is replaced.

use serde_json::{Value, json};

use crate::body;
use crate::changed_hall::{self, APPEARED};
use crate::client::{Answer, Request};
use crate::hooked::{HOUR, ended, happen, options, secret};
use crate::receiver::{Call, Receiver};
use crate::service::Service;
use crate::webhooks::{deliveries, path, register};

const VEHICLE: &str = "/v1/routes/hall/vehicles/agv-07";

/// A changed hall that people reach by a name of its own.
async fn start() -> Service {
    let directory = changed_hall::directory().await;
    let url = "https://maps.example.com".parse().unwrap();
    Service::start_changed(directory, |config| {
        config.access.public_url = Some(url);
        config.delivery = options(HOUR);
    })
    .await
}

/// The next event, which must be as its schema in the document has it.
async fn event(service: &Service, receiver: &mut Receiver, webhook: &Value, schema: &str) -> Value {
    let event = receiver.call().await.verified(secret(webhook));
    let document = service.get("/openapi.json").await.json();
    let schemas = &document["components"]["schemas"];
    let properties = &schemas[schema]["properties"];
    let kinds = properties["type"]["enum"].as_array().unwrap();
    assert!(kinds.contains(&event["type"]), "{event}");
    let data = properties["data"]["$ref"].as_str().unwrap();
    let data = &schemas[data.rsplit_once('/').unwrap().1]["properties"];
    for (value, documented) in [(&event, properties), (&event["data"], data)] {
        let keys =
            |value: &Value| -> Vec<String> { value.as_object().unwrap().keys().cloned().collect() };
        assert_eq!(keys(value), keys(documented), "{schema}");
    }
    event
}

#[tokio::test]
async fn events_of_batches_vehicles_and_operations_have_the_form_of_reads() {
    let service = start().await;
    let mut receiver = Receiver::start().await;
    let events = ["batch.quarantined", "vehicle.suspect", "operation.finished"];
    let body = json!({"url": receiver.url, "events": events, "route_id": "hall"});
    let webhook = register(&service, body).await;
    assert_eq!(webhook["events"], json!(events));

    // The trip has a batch of this sequence already.
    let batch = "/v1/routes/hall/batches/b-again";
    let put = Request::new("PUT", batch).json(&body::batch(0, 4));
    assert_eq!(service.send(put).await.status, 202);
    let sent = event(&service, &mut receiver, &webhook, "BatchMessage").await;
    assert_eq!(sent["type"], "batch.quarantined");
    assert_eq!(sent["data"], service.get(batch).await.json());
    assert_eq!(sent["data"]["status"], "quarantined");
    let link = "https://maps.example.com/#/routes/hall/batches";
    assert_eq!(sent["url"], link);

    let quarantine = Request::new("POST", format!("{VEHICLE}/quarantine"));
    assert_eq!(service.send(quarantine).await.status, 200);
    let sent = event(&service, &mut receiver, &webhook, "VehicleMessage").await;
    assert_eq!(sent["data"], service.get(VEHICLE).await.json());
    assert_eq!(sent["data"]["state"], "quarantined");
    assert_eq!(sent["data"]["route_id"], "hall");
    let link = "https://maps.example.com/#/routes/hall/vehicles";
    assert_eq!(sent["url"], link);

    let removal = json!({"batches": ["b-again"], "dry_run": true});
    let removal = Request::new("POST", "/v1/routes/hall/removals").json(&removal);
    let asked = service.send(removal).await;
    assert_eq!(asked.status, 202, "{}", asked.text());
    let sent = event(&service, &mut receiver, &webhook, "OperationMessage").await;
    let operation = asked.header("location").unwrap();
    assert_eq!(sent["data"], service.get(operation).await.json());
    assert_eq!(sent["data"]["status"], "succeeded");
    assert_eq!(sent["url"], Value::Null);

    ended(&service, &webhook).await;
    let listed = deliveries(&service, &webhook).await;
    let subjects = listed.iter().rev().map(|one| {
        assert_eq!(
            (&one["alert_id"], &one["event_id"]),
            (&Value::Null, &Value::Null)
        );
        let id = |field: &str| one[field].as_str().unwrap_or_default().to_owned();
        id("batch_id") + &id("vehicle_id") + &id("operation_id")
    });
    let of_operation = sent["data"]["id"].as_str().unwrap();
    assert_eq!(
        subjects.collect::<Vec<_>>(),
        ["b-again", "agv-07", of_operation]
    );
    service.stop().await;
}

#[tokio::test]
async fn an_alert_is_sent_with_its_console_address_and_not_for_comments() {
    let service = start().await;
    let mut receiver = Receiver::start().await;
    let webhook = register(&service, json!({"url": receiver.url})).await;
    let post = |what: &str, body: Value| {
        Request::new("POST", format!("/v1/alerts/{APPEARED}/{what}")).json(&body)
    };
    let comment = post("comments", json!({"text": "seen", "by": "kim"}));
    assert_eq!(service.send(comment).await.status, 201);
    let assignee = Request::new("PUT", format!("/v1/alerts/{APPEARED}/assignee"));
    let assignee = assignee.json(&json!({"assignee": "kim"}));
    assert_eq!(service.send(assignee).await.status, 200);
    assert_eq!(deliveries(&service, &webhook).await, Vec::<Value>::new());
    happen(&service).await;
    let sent = event(&service, &mut receiver, &webhook, "WebhookMessage").await;
    let link = format!("https://maps.example.com/#/alerts/{APPEARED}");
    assert_eq!(sent["url"], link);
    assert_eq!(sent["data"]["assignee"], "kim", "it is sent as it is");
    assert_eq!(deliveries(&service, &webhook).await.len(), 1);
    service.stop().await;
}

async fn rotate(service: &Service, webhook: &Value, tag: &'static str, body: Value) -> Answer {
    let request = Request::new("POST", format!("{}/rotate-secret", path(webhook)));
    service
        .send(request.header("if-match", tag).json(&body))
        .await
}

/// The number of signatures of a call.
fn signatures(call: &Call) -> usize {
    call.header("webhook-signature").split(' ').count()
}

#[tokio::test]
async fn calls_are_signed_with_both_secrets_during_the_overlap() {
    let service = start().await;
    let mut receiver = Receiver::start().await;
    let webhook = register(&service, json!({"url": receiver.url})).await;
    let rotated = rotate(&service, &webhook, "\"1\"", json!({"overlap_hours": 168})).await;
    assert_eq!(rotated.status, 200, "{}", rotated.text());
    assert_eq!(rotated.header("etag"), Some("\"2\""));
    assert_eq!(rotated.header("cache-control"), Some("no-store"));
    let new = rotated.json();
    assert_ne!(secret(&new), secret(&webhook));
    assert!(new["previous_secret_until"].is_string(), "{new}");
    happen(&service).await;
    let call = receiver.call().await;
    assert_eq!(signatures(&call), 2);
    call.verified(secret(&webhook));
    call.verified(secret(&new));

    let late = rotate(&service, &webhook, "\"1\"", json!({})).await;
    assert_eq!(
        (late.status, late.problem().as_str()),
        (412, "precondition-failed")
    );
    let long = rotate(&service, &webhook, "*", json!({"overlap_hours": 169})).await;
    assert_eq!(
        (long.status, long.problem().as_str()),
        (422, "out-of-range")
    );
    assert_eq!(long.json()["errors"][0]["pointer"], "/overlap_hours");
    for faulty in [json!({"overlap_hours": -1}), json!({"hours": 1})] {
        assert_eq!(rotate(&service, &webhook, "*", faulty).await.status, 400);
    }

    let newest = rotate(&service, &webhook, "*", json!({"overlap_hours": 0}))
        .await
        .json();
    assert_eq!(newest["previous_secret_until"], Value::Null);
    happen(&service).await;
    let call = receiver.call().await;
    assert_eq!(signatures(&call), 1);
    call.verified(secret(&newest));
    let read = service.get(&path(&webhook)).await.text();
    assert!(!read.contains("whsec_"), "{read}");

    let audit = service.get("/v1/audit?action=webhook.secret_rotated").await;
    let rows = audit.json()["items"].as_array().unwrap().clone();
    assert_eq!(rows.len(), 2);
    let overlap = |until: &Value| json!({"previous_secret_until": until});
    assert_eq!(rows[1]["after"], overlap(&new["previous_secret_until"]));
    assert_eq!(rows[0]["after"], overlap(&Value::Null));
    assert!(!audit.text().contains("whsec_"));
    service.stop().await;
}
