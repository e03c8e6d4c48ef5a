//! Many at once, and some who do not behave: everybody else is served.

use std::time::Duration;

use mapshift::api::{Limits, Pace, Reads};

use crate::body::batch;
use crate::changed_hall;
use crate::client::{Answer, Connection, Request};
use crate::service::Service;

const PATH: &str = "/v1/routes/line-4/batches/b-1";
const ALIVE: &[u8] = b"GET /livez HTTP/1.1\r\nhost: localhost\r\n\r\n";
const GRAPH: &str = "/v1/routes/hall/graph";

fn upload() -> Request {
    Request::new("PUT", PATH).json(&batch(0, 2))
}

async fn start_in_changed_hall(limits: Limits) -> Service {
    Service::start_in(changed_hall::directory().await, limits).await
}

/// An upload that has its place and keeps it.
async fn hold_an_upload(service: &Service) -> Connection {
    let mut connection = Connection::open(service.address).await;
    let asking = upload().header("expect", "100-continue");
    connection.write(&asking.head()).await;
    connection.wait_until_asked_for_body().await;
    connection
}

/// A reader that has its answer begun and takes no more of it.
async fn hold_a_read(service: &Service) -> Connection {
    let mut connection = Connection::open(service.address).await;
    connection.write(&Request::new("GET", GRAPH).head()).await;
    connection.wait_for("\r\n\r\n").await;
    connection
}

async fn ask_from_elsewhere(service: &Service, request: &Request) -> Answer {
    let mut connection = Connection::open_from_elsewhere(service.address).await;
    connection.write(&request.head()).await;
    if let Some(body) = &request.body {
        connection.write(body).await;
    }
    connection.answer().await
}

fn assert_over_share(answer: &Answer, policy: &str) {
    assert_eq!(
        (answer.status, answer.problem().as_str()),
        (429, "too-many-requests")
    );
    assert_eq!(answer.header("ratelimit-policy"), Some(policy));
    assert!(answer.header("ratelimit").unwrap().contains(";r=0;t="));
    assert!(answer.header("retry-after").is_some());
    assert_eq!(answer.header("connection"), Some("close"));
}

#[tokio::test]
async fn one_address_cannot_take_all_uploads() {
    let limits = Limits {
        uploads: 2,
        ..Limits::default()
    };
    let service = Service::start_with(limits).await;
    service.put_route("line-4").await;
    let holding = hold_an_upload(&service).await;
    let refused = service.send(upload()).await;
    assert_over_share(&refused, "\"uploads\";q=1;qu=\"concurrent-requests\"");
    assert_eq!(ask_from_elsewhere(&service, &upload()).await.status, 202);
    drop(holding);
    service.stop().await;
}

#[tokio::test]
async fn one_address_cannot_reserve_all_bytes() {
    let limits = Limits {
        wire_bytes: 10_000,
        wire_bytes_total: 20_000,
        ..Limits::default()
    };
    let service = Service::start_with(limits).await;
    service.put_route("line-4").await;
    let large = Request::new("PUT", PATH)
        .header("content-type", "application/json")
        .header("content-length", "9999")
        .header("expect", "100-continue");
    let mut holding = Connection::open(service.address).await;
    holding.write(&large.head()).await;
    holding.wait_until_asked_for_body().await;
    let refused = service.send(upload()).await;
    assert_over_share(&refused, "\"upload-bytes\";q=10000;qu=\"content-bytes\"");
    assert_eq!(ask_from_elsewhere(&service, &upload()).await.status, 202);
    drop(holding);
    service.stop().await;
}

#[tokio::test]
async fn one_address_cannot_take_all_connections() {
    let limits = Limits {
        connections: 4,
        ..Limits::default()
    };
    let service = Service::start_with(limits).await;
    service.put_route("line-4").await;
    let holding = [
        hold_an_upload(&service).await,
        hold_an_upload(&service).await,
    ];
    let refused = service.get("/livez").await;
    assert_over_share(&refused, "\"connections\";q=2;qu=\"concurrent-requests\"");
    let livez = Request::new("GET", "/livez");
    assert_eq!(ask_from_elsewhere(&service, &livez).await.status, 200);
    drop(holding);
    service.stop().await;
}

#[tokio::test]
async fn a_connection_is_refused_with_an_answer_if_none_is_idle() {
    let limits = Limits {
        connections: 1,
        ..Limits::default()
    };
    let service = Service::start_with(limits).await;
    // Of the connection that put the route, the end may not have been seen yet.
    service.put_route("line-4").await;
    let holding = hold_an_upload(&service).await;
    let refused = service.get("/livez").await;
    assert_eq!(
        (refused.status, refused.problem().as_str()),
        (503, "overloaded")
    );
    assert!(refused.header("retry-after").is_some());
    drop(holding);
    service.stop().await;
}

#[tokio::test]
async fn the_connection_idle_longest_makes_room_for_a_new_one() {
    let limits = Limits {
        connections: 3,
        address_share_percent: 100,
        header_timeout: Duration::from_secs(60),
        ..Limits::default()
    };
    let service = Service::start_with(limits).await;
    let mut waiting = Vec::new();
    for _ in 0..3 {
        let mut connection = Connection::open(service.address).await;
        connection.write(ALIVE).await;
        assert_eq!(connection.next_answer().await.status, 200);
        waiting.push(connection);
    }
    // The first is now the one that waits the shortest.
    waiting[0].write(ALIVE).await;
    assert_eq!(waiting[0].next_answer().await.status, 200);
    assert_eq!(service.get("/livez").await.status, 200);
    assert!(waiting[1].rest().await.is_empty());
    for kept in [0, 2] {
        waiting[kept].write(ALIVE).await;
        assert_eq!(waiting[kept].next_answer().await.status, 200);
    }
    service.stop().await;
}

fn few_exports() -> Limits {
    Limits {
        exports: Reads {
            at_once: 1,
            under_way: 2,
        },
        turn_timeout: Duration::from_millis(200),
        ..Limits::default()
    }
}

#[tokio::test]
async fn exports_are_shared_and_hold_up_nothing_else() {
    let service = Service::start_with_long_route(few_exports()).await;
    service.put_route("line-4").await;
    let graph = Request::new("GET", GRAPH);
    let first = hold_a_read(&service).await;
    let refused = service.send(graph.clone()).await;
    assert_eq!(
        (refused.status, refused.problem().as_str()),
        (429, "too-many-requests")
    );
    let mut elsewhere = Connection::open_from_elsewhere(service.address).await;
    elsewhere.write(&graph.head()).await;
    elsewhere.wait_for("\r\n\r\n").await;
    for path in [
        "/livez",
        "/readyz",
        "/metrics",
        "/v1/routes/hall/batches/b-0",
    ] {
        assert_eq!(service.get(path).await.status, 200, "{path}");
    }
    assert_eq!(service.send(upload()).await.status, 202);
    drop((first, elsewhere));
    let after = loop {
        let answer = service.send(graph.clone()).await;
        if answer.status != 429 {
            break answer;
        }
    };
    assert_eq!(after.status, 200);
    assert_eq!(after.json()["nodes"].as_array().unwrap().len(), 5_000);
    service.stop().await;
}

#[tokio::test]
async fn a_read_waits_for_its_turn_for_a_bounded_time() {
    let limits = Limits {
        address_share_percent: 100,
        exports: Reads {
            at_once: 1,
            under_way: 1,
        },
        ..few_exports()
    };
    let service = Service::start_with_long_route(limits).await;
    let holding = hold_a_read(&service).await;
    let refused = service.get(GRAPH).await;
    assert_eq!(
        (refused.status, refused.problem().as_str()),
        (503, "overloaded")
    );
    assert!(refused.header("retry-after").is_some());
    drop(holding);
    service.stop().await;
}

fn impatient() -> Limits {
    Limits {
        answer_pace: Pace {
            grace: Duration::from_millis(300),
            bytes_per_s: 1_000_000,
            total: Duration::from_secs(60),
        },
        ..Limits::default()
    }
}

#[tokio::test]
async fn a_client_that_does_not_read_an_export_is_cut_off() {
    let service = Service::start_with_long_route(impatient()).await;
    let mut connection = hold_a_read(&service).await;
    connection.wait_until_cut_off().await;
    service.stop().await;
}

#[tokio::test]
async fn a_client_that_does_not_read_short_answers_is_cut_off() {
    let service = Service::start_with(impatient()).await;
    let mut connection = Connection::open(service.address).await;
    let many = b"GET /openapi.json HTTP/1.1\r\nhost: localhost\r\n\r\n".repeat(100);
    connection.write(&many).await;
    connection.wait_until_cut_off().await;
    service.stop().await;
}

#[tokio::test]
async fn a_quiet_stream_is_not_cut_off() {
    let service = start_in_changed_hall(impatient()).await;
    let request = Request::new("GET", "/v1/alerts/stream");
    let mut stream = Connection::open(service.address).await;
    stream.write(&request.head()).await;
    stream.wait_for("\r\n\r\n").await;
    tokio::time::sleep(Duration::from_secs(1)).await;
    let path = format!("/v1/alerts/{}/acknowledge", changed_hall::APPEARED);
    let acknowledge = Request::new("POST", path).header("if-match", "*");
    assert_eq!(service.send(acknowledge).await.status, 200);
    stream.wait_for(changed_hall::APPEARED).await;
    drop(stream);
    service.stop().await;
}

#[tokio::test]
async fn streams_are_shared_and_end_with_the_id_to_resume_from() {
    let limits = Limits {
        streams: 2,
        stream_time: Duration::from_millis(700),
        ..Limits::default()
    };
    let service = start_in_changed_hall(limits).await;
    let request = Request::new("GET", "/v1/alerts/stream");
    let mut stream = Connection::open(service.address).await;
    stream.write(&request.head()).await;
    stream.wait_for("\r\n\r\n").await;
    let refused = service.send(request.clone()).await;
    assert_eq!(
        (refused.status, refused.problem().as_str()),
        (429, "too-many-requests")
    );
    let seen = String::from_utf8(stream.rest().await).unwrap();
    assert!(seen.contains("id: 2\n\n"), "{seen}");
    let mut again = Connection::open(service.address).await;
    again.write(&request.head()).await;
    let head = again.wait_for("\r\n\r\n").await;
    assert!(head.starts_with("HTTP/1.1 200"), "{head}");
    drop(again);
    service.stop().await;
}

#[tokio::test]
async fn bombs_are_refused_while_other_uploads_pass() {
    let service = Service::start().await;
    service.put_route("line-4").await;
    let bomb = zstd::bulk::compress(&vec![b' '; 60 << 20], 1).unwrap();
    let bombs = (0..16).map(|k| {
        let bomb = Request::new("PUT", format!("/v1/routes/line-4/batches/bomb-{k}"))
            .header("content-type", "application/json")
            .header("content-encoding", "zstd")
            .body(bomb.clone());
        let address = service.address;
        tokio::spawn(async move { bomb.send(address).await })
    });
    let bombs: Vec<_> = bombs.collect();
    assert_eq!(service.send(upload()).await.status, 202);
    for bomb in bombs {
        let answer = bomb.await.unwrap();
        assert_eq!(
            (answer.status, answer.problem().as_str()),
            (413, "too-large")
        );
    }
    service.stop().await;
}
