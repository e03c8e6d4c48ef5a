//! Webhooks as their keepers see them.

use serde_json::{Value, json};

use crate::client::{Answer, Request};
use crate::service::Service;

pub const WEBHOOKS: &str = "/v1/webhooks";

pub fn path(webhook: &Value) -> String {
    format!("{WEBHOOKS}/{}", webhook["id"].as_str().unwrap())
}

pub async fn register(service: &Service, body: Value) -> Value {
    let answer = service
        .send(Request::new("POST", WEBHOOKS).json(&body))
        .await;
    assert_eq!(answer.status, 201, "{}", answer.text());
    answer.json()
}

pub async fn change(service: &Service, webhook: &Value, tag: &str, body: Value) -> Answer {
    let request = Request::new("PATCH", path(webhook)).header("if-match", tag);
    service.send(request.json(&body)).await
}

pub async fn deliveries(service: &Service, webhook: &Value) -> Vec<Value> {
    let page = service.get(&format!("{}/deliveries", path(webhook))).await;
    page.json()["items"].as_array().unwrap().clone()
}

/// The webhook as every answer but the first shows it.
fn without_secret(webhook: &Value) -> Value {
    let mut shown = webhook.clone();
    shown["secret"] = Value::Null;
    shown
}

#[tokio::test]
async fn a_webhook_is_registered_changed_and_deleted() {
    let service = Service::start().await;
    service.put_route("hall").await;
    let body = json!({
        "url": "https://Hooks.Example.com:443/alerts?team=7", "route_id": "hall",
        "events": ["alert.updated", "alert.raised", "alert.updated"], "description": "tickets"
    });
    let answer = service
        .send(Request::new("POST", WEBHOOKS).json(&body))
        .await;
    assert_eq!(answer.status, 201, "{}", answer.text());
    let webhook = answer.json();
    assert_eq!(answer.header("location"), Some(path(&webhook).as_str()));
    assert_eq!(answer.header("etag"), Some("\"1\""));
    assert_eq!(answer.header("cache-control"), Some("no-store"));
    let secret = webhook["secret"].as_str().unwrap();
    assert!(
        secret.starts_with("whsec_") && secret.len() == 50,
        "{secret}"
    );
    let mut answered = without_secret(&webhook);
    for varying in ["id", "created_at", "updated_at"] {
        assert!(answered[varying].take().is_string());
    }
    let expected = json!({
        "id": null, "url": "https://hooks.example.com/alerts?team=7",
        "events": ["alert.raised", "alert.updated"], "route_id": "hall",
        "description": "tickets", "include_tentative": false, "active": true, "gone_at": null,
        "secret": null, "previous_secret_until": null, "created_at": null, "updated_at": null
    });
    assert_eq!(answered, expected);

    let read = service.get(&path(&webhook)).await;
    assert_eq!(read.header("etag"), Some("\"1\""));
    assert_eq!(read.json(), without_secret(&webhook));
    let changed = change(&service, &webhook, "\"1\"", json!({"active": false})).await;
    assert_eq!(
        (changed.status, changed.header("etag")),
        (200, Some("\"2\""))
    );
    assert_eq!(changed.json()["active"], false);
    assert_eq!(changed.json()["events"], webhook["events"]);
    let late = change(&service, &webhook, "\"1\"", json!({"active": true})).await;
    assert_eq!(
        (late.status, late.problem().as_str()),
        (412, "precondition-failed")
    );
    let body =
        json!({"url": "https://example.com/", "events": ["alert.raised"], "description": ""});
    let changed = change(&service, &webhook, "*", body).await.json();
    assert_eq!(changed["url"], "https://example.com/");
    assert_eq!(changed["events"], json!(["alert.raised"]));
    assert_eq!(changed["description"], "");
    assert_eq!(changed["route_id"], "hall");
    assert_eq!(changed["include_tentative"], false);
    let body = json!({"include_tentative": true});
    let changed = change(&service, &webhook, "*", body).await.json();
    assert_eq!(changed["include_tentative"], true);
    assert_eq!(changed["description"], "");

    let stale = Request::new("DELETE", path(&webhook)).header("if-match", "\"2\"");
    assert_eq!(service.send(stale).await.status, 412);
    let delete = Request::new("DELETE", path(&webhook));
    assert_eq!(service.send(delete.clone()).await.status, 204);
    assert_eq!(service.send(delete).await.problem(), "not-found");
    assert_eq!(service.get(&path(&webhook)).await.status, 404);
    service.stop().await;
}

#[tokio::test]
async fn a_secret_is_shown_once() {
    let service = Service::start().await;
    let body = json!({"url": "https://example.com/"});
    let (one, other) = (
        register(&service, body.clone()).await,
        register(&service, body).await,
    );
    assert_eq!(one["include_tentative"], false);
    assert_ne!(one["secret"], other["secret"]);
    assert_ne!(one["id"], other["id"]);
    for path in [
        path(&one),
        WEBHOOKS.to_owned(),
        format!("{}/deliveries", path(&one)),
    ] {
        let answered = service.get(&path).await.text();
        assert!(!answered.contains("whsec_"), "{answered}");
    }
    let changed = change(&service, &one, "*", json!({"active": true})).await;
    assert_eq!(changed.json()["secret"], Value::Null);
    service.stop().await;
}

#[tokio::test]
async fn webhooks_are_listed_in_pages_and_limited() {
    let service = Service::start().await;
    let mut ids = Vec::new();
    for k in 0..100 {
        let body = json!({"url": format!("https://example.com/{k}")});
        ids.push(register(&service, body).await["id"].clone());
    }
    let one_more = json!({"url": "https://example.com/"});
    let refused = service
        .send(Request::new("POST", WEBHOOKS).json(&one_more))
        .await;
    assert_eq!(
        (refused.status, refused.problem().as_str()),
        (409, "too-many-webhooks")
    );
    let first = service.get(&format!("{WEBHOOKS}?limit=60")).await.json();
    let cursor = first["next_cursor"].as_str().unwrap();
    let second = service
        .get(&format!("{WEBHOOKS}?limit=60&cursor={cursor}"))
        .await
        .json();
    assert_eq!(second["next_cursor"], Value::Null);
    let listed = [first, second].map(|page| page["items"].as_array().unwrap().clone());
    let listed: Vec<Value> = listed
        .concat()
        .iter()
        .map(|item| item["id"].clone())
        .collect();
    assert_eq!(listed, ids);
    let delete = Request::new("DELETE", format!("{WEBHOOKS}/{}", ids[3].as_str().unwrap()));
    assert_eq!(service.send(delete).await.status, 204);
    register(&service, one_more).await;
    service.stop().await;
}

#[tokio::test]
async fn a_deleted_route_deletes_its_webhooks() {
    let service = Service::start().await;
    service.put_route("hall").await;
    let of_hall = register(
        &service,
        json!({"url": "https://example.com/", "route_id": "hall"}),
    )
    .await;
    let of_all = register(&service, json!({"url": "https://example.com/"})).await;
    let delete = Request::new("DELETE", "/v1/routes/hall");
    assert_eq!(service.send(delete).await.status, 204);
    assert_eq!(service.get(&path(&of_hall)).await.status, 404);
    assert_eq!(service.get(&path(&of_all)).await.status, 200);
    service.stop().await;
}
