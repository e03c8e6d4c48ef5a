//! What is taken, and how each mistake is reported.

use serde_json::{Value, json};

use super::*;
use crate::graph::EdgeKind;
use crate::ids::StampNs;
use crate::ingest::batch_json::BatchProblem;

fn received_at() -> Timestamp {
    "2026-11-20T07:00:00Z".parse().unwrap()
}

fn good() -> Value {
    json!({
        "vehicle_id": "agv-07",
        "nodes": [
            {"id": "a", "pose": {"x": 0.0, "y": 0.0, "theta": 0.0}, "stamp": "2026-11-20T06:00:00Z"},
            {"id": 7, "pose": {"x": 1.0, "y": 0.0, "theta": 7.0}}
        ],
        "edges": [
            {"from": "a", "to": "7", "measurement": {"x": 1.0, "y": 0.0, "theta": 0.0},
             "information": [4.0, 0.5, -0.25, 3.0, 0.125, 9.0], "kind": "odometry"},
            {"from": "map:12", "to": "a", "measurement": {"x": 1.0, "y": 0.0, "theta": 0.0},
             "information": [4.0, 0.0, 0.0, 3.0, 0.0, 9.0], "kind": "loop_closure"}
        ]
    })
}

fn read(body: &Value) -> Result<UploadedEdges, BatchBodyError> {
    decode(&serde_json::to_vec(body).unwrap(), received_at())
}

#[test]
fn names_stamps_and_kinds_are_read() {
    let edges = read(&good()).unwrap();
    assert_eq!(
        (edges.vehicle_id.as_str(), &edges.trip_id),
        ("agv-07", &None)
    );
    let names: Vec<&str> = edges.nodes.iter().map(|n| n.name.as_str()).collect();
    assert_eq!(names, ["a", "7"]);
    let received_ns = received_at().as_nanosecond() as i64;
    assert_eq!(
        edges.nodes[0].stamp,
        StampNs(received_ns - 3_600_000_000_000)
    );
    assert_eq!(edges.nodes[1].stamp, StampNs(received_ns + 1));
    let ends = |k: usize| {
        (
            edges.edges[k].from.to_string(),
            edges.edges[k].to.to_string(),
        )
    };
    assert_eq!(ends(0), ("a".to_owned(), "7".to_owned()));
    assert_eq!(ends(1), ("map:12".to_owned(), "a".to_owned()));
    assert_eq!(edges.edges[0].kind, EdgeKind::Odometry);
    assert_eq!(edges.edges[1].kind, EdgeKind::LoopClosure);
    assert_eq!(
        edges.edges[0].information.upper(),
        [4.0, 0.5, -0.25, 3.0, 0.125, 9.0]
    );
    assert!(edges.flags.is_empty());
    assert!((edges.nodes[1].pose.theta - (7.0 - std::f64::consts::TAU)).abs() < 1e-12);
}

#[test]
fn each_mistake_is_named_with_its_place() {
    use BatchProblem::{EdgeGraph, InvalidField, MalformedJson, OutOfRange};
    let flat = json!([1.0, 1.0, 0.0, 1.0, 0.0, 1.0]);
    for (pointer, value, problem, at) in [
        ("/nodes/1/id", json!("a"), EdgeGraph, "/nodes/1/id"),
        ("/nodes/1/id", json!("map:3"), EdgeGraph, "/nodes/1/id"),
        ("/nodes/0/id", json!("ü"), InvalidField, "/nodes/0/id"),
        ("/nodes/0/id", json!(1.5), InvalidField, "/nodes/0/id"),
        ("/nodes/0/id", json!(null), InvalidField, "/nodes/0/id"),
        ("/nodes/0/pose/x", json!(2e6), OutOfRange, "/nodes/0/pose/x"),
        (
            "/nodes/0/pose/theta",
            json!(1e5),
            OutOfRange,
            "/nodes/0/pose/theta",
        ),
        (
            "/nodes/0/stamp",
            json!("1969-01-01T00:00:00Z"),
            OutOfRange,
            "/nodes/0/stamp",
        ),
        ("/edges/0/to", json!("a"), EdgeGraph, "/edges/0/to"),
        ("/edges/0/to", json!("map:012"), InvalidField, "/edges/0/to"),
        ("/edges/0/to", json!("map:-1"), InvalidField, "/edges/0/to"),
        (
            "/edges/0/measurement/y",
            json!(-1e7),
            OutOfRange,
            "/edges/0/measurement/y",
        ),
        (
            "/edges/1/information",
            flat,
            EdgeGraph,
            "/edges/1/information",
        ),
        (
            "/edges/1/information",
            json!([0, 0, 0, 0, 0, 0]),
            EdgeGraph,
            "/edges/1/information",
        ),
        (
            "/edges/1/information",
            json!([1e13, 0, 0, 1, 0, 1]),
            OutOfRange,
            "/edges/1/information",
        ),
        (
            "/edges/1/information",
            json!([1, 0, 0, 1, 0]),
            InvalidField,
            "/edges/1/information",
        ),
        (
            "/edges/1/kind",
            json!("guess"),
            MalformedJson,
            "/edges/1/kind",
        ),
        ("/edges", json!([[1]]), InvalidField, "/edges/0"),
    ] {
        let mut body = good();
        *body.pointer_mut(pointer).unwrap() = value.clone();
        let error = read(&body).unwrap_err();
        if problem != MalformedJson {
            assert_eq!(
                (error.problem, error.pointer.as_str()),
                (problem, at),
                "{value}: {error}"
            );
        }
    }
    let mut empty = good();
    empty["nodes"] = json!([]);
    empty["edges"] = json!([]);
    assert_eq!(read(&empty).unwrap_err().problem, EdgeGraph);
    let mut more = good();
    more["nodes"][0]["color"] = json!(1);
    assert_eq!(read(&more).unwrap_err().problem, MalformedJson);
}

#[test]
fn what_is_too_much_is_counted() {
    let mut body = good();
    let node = |k: usize| json!({"id": k, "pose": {"x": 0.0, "y": 0.0, "theta": 0.0}});
    body["edges"] = json!([]);
    body["nodes"] = (0..NODES_MAX).map(node).collect();
    assert_eq!(read(&body).unwrap().nodes.len(), NODES_MAX);
    body["nodes"] = (0..=NODES_MAX).map(node).collect();
    let error = read(&body).unwrap_err();
    assert_eq!(
        (error.problem, error.pointer.as_str()),
        (BatchProblem::TooLarge, "/nodes")
    );
    assert!(error.detail.contains("this one has 5001"), "{error}");
    let mut body = good();
    let edge = body["edges"][0].clone();
    body["edges"] = vec![edge; EDGES_MAX + 1].into();
    assert_eq!(read(&body).unwrap_err().pointer, "/edges");
}

#[test]
fn stamps_far_away_are_flagged() {
    let mut body = good();
    body["nodes"][0]["stamp"] = json!("2026-10-01T06:00:00Z");
    body["nodes"][1]["stamp"] = json!("2026-11-25T06:00:00Z");
    assert_eq!(read(&body).unwrap().flags, ["clock_skew", "late"]);
}

#[test]
fn a_simulated_time_is_that_of_arrival_in_the_order_of_the_batch() {
    let mut body = good();
    body["nodes"][0]["stamp"] = json!("1970-01-01T00:00:05Z");
    body["nodes"][1]["stamp"] = json!("1970-01-01T00:00:04Z");
    let edges = read(&body).unwrap();
    assert_eq!(edges.flags, ["simulated_time"]);
    let received_ns = received_at().as_nanosecond() as i64;
    let stamps = edges.nodes.iter().map(|node| node.stamp);
    assert_eq!(
        stamps.collect::<Vec<_>>(),
        [StampNs(received_ns), StampNs(received_ns + 1)]
    );
}

#[test]
fn extensions_are_kept_and_other_fields_refused() {
    let mut body = good();
    body["extensions"] = json!({"slam": "v2"});
    let edges = read(&body).unwrap();
    assert_eq!(edges.extensions.as_deref(), Some(r#"{"slam":"v2"}"#));
    body["extensions"] = json!(1);
    assert_eq!(read(&body).unwrap_err().pointer, "/extensions");
}
