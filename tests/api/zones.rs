//! Zones: what they mute, and what comes of it when they end.

use std::time::Duration;

use jiff::{SignedDuration, Timestamp};
use serde_json::{Value, json};

use crate::changed_hall::{self, APPEARED};
use crate::client::{Answer, Request};
use crate::service::Service;

const ZONES: &str = "/v1/routes/hall/zones";

/// Round the box that appeared.
fn zone() -> Value {
    json!({"polygon": [[1.0, 0.0], [3.0, 0.0], [3.0, 2.0], [1.0, 2.0]], "purpose": "mute", "note": "pallets"})
}

async fn post(service: &Service, zone: &Value) -> Answer {
    service.send(Request::new("POST", ZONES).json(zone)).await
}

/// Whether the alert is muted, its revision, and how many open alerts the route counts.
async fn standing(service: &Service) -> (bool, i64, i64) {
    let alert = service.get(&format!("/v1/alerts/{APPEARED}")).await.json();
    let route = service.get("/v1/routes/hall").await.json();
    assert_eq!(
        alert["decision_revision"], 1,
        "nobody's decision is refused"
    );
    (
        alert["muted"].as_bool().unwrap(),
        alert["revision"].as_i64().unwrap(),
        route["counts"]["open_alerts"].as_i64().unwrap(),
    )
}

async fn listed(service: &Service, muted: bool) -> usize {
    let path = format!("/v1/alerts?status=open&muted={muted}");
    let page = service.get(&path).await.json();
    page["items"].as_array().unwrap().len()
}

#[tokio::test]
async fn a_zone_mutes_the_alerts_in_it_until_it_is_deleted() {
    let service = changed_hall::start().await;
    assert_eq!(standing(&service).await, (false, 1, 1));
    let made = post(&service, &zone()).await;
    assert_eq!(made.status, 201, "{}", made.text());
    let path = made.header("location").unwrap().to_owned();
    assert_eq!(standing(&service).await, (true, 2, 0));
    assert_eq!(
        (listed(&service, true).await, listed(&service, false).await),
        (1, 0)
    );
    let read = service.get(&path).await;
    assert_eq!(
        (read.header("etag"), read.json()),
        (Some("\"1\""), made.json())
    );
    assert_eq!(
        service.get(ZONES).await.json()["items"],
        json!([made.json()])
    );

    // Of another kind, it mutes nothing here.
    let mut other = zone();
    other["kinds"] = json!(["disappeared"]);
    let put = |tag: &'static str, zone: Value| {
        let put = Request::new("PUT", path.as_str()).header("if-match", tag);
        service.send(put.json(&zone))
    };
    let changed = put("\"1\"", other.clone()).await;
    assert_eq!(changed.status, 200, "{}", changed.text());
    assert_eq!(changed.json()["kinds"], json!(["disappeared"]));
    assert_eq!(standing(&service).await, (false, 3, 1));
    let stale = put("\"1\"", other).await;
    assert_eq!(
        (stale.status, stale.problem()),
        (412, "precondition-failed".to_owned())
    );
    assert_eq!(put("\"2\"", zone()).await.status, 200);
    assert_eq!(standing(&service).await, (true, 4, 0));

    let deleted = service.send(Request::new("DELETE", path.as_str())).await;
    assert_eq!(deleted.status, 204);
    assert_eq!(standing(&service).await, (false, 5, 1));
    assert_eq!(service.get(&path).await.status, 404);
    let audit = service.get("/v1/audit?limit=4").await.json();
    let actions = audit["items"].as_array().unwrap().iter();
    let actions: Vec<&str> = actions.map(|row| row["action"].as_str().unwrap()).collect();
    assert_eq!(
        actions,
        [
            "zone.deleted",
            "zone.changed",
            "zone.changed",
            "zone.created"
        ]
    );
    service.stop().await;
}

#[tokio::test]
async fn a_zone_ends_at_its_time() {
    let service = changed_hall::start().await;
    let mut short = zone();
    short["until"] = json!(Timestamp::now() + SignedDuration::from_millis(700));
    let made = post(&service, &short).await;
    assert_eq!(made.status, 201, "{}", made.text());
    let path = made.header("location").unwrap().to_owned();
    let ended = async {
        while service.get(&path).await.json()["ended_at"].is_null() {
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    };
    tokio::time::timeout(Duration::from_secs(30), ended)
        .await
        .unwrap();
    assert_eq!(standing(&service).await, (false, 3, 1));
    service.stop().await;
}

#[tokio::test]
async fn malformed_zones_are_refused() {
    let service = changed_hall::start().await;
    let with = |field: &str, value: Value| {
        let mut zone = zone();
        zone[field] = value;
        zone
    };
    for (faulty, pointer) in [
        (with("polygon", json!([[0, 0], [1, 0]])), "/polygon"),
        (
            with("polygon", json!([[0, 0], [1, 1], [1, 0], [0, 1]])),
            "/polygon",
        ),
        (
            with("polygon", json!([[0, 0], [0.1, 0], [0, 0.1]])),
            "/polygon",
        ),
        (
            with("polygon", json!([[0, 0], [2e6, 0], [0, 1]])),
            "/polygon",
        ),
        (with("kinds", json!([])), "/kinds"),
        (with("until", json!("2020-01-01T00:00:00Z")), "/until"),
        (with("note", json!("x".repeat(2_001))), "/note"),
    ] {
        let refused = post(&service, &faulty).await;
        assert_eq!(refused.status, 422, "{faulty}: {}", refused.text());
        assert_eq!(refused.json()["errors"][0]["pointer"], pointer);
    }
    let nowhere = Request::new("POST", "/v1/routes/nowhere/zones").json(&zone());
    assert_eq!(service.send(nowhere).await.problem(), "unknown-route");
    assert_eq!(standing(&service).await, (false, 1, 1));
    service.stop().await;
}
