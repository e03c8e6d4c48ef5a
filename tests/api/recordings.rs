//! Recordings: whole trips as one file.

use std::fmt::Write;
use std::path::Path;
use std::time::Duration;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use mapshift::api::Limits;
use serde_json::{Value, json};
use sha2::{Digest, Sha256};

use crate::body::batch;
use crate::client::{Answer, Request};
use crate::service::Service;

fn file(name: &str) -> Vec<u8> {
    let directory = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/recordings");
    std::fs::read(directory.join(name)).unwrap()
}

fn put(name: &str, query: &str, body: impl Into<Vec<u8>>) -> Request {
    let path = format!("/v1/routes/line-4/recordings/{name}?vehicle_id=agv-07&{query}");
    Request::new("PUT", path)
        .header("content-type", "application/octet-stream")
        .body(body)
}

fn expect_problem(answer: &Answer, status: u16, kind: &str) -> String {
    let problem = answer.problem();
    assert_eq!((answer.status, problem.as_str()), (status, kind));
    answer.json()["detail"].as_str().unwrap().to_owned()
}

/// The route once everything is processed.
async fn processed(service: &Service, route: &str) -> Value {
    loop {
        let route = service.get(&format!("/v1/routes/{route}")).await.json();
        if route["pending_batches"] == 0 {
            return route;
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

async fn node_poses(service: &Service, route: &str) -> Vec<[f64; 3]> {
    let graph = service
        .get(&format!("/v1/routes/{route}/graph"))
        .await
        .json();
    let nodes = graph["nodes"].as_array().unwrap().iter();
    let pose =
        |node: &Value| ["x", "y", "theta"].map(|field| node["pose"][field].as_f64().unwrap());
    nodes.map(pose).collect()
}

#[tokio::test]
async fn a_bag_and_its_json_make_the_same_map() {
    let service = Service::start().await;
    for name in ["amr", "turtlebot4"] {
        service.put_route("line-4").await;
        service.put_route("as-json").await;
        let recording = put(
            name,
            &format!("trip_id={name}&format=mcap"),
            file(&format!("{name}.mcap")),
        );
        let stored = service.send(recording).await;
        assert_eq!(stored.status, 202, "{:?}", stored.json());
        let location = format!("/v1/routes/line-4/batches/{name}");
        assert_eq!(stored.header("location"), Some(location.as_str()));
        let batch: Value = serde_json::from_slice(&file(&format!("{name}.json"))).unwrap();
        let path = format!("/v1/routes/as-json/batches/{name}");
        assert_eq!(
            service
                .send(Request::new("PUT", path).json(&batch))
                .await
                .status,
            202
        );
        processed(&service, "line-4").await;
        processed(&service, "as-json").await;
        let status = service.get(&location).await.json();
        assert_eq!(status["status"], "merged", "{status}");
        assert_eq!(status["scans"], batch["scans"].as_array().unwrap().len());
        let (from_bag, from_json) = (
            node_poses(&service, "line-4").await,
            node_poses(&service, "as-json").await,
        );
        assert!(from_bag.len() > 2, "{from_bag:?}");
        assert_eq!(from_bag.len(), from_json.len());
        for (a, b) in from_bag.iter().flatten().zip(from_json.iter().flatten()) {
            assert!((a - b).abs() < 1e-5, "{a} and {b}");
        }
        for route in ["line-4", "as-json"] {
            service
                .send(Request::new("DELETE", format!("/v1/routes/{route}")))
                .await;
        }
    }
    service.stop().await;
}

#[tokio::test]
async fn a_recording_is_identified_by_its_bytes_and_parameters() {
    let service = Service::start().await;
    service.put_route("line-4").await;
    let bag = file("turtlebot3.mcap");
    let query = "trip_id=monday&format=mcap";
    let digest = format!("sha-256=:{}:", STANDARD.encode(Sha256::digest(&bag)));
    let first = put("rec", query, bag.clone()).header("content-digest", &digest);
    assert_eq!(service.send(first).await.status, 202);
    let again = service.send(put("rec", query, bag.clone())).await;
    assert_eq!(again.status, 200);
    assert_eq!(again.header("idempotent-replayed"), Some("true"));
    assert_eq!(again.json()["id"], "rec");

    let refused = [
        (
            "rec",
            "trip_id=monday&format=mcap&mount_x=0.1",
            "batch-id-reused",
        ),
        (
            "rec",
            "trip_id=monday&format=mcap&odometry_topic=/tf",
            "batch-id-reused",
        ),
        ("other", query, "trip-taken"),
    ];
    for (name, query, kind) in refused {
        let answer = service.send(put(name, query, bag.clone())).await;
        expect_problem(&answer, 409, kind);
    }
    let ordinary = Request::new("PUT", "/v1/routes/line-4/batches/rec").json(&batch(0, 2));
    expect_problem(&service.send(ordinary).await, 409, "batch-id-reused");
    let route = processed(&service, "line-4").await;
    assert_eq!(route["counts"]["batches"], 1);
    service.stop().await;
}

/// A CARMEN log of so many scans of 8 beams.
fn log(scans: usize) -> Vec<u8> {
    let mut text = String::new();
    for k in 0..scans {
        let (x, t) = (0.002 * k as f64, 1_700_000_000.0 + 0.1 * k as f64);
        let ranges = "2.0 2.1 2.2 2.3 2.4 2.5 2.6 2.7";
        writeln!(
            text,
            "ROBOTLASER1 0 -3 6 0.78 20 0.01 0 8 {ranges} 0 {x} 0 0 {x} 0 0 0 0 0 0 0 {t} host {t}"
        )
        .unwrap();
    }
    text.into_bytes()
}

#[tokio::test]
async fn a_long_recording_is_stored_as_several_batches_or_not_at_all() {
    let service = Service::start().await;
    service.put_route("line-4").await;
    let query = "trip_id=long&format=carmen";
    let taken = Request::new("PUT", "/v1/routes/line-4/batches/rec.0001").json(&batch(0, 2));
    assert_eq!(service.send(taken).await.status, 202);
    let conflict = service.send(put("rec", query, log(650))).await;
    expect_problem(&conflict, 409, "batch-id-reused");
    let route = service.get("/v1/routes/line-4").await.json();
    assert_eq!(route["counts"]["batches"], 1, "nothing of it is stored");

    let stored = service.send(put("all", query, log(650))).await;
    assert_eq!(stored.status, 202);
    assert_eq!(
        (&stored.json()["scans"], &stored.json()["sequence"]),
        (&json!(50), &json!(2))
    );
    for (id, scans) in [("all.0000", 300), ("all.0001", 300), ("all", 50)] {
        let part = service
            .get(&format!("/v1/routes/line-4/batches/{id}"))
            .await
            .json();
        assert_eq!(
            (&part["scans"], &part["trip_id"]),
            (&json!(scans), &json!("long"))
        );
    }
    assert_eq!(service.send(put("all", query, log(650))).await.status, 200);
    expect_problem(
        &service.send(put("all", query, log(651))).await,
        409,
        "batch-id-reused",
    );

    let name = "n".repeat(60);
    let detail = expect_problem(
        &service.send(put(&name, query, log(3))).await,
        400,
        "invalid-field",
    );
    assert!(detail.contains("59"), "{detail}");
    service.stop().await;
}

#[tokio::test]
async fn an_unusable_recording_is_refused_and_leaves_nothing() {
    let limits = Limits {
        recording_bytes: 100_000,
        ..Limits::default()
    };
    let service = Service::start_with(limits).await;
    service.put_route("line-4").await;
    let mcap = "trip_id=monday&format=mcap";
    let bag = file("turtlebot3.mcap");

    let other_topic = put("r", "trip_id=monday&format=mcap&topic=/laser", bag.clone());
    let detail = expect_problem(&service.send(other_topic).await, 422, "recording-topics");
    assert!(
        detail.contains("/scan (sensor_msgs/msg/LaserScan, cdr: 31"),
        "{detail}"
    );
    let damaged = [&bag[..8], &[0; 64][..]].concat();
    let detail = expect_problem(
        &service.send(put("r", mcap, damaged)).await,
        422,
        "recording",
    );
    assert!(detail.contains("at byte 8"), "{detail}");
    let no_log = put("r", "trip_id=monday&format=carmen", bag.clone());
    expect_problem(&service.send(no_log).await, 422, "recording");
    expect_problem(
        &service.send(put("r", mcap, vec![0; 100_001])).await,
        413,
        "too-large",
    );

    let wrong = format!("sha-256=:{}:", STANDARD.encode([0; 32]));
    let wrong = put("r", mcap, bag.clone()).header("content-digest", &wrong);
    expect_problem(&service.send(wrong).await, 400, "digest-mismatch");
    let packed = put("r", mcap, bag.clone()).header("content-encoding", "gzip");
    expect_problem(&service.send(packed).await, 415, "unsupported-encoding");
    let mut json = put("r", mcap, bag.clone());
    json.headers[0].1 = "application/json".into();
    expect_problem(&service.send(json).await, 415, "unsupported-media-type");
    for query in [
        "trip_id=monday",
        "format=mcap",
        "trip_id=monday&format=bag",
        "trip_id=mon%20day&format=mcap",
        "trip_id=monday&format=mcap&mount_x=NaN",
        "trip_id=monday&format=mcap&speed=1",
    ] {
        let answer = service.send(put("r", query, bag.clone())).await;
        expect_problem(&answer, 400, "invalid-parameter");
    }
    let route = service.get("/v1/routes/line-4").await.json();
    assert_eq!(route["counts"]["batches"], 0);
    assert_eq!(service.send(put("r", mcap, bag)).await.status, 202);
    service.stop().await;
}
