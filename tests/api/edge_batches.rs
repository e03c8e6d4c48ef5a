//! Uploads of edges: what is refused, and how it is said.

use serde_json::{Value, json};

use crate::bad_requests::{Case, case, check};
use crate::client::Request;
use crate::service::Service;

const PATH: &str = "/v1/routes/line-4/edge-batches/e-1";

fn good() -> Value {
    let step = json!({"x": 1.0, "y": 0.0, "theta": 0.1});
    json!({
        "vehicle_id": "agv-07",
        "nodes": [{"id": "a", "pose": step}, {"id": "b", "pose": step}],
        "edges": [{"from": "a", "to": "b", "measurement": step, "kind": "odometry",
                   "information": [4.0, 0.5, -0.25, 3.0, 0.125, 9.0]}],
    })
}

fn with(pointer: &str, value: Value) -> Request {
    let mut body = good();
    *body.pointer_mut(pointer).unwrap() = value;
    Request::new("PUT", PATH).json(&body)
}

fn raw(body: String) -> Request {
    let request = Request::new("PUT", PATH);
    request
        .header("content-type", "application/json")
        .body(body)
}

fn cases() -> Vec<Case> {
    let named = |name, pointer, value, status, problem| {
        case(name, with(pointer, value), status, problem, pointer)
    };
    let node = good()["nodes"][0].clone();
    let many: Vec<Value> = (0..5_001)
        .map(|k| json!({"id": k, "pose": node["pose"]}))
        .collect();
    let edges = vec![good()["edges"][0].clone(); 20_001];
    vec![
        named("an id twice", "/nodes/1/id", json!("a"), 422, "edge-graph"),
        named(
            "a node of the map as new",
            "/nodes/1/id",
            json!("map:7"),
            422,
            "edge-graph",
        ),
        named(
            "an edge to itself",
            "/edges/0/to",
            json!("a"),
            422,
            "edge-graph",
        ),
        named(
            "a name with a slash",
            "/edges/0/to",
            json!("a/b"),
            400,
            "invalid-field",
        ),
        named(
            "a broken number",
            "/edges/0/to",
            json!(1.5),
            400,
            "invalid-field",
        ),
        named(
            "information of one direction",
            "/edges/0/information",
            json!([1, 0, 0, 0, 0, 0]),
            422,
            "edge-graph",
        ),
        named(
            "information with a negative eigenvalue",
            "/edges/0/information",
            json!([1, 2, 0, 1, 0, 1]),
            422,
            "edge-graph",
        ),
        named(
            "five numbers of information",
            "/edges/0/information",
            json!([1, 0, 0, 1, 0]),
            400,
            "invalid-field",
        ),
        case(
            "information that is not finite",
            raw(good().to_string().replacen("4.0", "1e999", 1)),
            422,
            "out-of-range",
            "/edges/0/information/0",
        ),
        case(
            "information that is no number",
            raw(good().to_string().replacen("4.0", "NaN", 1)),
            400,
            "malformed-json",
            "",
        ),
        named(
            "an absurd pose",
            "/nodes/0/pose/x",
            json!(1e7),
            422,
            "out-of-range",
        ),
        named(
            "an absurd motion",
            "/edges/0/measurement/y",
            json!(-1e7),
            422,
            "out-of-range",
        ),
        named(
            "degrees",
            "/nodes/0/pose/theta",
            json!(18_000.0),
            422,
            "out-of-range",
        ),
        case(
            "a stamp of 1969",
            with(
                "/nodes/0",
                json!({"id": "a", "pose": node["pose"], "stamp": "1969-12-31T23:59:59Z"}),
            ),
            422,
            "out-of-range",
            "/nodes/0/stamp",
        ),
        named("too many nodes", "/nodes", many.into(), 413, "too-large"),
        named("too many edges", "/edges", edges.into(), 413, "too-large"),
        named("no vehicle", "/vehicle_id", json!(""), 400, "invalid-field"),
        case(
            "nothing in it",
            Request::new("PUT", PATH).json(&json!({"vehicle_id": "v", "nodes": [], "edges": []})),
            422,
            "edge-graph",
            "/nodes",
        ),
        case(
            "an unknown field",
            Request::new("PUT", PATH)
                .json(&json!({"vehicle_id": "v", "nodes": [], "edges": [], "scans": []})),
            400,
            "malformed-json",
            "",
        ),
        case(
            "not JSON",
            raw("edges".to_owned()),
            400,
            "malformed-json",
            "",
        ),
        case(
            "an unknown route",
            Request::new("PUT", "/v1/routes/nowhere/edge-batches/e").json(&good()),
            404,
            "unknown-route",
            "",
        ),
        case(
            "only PUT",
            Request::new("GET", PATH),
            405,
            "method-not-allowed",
            "",
        ),
    ]
}

#[tokio::test]
async fn bad_edges_get_the_answers_of_the_contract() {
    let service = Service::start().await;
    service.put_route("line-4").await;
    check(&service, cases()).await;
    let route = service.get("/v1/routes/line-4").await.json();
    assert_eq!(route["counts"]["batches"], 0);
    let stored = service.send(Request::new("PUT", PATH).json(&good())).await;
    assert_eq!(stored.status, 202);
    let location = "/v1/routes/line-4/batches/e-1";
    assert_eq!(stored.header("location"), Some(location));
    assert_eq!(stored.json()["kind"], "edges");
    assert_eq!(service.get(location).await.json()["vehicle_id"], "agv-07");
    service.stop().await;
}
