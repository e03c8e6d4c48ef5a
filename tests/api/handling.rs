//! Who sees to an alert, what people write about it, and the report of a shift.

use serde_json::{Value, json};

use crate::changed_hall::{self, APPEARED};
use crate::client::{Answer, Request};
use crate::service::Service;

async fn send(service: &Service, method: &'static str, what: &str, body: Value) -> Answer {
    let path = format!("/v1/alerts/{APPEARED}/{what}");
    service.send(Request::new(method, path).json(&body)).await
}

#[tokio::test]
async fn assignments_and_comments_do_not_invalidate_a_decision() {
    let service = changed_hall::start().await;
    let assigned = send(&service, "PUT", "assignee", json!({"assignee": "kim"})).await;
    assert_eq!(assigned.status, 200, "{}", assigned.text());
    let again = send(&service, "PUT", "assignee", json!({"assignee": "kim"})).await;
    for alert in [assigned.json(), again.json()] {
        assert_eq!(
            (
                &alert["assignee"],
                &alert["revision"],
                &alert["decision_revision"]
            ),
            (&json!("kim"), &json!(2), &json!(1))
        );
    }
    for text in ["seen", "still there"] {
        let comment = send(
            &service,
            "POST",
            "comments",
            json!({"text": text, "by": "lee"}),
        )
        .await;
        assert_eq!(comment.status, 201, "{}", comment.text());
        assert_eq!(
            (&comment.json()["text"], &comment.json()["by"]),
            (&json!(text), &json!("lee"))
        );
    }
    let path = format!("/v1/alerts/{APPEARED}/comments?limit=1");
    let first = service.get(&path).await.json();
    assert_eq!(first["items"][0]["text"], "seen");
    let path = format!("{path}&cursor={}", first["next_cursor"].as_str().unwrap());
    let second = service.get(&path).await.json();
    assert_eq!(
        (&second["items"][0]["text"], &second["next_cursor"]),
        (&json!("still there"), &Value::Null)
    );

    let stream = Request::new("GET", "/v1/alerts/stream").header("last-event-id", "2");
    let mut connection = crate::client::Connection::open(service.address).await;
    connection.write(&stream.head()).await;
    let sent = connection.wait_for("\"comments\":2").await;
    assert!(sent.contains("event: alert.updated"), "{sent}");

    let path = format!("/v1/alerts/{APPEARED}/dismiss");
    let dismiss = Request::new("POST", path).header("if-match", "\"1\"");
    let dismissed = service
        .send(dismiss.json(&json!({"by": "kim", "reason": "people"})))
        .await;
    assert_eq!(dismissed.status, 200, "{}", dismissed.text());
    let alert = dismissed.json();
    assert_eq!(
        (&alert["revision"], &alert["comments"]),
        (&json!(5), &json!(2))
    );

    for (method, what, body, pointer) in [
        ("PUT", "assignee", json!({"assignee": ""}), "/assignee"),
        ("POST", "comments", json!({"text": ""}), "/text"),
        (
            "POST",
            "comments",
            json!({"text": "x", "by": "system"}),
            "/by",
        ),
    ] {
        let refused = send(&service, method, what, body).await;
        assert_eq!(refused.status, 422, "{}", refused.text());
        assert_eq!(refused.json()["errors"][0]["pointer"], pointer);
    }
    service.stop().await;
}

#[tokio::test]
async fn a_report_lists_raised_decided_and_open_alerts() {
    let service = changed_hall::start().await;
    let read = async |query: &str| {
        let report = service.get(&format!("/v1/report{query}")).await;
        assert_eq!(report.status, 200, "{}", report.text());
        report.json()
    };
    let shift = "?since=2026-11-20T06:00:00Z&until=2026-11-20T14:00:00Z";
    let report = read(shift).await;
    assert_eq!(
        report["counts"],
        json!({"raised": 2, "decided": 0, "open": 1, "muted": 0})
    );
    assert_eq!(report["open"][0]["id"], APPEARED);
    assert_eq!(
        (&report["decided"], &report["truncated"]),
        (&json!([]), &json!(false))
    );

    for (action, tag) in [("accept", "\"1\""), ("undo", "\"2\""), ("dismiss", "\"3\"")] {
        let mut body = json!({"by": "kim", "note": "so"});
        if action == "dismiss" {
            body["reason"] = json!("people");
        }
        let path = format!("/v1/alerts/{APPEARED}/{action}");
        let request = Request::new("POST", path)
            .header("if-match", tag)
            .json(&body);
        assert_eq!(service.send(request).await.status, 200, "{action}");
    }
    let report = read("?since=2020-01-01T00:00:00Z&until=2100-01-01T00:00:00Z&route_id=hall").await;
    let decided = report["decided"].as_array().unwrap();
    let actions: Vec<&Value> = decided.iter().map(|one| &one["action"]).collect();
    assert_eq!(actions, ["dismiss", "undo", "accept"]);
    assert_eq!(
        (&decided[0]["by"], &decided[0]["reason"]),
        (&json!("kim"), &json!("people"))
    );
    assert_eq!(
        report["dismissals"],
        json!([{"route_id": "hall", "kind": "appeared", "reason": "people", "count": 1}])
    );
    assert_eq!(
        report["counts"],
        json!({"raised": 2, "decided": 3, "open": 0, "muted": 0})
    );
    let elsewhere = read("?since=2020-01-01T00:00:00Z&route_id=yard").await;
    assert_eq!(elsewhere["counts"]["raised"], 0);
    let refused = service
        .get("/v1/report?since=2030-01-01T00:00:00Z&until=2020-01-01T00:00:00Z")
        .await;
    assert_eq!(
        (refused.status, refused.problem()),
        (400, "invalid-parameter".to_owned())
    );
    service.stop().await;
}
