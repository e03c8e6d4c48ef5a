//! Slow, large and many: refused early, with the connection closed in order.

use std::time::Duration;

use mapshift::api::{Limits, Pace};

use crate::body::batch;
use crate::client::{Connection, Request};
use crate::service::{Service, short_limits};

const PATH: &str = "/v1/routes/line-4/batches/b-1";

fn upload() -> Request {
    Request::new("PUT", PATH).json(&batch(0, 2))
}

#[tokio::test]
async fn a_slow_head_is_cut_off() {
    let service = Service::start_with(short_limits()).await;
    let mut connection = Connection::open(service.address).await;
    connection.write(b"GET /livez HTTP/1.1\r\nhost: te").await;
    let bytes = connection.rest().await;
    assert!(!String::from_utf8_lossy(&bytes).contains("200 OK"));
    service.stop().await;
}

#[tokio::test]
async fn a_slow_body_gets_408_and_the_connection_closed() {
    let service = Service::start_with(short_limits()).await;
    service.put_route("line-4").await;
    let request = upload();
    let mut connection = Connection::open(service.address).await;
    let head = String::from_utf8(request.head()).unwrap();
    let keeping = head.replace("connection: close\r\n", "");
    connection.write(keeping.as_bytes()).await;
    connection.write(&request.body.unwrap()[..10]).await;
    let answer = connection.answer().await;
    assert_eq!(
        (answer.status, answer.problem().as_str()),
        (408, "request-timeout")
    );
    assert_eq!(answer.header("connection"), Some("close"));
    service.stop().await;
}

/// At least 200 bytes a second, after half a second.
fn paced_bodies() -> Limits {
    Limits {
        uploads: 1,
        body_pace: Pace {
            grace: Duration::from_millis(500),
            bytes_per_s: 200,
            total: Duration::from_secs(60),
        },
        ..Limits::default()
    }
}

#[tokio::test]
async fn a_trickling_body_releases_its_place() {
    let service = Service::start_with(paced_bodies()).await;
    service.put_route("line-4").await;
    let request = upload();
    let mut connection = Connection::open(service.address).await;
    connection.write(&request.head()).await;
    for byte in &request.body.unwrap()[..40] {
        connection.write(&[*byte]).await;
        tokio::time::sleep(Duration::from_millis(25)).await;
    }
    let answer = connection.answer().await;
    assert_eq!(
        (answer.status, answer.problem().as_str()),
        (408, "request-timeout")
    );
    assert_eq!(answer.header("connection"), Some("close"));
    assert_eq!(service.send(upload()).await.status, 202);
    service.stop().await;
}

#[tokio::test]
async fn a_slow_gateway_completes_its_upload() {
    let service = Service::start_with(paced_bodies()).await;
    service.put_route("line-4").await;
    let request = upload();
    let mut connection = Connection::open(service.address).await;
    connection.write(&request.head()).await;
    let body = request.body.unwrap();
    for piece in body.chunks(body.len() / 15) {
        connection.write(piece).await;
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    assert_eq!(connection.answer().await.status, 202);
    service.stop().await;
}

#[tokio::test]
async fn a_body_must_end_in_time_even_at_a_good_pace() {
    let mut limits = paced_bodies();
    limits.body_pace.total = Duration::from_millis(400);
    let service = Service::start_with(limits).await;
    service.put_route("line-4").await;
    let endless = Request::new("PUT", PATH)
        .header("content-type", "application/json")
        .header("content-length", "1000000");
    let mut connection = Connection::open(service.address).await;
    connection.write(&endless.head()).await;
    connection.write(&[b' '; 10_000]).await;
    let answer = connection.answer().await;
    assert_eq!(answer.status, 408);
    service.stop().await;
}

#[tokio::test]
async fn a_body_that_is_cut_off_stores_nothing() {
    let service = Service::start().await;
    service.put_route("line-4").await;
    let request = upload();
    let mut connection = Connection::open(service.address).await;
    connection.write(&request.head()).await;
    connection.write(&request.body.unwrap()[..10]).await;
    drop(connection);
    assert_eq!(service.send(upload()).await.status, 202);
    service.stop().await;
}

#[tokio::test]
async fn a_refusal_reaches_a_client_that_is_still_sending() {
    let limits = Limits {
        wire_bytes: 1 << 20,
        ..Limits::default()
    };
    let service = Service::start_with(limits).await;
    service.put_route("line-4").await;
    let large = Request::new("PUT", PATH)
        .header("content-type", "application/json")
        .body(vec![b' '; 8 << 20]);
    let answer = service.send(large).await;
    assert_eq!(
        (answer.status, answer.problem().as_str()),
        (413, "too-large")
    );
    service.stop().await;
}

#[tokio::test]
async fn an_upload_without_a_free_place_is_refused_before_its_body() {
    let limits = Limits {
        uploads: 1,
        ..Limits::default()
    };
    let service = Service::start_with(limits).await;
    service.put_route("line-4").await;
    let request = upload();
    let mut first = Connection::open(service.address).await;
    let asking = request.clone().header("expect", "100-continue");
    first.write(&asking.head()).await;
    first.wait_until_asked_for_body().await;
    let mut second = Connection::open(service.address).await;
    second.write(&asking.head()).await;
    let refused = second.rest().await;
    let refused = String::from_utf8_lossy(&refused);
    assert!(refused.starts_with("HTTP/1.1 503 "), "{refused}");
    assert!(refused.contains("retry-after: "), "{refused}");
    first.write(request.body.as_ref().unwrap()).await;
    assert_eq!(first.answer().await.status, 202);
    assert_eq!(service.send(upload()).await.status, 200);
    service.stop().await;
}

#[tokio::test]
async fn every_one_of_many_simultaneous_uploads_is_answered() {
    let service = Service::start().await;
    service.put_route("line-4").await;
    let address = service.address;
    let uploads = (0..60).map(|k| {
        let request = Request::new("PUT", format!("/v1/routes/line-4/batches/b-{k}"));
        let request = request.json(&batch(k % 60, 2));
        async move { request.send(address).await }
    });
    let answers = futures::future::join_all(uploads).await;
    let stored = answers.iter().filter(|a| a.status == 202).count();
    for answer in answers.iter().filter(|a| a.status != 202) {
        assert!([429, 503].contains(&answer.status), "{}", answer.status);
        assert!(answer.header("retry-after").is_some());
    }
    let route = service.get("/v1/routes/line-4").await.json();
    assert_eq!(route["counts"]["batches"], stored);
    service.stop().await;
}
