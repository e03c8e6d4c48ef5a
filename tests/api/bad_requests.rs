//! What bad input gets: one table, sent over real sockets and printed.

use serde_json::{Value, json};

use crate::body::{batch, batch_with, gzip, zstd};
use crate::client::Request;
use crate::service::Service;

const BATCH: &str = "/v1/routes/line-4/batches/b-1";

pub struct Case {
    name: &'static str,
    request: Request,
    status: u16,
    problem: &'static str,
    /// The place that must be named; empty for none.
    pointer: &'static str,
}

pub fn case(
    name: &'static str,
    request: Request,
    status: u16,
    problem: &'static str,
    pointer: &'static str,
) -> Case {
    Case {
        name,
        request,
        status,
        problem,
        pointer,
    }
}

fn get(path: &str) -> Request {
    Request::new("GET", path)
}

fn raw(body: impl Into<Vec<u8>>) -> Request {
    Request::new("PUT", BATCH)
        .header("content-type", "application/json")
        .body(body)
}

fn upload(pointer: &str, value: Value) -> Request {
    Request::new("PUT", BATCH).json(&batch_with(pointer, value))
}

/// Four scans whose ranges are a thousand times too long.
fn in_millimetres() -> Value {
    let mut body = batch(0, 4);
    for scan in body["scans"].as_array_mut().unwrap() {
        scan["ranges"] = json!([2000, 2100, 2200, null, 2400, 2500, 2600, 2700]);
    }
    body
}

fn paths_and_parameters() -> Vec<Case> {
    vec![
        case(
            "unknown route",
            get("/v1/routes/nowhere"),
            404,
            "unknown-route",
            "",
        ),
        case(
            "upload to an unknown route",
            Request::new("PUT", "/v1/routes/nowhere/batches/b").json(&batch(0, 1)),
            404,
            "unknown-route",
            "",
        ),
        case(
            "graph of an unknown route",
            get("/v1/routes/nowhere/graph"),
            404,
            "unknown-route",
            "",
        ),
        case(
            "unknown batch",
            get("/v1/routes/line-4/batches/none"),
            404,
            "not-found",
            "",
        ),
        case(
            "unknown node",
            get("/v1/routes/line-4/nodes/7"),
            404,
            "not-found",
            "",
        ),
        case(
            "unknown version",
            get("/v1/routes/line-4/versions/7/map.png"),
            404,
            "not-found",
            "",
        ),
        case(
            "picture of the draft of a route without a map",
            get("/v1/routes/line-4/versions/1/map.pgm"),
            404,
            "not-found",
            "",
        ),
        case(
            "unknown edge",
            get("/v1/routes/line-4/edges/7"),
            404,
            "not-found",
            "",
        ),
        case(
            "unknown trip",
            get("/v1/routes/line-4/trajectories/none"),
            404,
            "not-found",
            "",
        ),
        case(
            "poses that are not there",
            get("/v1/routes/line-4/trajectories/none?poses=some"),
            400,
            "invalid-parameter",
            "",
        ),
        case(
            "poses in TUM text that are not there",
            get("/v1/routes/line-4/trajectories/none/tum?poses="),
            400,
            "invalid-parameter",
            "",
        ),
        case(
            "unknown sub-graph",
            get("/v1/routes/line-4/residuals?subgraph_id=9"),
            404,
            "not-found",
            "",
        ),
        case("unknown path", get("/v2/routes"), 404, "not-found", ""),
        case(
            "path below a resource",
            get("/v1/routes/line-4/"),
            404,
            "not-found",
            "",
        ),
        case(
            "file of the API browser that is not there",
            get("/docs/none.js"),
            404,
            "not-found",
            "",
        ),
        case(
            "method that the path has not",
            Request::new("POST", "/v1/routes"),
            405,
            "method-not-allowed",
            "",
        ),
        case(
            "invented method",
            Request::new("BREW", BATCH),
            405,
            "method-not-allowed",
            "",
        ),
        case(
            "name with a slash",
            get("/v1/routes/a%2Fb"),
            400,
            "invalid-field",
            "",
        ),
        case(
            "name with a dot segment",
            get("/v1/routes/%2e%2e"),
            400,
            "invalid-field",
            "",
        ),
        case(
            "name with NUL",
            get("/v1/routes/%00"),
            400,
            "invalid-field",
            "",
        ),
        case(
            "name that is not UTF-8",
            get("/v1/routes/%ff"),
            400,
            "invalid-field",
            "",
        ),
        case(
            "name with SQL",
            get("/v1/routes/x'%20OR%201=1--"),
            400,
            "invalid-field",
            "",
        ),
        case(
            "name with markup",
            Request::new("PUT", "/v1/routes/%3Cscript%3E"),
            400,
            "invalid-field",
            "",
        ),
        case(
            "name of 65 characters",
            get(&format!("/v1/routes/{}", "x".repeat(65))),
            400,
            "invalid-field",
            "",
        ),
        case(
            "version that is no number",
            get("/v1/routes/line-4/versions/latest/map.yaml"),
            400,
            "invalid-field",
            "",
        ),
        case(
            "node that is no number",
            get("/v1/routes/line-4/nodes/one"),
            400,
            "invalid-field",
            "",
        ),
        case(
            "edge beyond 64 bits",
            get("/v1/routes/line-4/edges/99999999999999999999"),
            400,
            "invalid-field",
            "",
        ),
        case(
            "limit 0",
            get("/v1/routes?limit=0"),
            400,
            "invalid-parameter",
            "limit",
        ),
        case(
            "limit -1",
            get("/v1/routes?limit=-1"),
            400,
            "invalid-parameter",
            "",
        ),
        case(
            "limit 10^9",
            get("/v1/routes?limit=1000000000"),
            400,
            "invalid-parameter",
            "limit",
        ),
        case(
            "limit 10^30",
            get("/v1/routes?limit=1000000000000000000000000000000"),
            400,
            "invalid-parameter",
            "",
        ),
        case(
            "cursor of no list",
            get("/v1/routes?cursor=zz"),
            400,
            "invalid-parameter",
            "cursor",
        ),
        case(
            "box of three numbers",
            get("/v1/routes/line-4/graph?bbox=1,2,3"),
            400,
            "invalid-parameter",
            "bbox",
        ),
        case(
            "box inside out",
            get("/v1/routes/line-4/graph?bbox=5,5,1,1"),
            400,
            "invalid-parameter",
            "bbox",
        ),
        case(
            "unknown parameter",
            get("/v1/routes?colour=red"),
            400,
            "invalid-parameter",
            "",
        ),
        case(
            "unknown parameter where none is taken",
            get("/v1/routes/line-4?x=1"),
            400,
            "invalid-parameter",
            "",
        ),
        case(
            "repeated parameter",
            get("/v1/routes?limit=1&limit=2"),
            400,
            "invalid-parameter",
            "",
        ),
        case(
            "unknown status",
            get("/v1/routes/line-4/batches?status=lost"),
            400,
            "invalid-parameter",
            "",
        ),
        case(
            "vehicle that is no name",
            get("/v1/routes/line-4/batches?vehicle_id=a%20b"),
            400,
            "invalid-parameter",
            "vehicle_id",
        ),
        case(
            "unknown measurement",
            get("/v1/routes/line-4/residuals?measurement=best"),
            400,
            "invalid-parameter",
            "",
        ),
    ]
}

fn routes() -> Vec<Case> {
    let put = |body: Value| Request::new("PUT", "/v1/routes/line-4").json(&body);
    vec![
        case(
            "unknown setting",
            put(json!({"settings": {"colour": 1}})),
            400,
            "malformed-json",
            "/settings/colour",
        ),
        case(
            "unknown detector",
            put(json!({"settings": {"detector": "oracle"}})),
            400,
            "invalid-field",
            "/settings/detector",
        ),
        case(
            "more than one false alert per lap",
            put(json!({"settings": {"false_alarm_rate": 1.01}})),
            422,
            "out-of-range",
            "/settings/false_alarm_rate",
        ),
        case(
            "latitude of 91",
            put(json!({"geo_anchor": {"latitude": 91, "longitude": 0, "heading": 0}})),
            422,
            "out-of-range",
            "/geo_anchor/latitude",
        ),
        case(
            "name of 201 characters",
            put(json!({"display_name": "x".repeat(201)})),
            422,
            "out-of-range",
            "/display_name",
        ),
        case(
            "route that is no object",
            put(json!([])),
            400,
            "invalid-field",
            "",
        ),
        case(
            "route of 1 MB",
            put(json!({"display_name": "x".repeat(1 << 20)})),
            413,
            "too-large",
            "",
        ),
        case(
            "route as a form",
            Request::new("PUT", "/v1/routes/line-4")
                .header("content-type", "application/x-www-form-urlencoded")
                .body("a=b"),
            415,
            "unsupported-media-type",
            "",
        ),
        case(
            "stale If-Match",
            put(json!({})).header("if-match", "\"0-0\""),
            412,
            "precondition-failed",
            "",
        ),
    ]
}

fn encodings() -> Vec<Case> {
    let plain = batch(0, 2).to_string();
    let zipped = gzip(plain.as_bytes());
    let trailing = [zstd(plain.as_bytes()), b"more".to_vec()].concat();
    let no_type = Request::new("PUT", BATCH).body(plain.clone());
    let typed = |media_type: &str| no_type.clone().header("content-type", media_type);
    vec![
        case(
            "no media type",
            no_type.clone(),
            415,
            "unsupported-media-type",
            "",
        ),
        case(
            "another media type",
            typed("text/plain"),
            415,
            "unsupported-media-type",
            "",
        ),
        case(
            "another character set",
            typed("application/json; charset=latin1"),
            415,
            "unsupported-media-type",
            "",
        ),
        case(
            "another encoding",
            raw(plain.clone()).header("content-encoding", "br"),
            415,
            "unsupported-encoding",
            "",
        ),
        case(
            "two encodings",
            raw(plain.clone()).header("content-encoding", "gzip, gzip"),
            415,
            "unsupported-encoding",
            "",
        ),
        case(
            "gzip that is none",
            raw(plain.clone()).header("content-encoding", "gzip"),
            400,
            "bad-encoding",
            "",
        ),
        case(
            "gzip cut short",
            raw(zipped[..zipped.len() - 5].to_vec()).header("content-encoding", "gzip"),
            400,
            "bad-encoding",
            "",
        ),
        case(
            "bytes after zstd",
            raw(trailing).header("content-encoding", "zstd"),
            400,
            "bad-encoding",
            "",
        ),
        case(
            "gzip bomb",
            raw(gzip(&vec![b' '; 64 << 20])).header("content-encoding", "gzip"),
            413,
            "too-large",
            "",
        ),
        case(
            "zstd bomb",
            raw(zstd(&vec![b' '; 64 << 20])).header("content-encoding", "zstd"),
            413,
            "too-large",
            "",
        ),
        case(
            "20 MB announced",
            raw("{}").header("content-length", "20000000"),
            413,
            "too-large",
            "",
        ),
        case(
            "digest of other bytes",
            raw(plain.clone()).header("content-digest", "sha-256=:AAAA:"),
            400,
            "digest-mismatch",
            "",
        ),
        case(
            "digest that is none",
            raw(plain).header("content-digest", "sha-256"),
            400,
            "digest-mismatch",
            "",
        ),
    ]
}

fn documents() -> Vec<Case> {
    let text = batch(0, 2).to_string();
    let literal = |literal: &str| raw(text.replacen("2.0", literal, 1));
    let duplicate = text.replacen("{", "{\"sequence\":0,", 1);
    let not_utf8 = [text.replace("agv-07", "").as_bytes(), b"\xff"].concat();
    let deep = format!("{}1{}", "[".repeat(17), "]".repeat(17));
    vec![
        case("empty body", raw(""), 400, "malformed-json", ""),
        case("no JSON", raw("hello"), 400, "malformed-json", ""),
        case(
            "JSON cut short",
            raw(&text.as_bytes()[..text.len() - 1]),
            400,
            "malformed-json",
            "",
        ),
        case(
            "two documents",
            raw(format!("{text}{text}")),
            400,
            "malformed-json",
            "",
        ),
        case("deeper than 16", raw(deep), 400, "malformed-json", ""),
        case(
            "100,000 brackets",
            raw("[".repeat(100_000)),
            400,
            "malformed-json",
            "",
        ),
        case("field twice", raw(duplicate), 400, "malformed-json", ""),
        case(
            "unknown field",
            upload("/colour", json!("red")),
            400,
            "malformed-json",
            "/colour",
        ),
        case("no UTF-8", raw(not_utf8), 400, "malformed-json", ""),
        case(
            "NaN",
            literal("NaN"),
            400,
            "malformed-json",
            "/scans/0/ranges/0",
        ),
        case(
            "Infinity",
            literal("Infinity"),
            400,
            "malformed-json",
            "/scans/0/ranges/0",
        ),
        case("no object", raw("[]"), 400, "invalid-field", ""),
        case(
            "missing field",
            raw("{\"vehicle_id\":\"v\"}"),
            400,
            "invalid-field",
            "",
        ),
        case(
            "lidar and lidars",
            upload("/lidars", json!([])),
            400,
            "invalid-field",
            "/lidars",
        ),
        case(
            "a scan's lidar without lidars",
            upload("/scans/1/lidar", json!("rear")),
            400,
            "malformed-json",
            "/scans/1/lidar",
        ),
        case(
            "wrong type",
            upload("/sequence", json!("one")),
            400,
            "invalid-field",
            "/sequence",
        ),
        case(
            "vehicle with markup",
            upload("/vehicle_id", json!("<script>")),
            400,
            "invalid-field",
            "/vehicle_id",
        ),
        case(
            "trip with SQL",
            upload("/trip_id", json!("'; DROP TABLE route; --")),
            400,
            "invalid-field",
            "/trip_id",
        ),
        case(
            "time that is none",
            upload("/scans/0/stamp", json!("noon")),
            400,
            "invalid-field",
            "/scans/0/stamp",
        ),
    ]
}

fn scans() -> Vec<Case> {
    let scan = |beams: usize| json!({"stamp": "2026-11-20T06:00:00Z", "odometry": {"x": 0, "y": 0, "theta": 0}, "ranges": vec![1; beams]});
    vec![
        case(
            "no scans",
            upload("/scans", json!([])),
            422,
            "scan-geometry",
            "/scans",
        ),
        case(
            "5,001 scans",
            upload("/scans", json!(vec![scan(1); 5_001])),
            422,
            "scan-geometry",
            "/scans",
        ),
        case(
            "no beams",
            upload("/scans/0/ranges", json!([])),
            422,
            "scan-geometry",
            "/scans/0/ranges",
        ),
        case(
            "8,193 beams",
            upload("/scans", json!([scan(8_193)])),
            422,
            "scan-geometry",
            "/scans/0/ranges",
        ),
        case(
            "4,008,000 beams in all",
            upload("/scans", json!(vec![scan(8_000); 501])),
            413,
            "too-large",
            "/scans",
        ),
        case(
            "beams that differ",
            upload("/scans/1/ranges", json!([1.0, 2.0])),
            422,
            "scan-geometry",
            "/scans/1/ranges",
        ),
        case(
            "increment in degrees",
            upload("/lidar/angle_increment", json!(1.0)),
            422,
            "scan-geometry",
            "/lidar/angle_increment",
        ),
        case(
            "increment 0",
            upload("/lidar/angle_increment", json!(0)),
            422,
            "scan-geometry",
            "/lidar/angle_increment",
        ),
        case(
            "angle_min in degrees",
            upload("/lidar/angle_min", json!(-180)),
            422,
            "scan-geometry",
            "/lidar/angle_min",
        ),
        case(
            "angle_max below angle_min",
            upload("/lidar/angle_max", json!(-3.1)),
            422,
            "scan-geometry",
            "/lidar/angle_max",
        ),
        case(
            "range_min above range_max",
            upload("/lidar/range_min", json!(30)),
            422,
            "scan-geometry",
            "/lidar/range_min",
        ),
        case(
            "range_max in millimetres",
            upload("/lidar/range_max", json!(20_000)),
            422,
            "scan-geometry",
            "/lidar/range_max",
        ),
        case(
            "ranges in millimetres",
            Request::new("PUT", BATCH).json(&in_millimetres()),
            422,
            "out-of-range",
            "/scans/0/ranges",
        ),
        case(
            "extensions that are no object",
            upload("/extensions", json!([1])),
            400,
            "invalid-field",
            "/extensions",
        ),
        case(
            "extensions of 20 KiB",
            upload("/extensions", json!({"log": "x".repeat(20 << 10)})),
            422,
            "out-of-range",
            "/extensions",
        ),
        case(
            "extensions of a scan",
            upload("/scans/0/extensions", json!({})),
            400,
            "malformed-json",
            "/scans/0/extensions",
        ),
        case(
            "Unix milliseconds",
            upload("/scans/0/stamp", json!(1_795_154_400_000_i64)),
            400,
            "invalid-field",
            "/scans/0/stamp",
        ),
        case(
            "a stamp as ROS has it",
            upload(
                "/scans/0/stamp",
                json!({"sec": 1_795_154_400, "nanosec": 0}),
            ),
            400,
            "invalid-field",
            "/scans/0/stamp",
        ),
        case(
            "odometry 1e39",
            upload("/scans/1/odometry/x", json!(1e39)),
            422,
            "out-of-range",
            "/scans/1/odometry/x",
        ),
        case(
            "odometry 1e400",
            raw(batch(0, 1)
                .to_string()
                .replacen("\"x\":0.0", "\"x\":1e400", 1)),
            422,
            "out-of-range",
            "/scans/0/odometry/x",
        ),
        case(
            "time before 1970",
            upload("/scans/0/stamp", json!("1969-12-31T23:59:59Z")),
            422,
            "out-of-range",
            "/scans/0/stamp",
        ),
        case(
            "time after 2100",
            upload("/scans/1/stamp", json!("2100-01-01T00:00:00Z")),
            422,
            "out-of-range",
            "/scans/1/stamp",
        ),
        case(
            "times that stand still",
            upload("/scans/1/stamp", json!("2026-11-20T06:00:00Z")),
            422,
            "timestamp-order",
            "/scans/1/stamp",
        ),
    ]
}

#[tokio::test]
async fn bad_input_gets_the_answers_of_the_contract() {
    let service = Service::start().await;
    service.put_route("line-4").await;
    let groups = [
        paths_and_parameters(),
        routes(),
        encodings(),
        documents(),
        scans(),
    ];
    check(&service, groups.into_iter().flatten()).await;
    assert_eq!(service.get("/readyz").await.status, 200);
    service.stop().await;
}

/// Sends every request, prints the answers as a table, and fails with all that are wrong.
pub async fn check(service: &Service, cases: impl IntoIterator<Item = Case>) {
    let mut failures = Vec::new();
    println!("| input | answer | type | place |\n|---|---|---|---|");
    for case in cases {
        let answer = service.send(case.request).await;
        let problem = answer.problem();
        let body = answer.json();
        let pointer = body["errors"][0]["pointer"].as_str().unwrap_or_default();
        println!(
            "| {} | {} | {problem} | {pointer} |",
            case.name, answer.status
        );
        let seen = (answer.status, problem.as_str(), pointer);
        let wanted = (case.status, case.problem, case.pointer);
        // A place that is not asked for may still be named.
        let place_wanted = !case.pointer.is_empty() && pointer != case.pointer;
        if (seen.0, seen.1) != (wanted.0, wanted.1) || place_wanted {
            failures.push(format!(
                "{}: {seen:?} instead of {wanted:?}: {body}",
                case.name
            ));
        }
        check_headers(case.name, answer.status, &problem, |name| {
            answer.header(name)
        });
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

fn check_headers<'a>(
    name: &str,
    status: u16,
    problem: &str,
    header: impl Fn(&str) -> Option<&'a str>,
) {
    let needed = match (status, problem) {
        (405, _) => "allow",
        (415, "unsupported-media-type") => "accept",
        (415, "unsupported-encoding") => "accept-encoding",
        _ => return,
    };
    assert!(
        header(needed).is_some_and(|value| !value.is_empty()),
        "{name} has no {needed}"
    );
}
