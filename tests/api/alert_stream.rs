//! Alerts as they happen.

use crate::changed_hall::{self, APPEARED, DISAPPEARED};
use crate::client::{Connection, Request};
use crate::service::Service;

async fn follow(service: &Service, query: &str, last: Option<&str>) -> Connection {
    let path = format!("/v1/alerts/stream{query}");
    let request = Request::new("GET", path).header("accept", "text/event-stream");
    let request = match last {
        Some(last) => request.header("last-event-id", last),
        None => request,
    };
    let mut stream = Connection::open(service.address).await;
    stream.write(&request.head()).await;
    let head = stream.wait_for("\r\n\r\n").await;
    assert!(head.starts_with("HTTP/1.1 200"), "{head}");
    assert!(head.contains("text/event-stream"), "{head}");
    stream
}

async fn acknowledge(service: &Service) {
    let path = format!("/v1/alerts/{APPEARED}/acknowledge");
    let request = Request::new("POST", path).header("if-match", "*");
    assert_eq!(service.send(request).await.status, 200);
}

#[tokio::test]
async fn a_client_that_reconnects_misses_nothing() {
    let service = changed_hall::start().await;
    let mut stream = follow(&service, "?route_id=hall", Some("0")).await;
    let raised = stream.wait_for(DISAPPEARED).await;
    assert!(
        raised.contains("event: alert.raised") && raised.contains(APPEARED),
        "{raised}"
    );
    acknowledge(&service).await;
    let updated = stream.wait_for("\"status\":\"acknowledged\"").await;
    assert!(
        updated.contains("event: alert.updated") && updated.contains("id: 3"),
        "{updated}"
    );
    drop(stream);
    let mut again = follow(&service, "", Some("2")).await;
    let missed = again.wait_for("\"status\":\"acknowledged\"").await;
    assert!(!missed.contains("alert.raised"), "{missed}");
    drop(again);
    service.stop().await;
}

#[tokio::test]
async fn a_stream_begins_with_the_next_event_of_its_route_and_ends_with_the_service() {
    let service = changed_hall::start().await;
    let mut of_hall = follow(&service, "", None).await;
    let mut of_yard = follow(&service, "?route_id=yard", None).await;
    acknowledge(&service).await;
    let seen = of_hall.wait_for(APPEARED).await;
    assert!(
        !seen.contains("alert.raised") && !seen.contains(DISAPPEARED),
        "{seen}"
    );
    service.stop().await;
    let rest = of_yard.rest().await;
    assert!(!String::from_utf8(rest).unwrap().contains("alert."));
}
