//! The audit as clients read it.

use serde_json::{Value, json};

use crate::bad_requests::{case, check};
use crate::changed_hall::{self, APPEARED};
use crate::client::{Connection, Request};
use crate::service::Service;
use crate::webhooks::{self, register};

const AUDIT: &str = "/v1/audit";

async fn put(service: &Service, route: &str, body: Value) {
    let request = Request::new("PUT", format!("/v1/routes/{route}")).json(&body);
    assert!([200, 201].contains(&service.send(request).await.status));
}

async fn delete(service: &Service, path: String) {
    let answer = service.send(Request::new("DELETE", path)).await;
    assert_eq!(answer.status, 204);
}

/// The items that a query selects, the newest first.
async fn items(service: &Service, query: &str) -> Vec<Value> {
    let page = service.get(&format!("{AUDIT}?{query}")).await.json();
    page["items"].as_array().unwrap().clone()
}

async fn actions(service: &Service, query: &str) -> Vec<String> {
    let items = items(service, query).await;
    let action = |item: &Value| item["action"].as_str().unwrap().to_owned();
    items.iter().map(action).collect()
}

/// Replaces what differs from run to run.
fn steady(mut page: Value) -> Value {
    for item in page["items"].as_array_mut().unwrap() {
        item["at"] = json!("[time]");
        if item["action"].as_str().unwrap().starts_with("webhook.") {
            item["subject"] = json!("[id]");
        }
    }
    page
}

#[tokio::test]
async fn the_audit_has_the_documented_form() {
    let service = changed_hall::start().await;
    put(&service, "yard", json!({"settings": {"hold_s": 5}})).await;
    put(&service, "yard", json!({"settings": {"hold_s": 5}})).await;
    let body = json!({"url": "https://example.com/hook?token=hush", "route_id": "yard"});
    let webhook = register(&service, body).await;
    let decision = json!({"by": "kim", "note": "a parked lorry"});
    let dismissal = Request::new("POST", format!("/v1/alerts/{APPEARED}/dismiss"));
    let dismissal = dismissal.header("if-match", "\"1\"").json(&decision);
    assert_eq!(service.send(dismissal.clone()).await.status, 200);
    assert_eq!(service.send(dismissal).await.status, 412);
    let batch = "/v1/routes/hall/batches/b-0/retry";
    let retry = Request::new("POST", batch);
    assert_eq!(service.send(retry).await.problem(), "retry-refused");
    delete(&service, webhooks::path(&webhook)).await;
    delete(&service, "/v1/routes/yard".to_owned()).await;
    let answer = service.get(AUDIT).await;
    assert_eq!(answer.status, 200);
    assert!(!answer.text().contains("hush"), "{}", answer.text());
    assert!(!answer.text().contains("whsec_"), "{}", answer.text());
    insta::assert_json_snapshot!("audit", steady(answer.json()));
    service.stop().await;
}

#[tokio::test]
async fn the_audit_is_read_in_pages_and_filtered() {
    let service = Service::start().await;
    for hold_s in 1..=4 {
        put(&service, "hall", json!({"settings": {"hold_s": hold_s}})).await;
    }
    service.put_route("yard").await;
    register(&service, json!({"url": "https://example.com/"})).await;
    delete(&service, "/v1/routes/yard".to_owned()).await;
    let all = [
        "route.deleted",
        "webhook.created",
        "route.created",
        "route.changed",
        "route.changed",
        "route.changed",
        "route.created",
    ];
    assert_eq!(actions(&service, "").await, all);

    let (mut read, mut cursor) = (Vec::new(), String::new());
    loop {
        let page = service.get(&format!("{AUDIT}?limit=3{cursor}")).await;
        let page = page.json();
        read.extend(page["items"].as_array().unwrap().clone());
        match page["next_cursor"].as_str() {
            Some(next) => cursor = format!("&cursor={next}"),
            None => break,
        }
    }
    assert_eq!(read, items(&service, "").await);

    // Also of a route that is gone.
    let of_yard = actions(&service, "route_id=yard").await;
    assert_eq!(of_yard, ["route.deleted", "route.created"]);
    assert_eq!(actions(&service, "route_id=nowhere").await.len(), 0);
    let changed = "action=route.changed&route_id=hall&limit=2";
    assert_eq!(actions(&service, changed).await.len(), 2);
    let made = read[2]["at"].as_str().unwrap();
    let since = actions(&service, &format!("since={made}")).await;
    assert_eq!(since, all[..3]);
    let until = actions(&service, &format!("until={made}")).await;
    assert_eq!(until, all[3..]);
    let never = format!("since={made}&until={made}");
    assert_eq!(actions(&service, &never).await.len(), 0);
    service.stop().await;
}

#[tokio::test]
async fn every_change_is_recorded_with_the_client_s_address() {
    let service = Service::start().await;
    service.put_route("here").await;
    let mut elsewhere = Connection::open_from_elsewhere(service.address).await;
    let there = Request::new("PUT", "/v1/routes/there").header("x-forwarded-for", "192.0.2.9");
    elsewhere.write(&there.head()).await;
    assert_eq!(elsewhere.answer().await.status, 201);
    let from: Vec<Value> = items(&service, "")
        .await
        .iter()
        .map(|item| json!([item["subject"], item["actor"], item["address"]]))
        .collect();
    assert_eq!(
        from,
        [
            json!(["there", "local", "127.0.0.2"]),
            json!(["here", "local", "127.0.0.1"])
        ]
    );
    service.stop().await;
}

#[tokio::test]
async fn bad_queries_of_the_audit_get_the_answers_of_the_contract() {
    let service = Service::start().await;
    let query = |name, query: &str, pointer| {
        let request = Request::new("GET", format!("{AUDIT}?{query}"));
        case(name, request, 400, "invalid-parameter", pointer)
    };
    let cases = [
        query("unknown action", "action=route.renamed", ""),
        query("since that is no time", "since=yesterday", "since"),
        query("until without a zone", "until=2026-11-20T06:00:00", "until"),
        query("route with a slash", "route_id=a%2Fb", "route_id"),
        query("limit 0", "limit=0", "limit"),
        query("limit above the largest", "limit=1001", "limit"),
        query("cursor of another list", "cursor=68616c6c", "cursor"),
        query("parameter that is not there", "actor=local", ""),
        query("the same parameter twice", "limit=1&limit=2", ""),
    ];
    check(&service, cases).await;
    let write = Request::new("DELETE", AUDIT);
    assert_eq!(service.send(write).await.status, 405);
    service.stop().await;
}
