//! Random requests over HTTP: nothing panics, and every answer is one that the interface describes.

use std::collections::BTreeMap;

use axum::http::StatusCode;
use axum::response::IntoResponse;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use reqwest::Method;
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::client::Client;
use crate::drives::two_vehicles;
use crate::fsck;
use crate::interface::{Operation, operations};
use crate::process::Process;
use crate::row::{Finding, Form, Row, nothing_in_the_way, run};
use crate::stub;

pub const ROW: Row = Row {
    name: "random-http",
    shows: "mutated uploads and random requests: no 5xx, no status that the interface does not describe",
    obstacle: nothing_in_the_way,
    run: |form| run(random_http(form)),
};

/// What stands in paths and queries.
const VALUES: [&str; 18] = [
    "line",
    "line",
    "line",
    "b-1",
    "one",
    "agv-01",
    "1",
    "0",
    "-1",
    "1000000000000000000000",
    "NaN",
    "true",
    "2026-11-20T06:00:00Z",
    "0,0,1,1",
    "%00",
    "..%2F..%2Fetc%2Fpasswd",
    "%27%20OR%201=1--",
    "%3Cscript%3E%F0%9F%98%80",
];
/// What bodies of small requests are made of.
const BODIES: [&str; 9] = [
    "{}",
    "null",
    "{\"settings\":{\"hold_s\":5}}",
    "{\"settings\":{\"hold_s\":-1e39}}",
    "{\"by\":\"A. Keeper\",\"note\":\"'; DROP TABLE batches; --\"}",
    "{\"trip_id\":\"one\"}",
    "{\"url\":\"https://127.0.0.1/hook\",\"events\":[\"alert.raised\"]}",
    "{\"vehicle_id\":\"agv-01\",\"reason\":\"\\u0000\"}",
    "[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[]]]]]]]]]]]]]]]]]]]]]]]]]]]]]]]]]]]]",
];
const ENCODINGS: [&str; 4] = ["gzip", "zstd", "br", "identity"];
const MEDIA_TYPES: [&str; 4] = [
    "application/json",
    "text/plain",
    "application/json; charset=utf-16",
    "",
];
/// After this many requests the route is made again, should it have been deleted.
const ROUTE_EVERY: usize = 50;

/// A request that is sent, and the operation that it is one of.
struct Attempt<'a> {
    operation: &'a Operation,
    path: String,
    headers: Vec<(&'static str, String)>,
    body: Vec<u8>,
}

async fn random_http(form: Form) -> Finding {
    let requests = form.choose(500, 100_000);
    let directory = TempDir::new().unwrap();
    let process = Process::start(directory.path());
    let mut finding = Finding::default();
    let (answered, faults) = answers(&process.url, requests, 5).await;
    finding.faults = faults;
    let readiness = Client::new(&process.url).status_of("/readyz").await;
    finding.expect(readiness == 200, || {
        format!("afterwards /readyz says {readiness}")
    });
    finding.faults.extend(fsck::faults(directory.path()));
    let kinds: Vec<String> = answered
        .iter()
        .map(|(status, count)| format!("{count} × {status}"))
        .collect();
    finding.figure(format!("{requests} requests: {}", kinds.join(", ")));
    let stub = stub::answering(|| StatusCode::IM_A_TEAPOT.into_response()).await;
    finding.control = answers(&stub, 5, 5).await.1;
    finding
}

/// How often each status was answered, and answers that should not be.
async fn answers(url: &str, requests: usize, seed: u64) -> (BTreeMap<u16, usize>, Vec<String>) {
    let http = mapshift::http_client::builder().no_proxy().build().unwrap();
    let operations = operations();
    let uploads = uploads();
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let (mut answered, mut faults) = (BTreeMap::new(), Vec::new());
    for number in 0..requests {
        if number % ROUTE_EVERY == 0 {
            let route = http.put(format!("{url}/v1/routes/line"));
            let _ = route.json(&json!({})).send().await;
        }
        let attempt = attempt(&operations, &uploads, &mut rng);
        let method: Method = attempt.operation.method.to_uppercase().parse().unwrap();
        let mut request = http.request(method, format!("{url}{}", attempt.path));
        for (name, value) in &attempt.headers {
            request = request.header(*name, value);
        }
        let reported = format!("{} {}", attempt.operation.method, attempt.path);
        match request.body(attempt.body).send().await {
            Ok(answer) => {
                let status = answer.status().as_u16();
                *answered.entry(status).or_default() += 1;
                if status >= 500 || !attempt.operation.statuses.contains(&status) {
                    faults.push(format!("{reported} got {status}"));
                }
                let _ = answer.bytes().await;
            }
            Err(error) => faults.push(format!("{reported} got no answer: {error}")),
        }
    }
    (answered, faults)
}

/// Valid uploads: of scans, and of edges.
fn uploads() -> Vec<(&'static str, Vec<u8>)> {
    let scans = two_vehicles(6).map(|drive| drive.batches(3)).concat();
    let mut uploads: Vec<(&str, Vec<u8>)> = scans
        .into_iter()
        .map(|batch| ("/v1/routes/{route}/batches/{batch}", batch.body))
        .collect();
    let edges: Value = json!({
        "vehicle_id": "agv-03", "trip_id": "edges",
        "nodes": [
            {"id": 1, "pose": {"x": 0.0, "y": 0.0, "theta": 0.0}, "stamp": "2026-11-20T06:00:00Z"},
            {"id": 2, "pose": {"x": 1.0, "y": 0.0, "theta": 0.1}, "stamp": "2026-11-20T06:00:01Z"},
        ],
        "edges": [{
            "kind": "odometry", "from": "1", "to": "2", "measurement": {"x": 1.0, "y": 0.0, "theta": 0.1},
            "information": [100.0, 0.0, 0.0, 100.0, 0.0, 400.0]
        }],
    });
    uploads.push((
        "/v1/routes/{route}/edge-batches/{batch}",
        edges.to_string().into_bytes(),
    ));
    uploads
}

fn attempt<'a>(
    operations: &'a [Operation],
    uploads: &[(&'static str, Vec<u8>)],
    rng: &mut ChaCha8Rng,
) -> Attempt<'a> {
    let is_upload = rng.random_bool(0.67);
    let (operation, body) = if is_upload {
        let (path, body) = &uploads[rng.random_range(0..uploads.len())];
        let is_it = |o: &&Operation| o.path == *path && o.method == "put";
        (operations.iter().find(is_it).unwrap(), mutated(body, rng))
    } else {
        let operation = &operations[rng.random_range(0..operations.len())];
        let body = BODIES[rng.random_range(0..BODIES.len())].as_bytes();
        (
            operation,
            if operation.has_body {
                mutated(body, rng)
            } else {
                Vec::new()
            },
        )
    };
    let mut headers = Vec::new();
    if !body.is_empty() {
        let media = if rng.random_bool(0.9) {
            MEDIA_TYPES[0]
        } else {
            one_of(&MEDIA_TYPES, rng)
        };
        headers.push(("content-type", media.to_owned()));
    }
    if rng.random_bool(0.1) {
        headers.push(("content-encoding", one_of(&ENCODINGS, rng).to_owned()));
    }
    if rng.random_bool(0.05) {
        headers.push(("content-digest", "sha-256=:AAAA:".to_owned()));
    }
    if rng.random_bool(0.2) {
        headers.push(("if-match", "\"1\"".to_owned()));
    }
    Attempt {
        operation,
        path: path(operation, is_upload, rng),
        headers,
        body,
    }
}

fn one_of<'a>(values: &[&'a str], rng: &mut ChaCha8Rng) -> &'a str {
    values[rng.random_range(0..values.len())]
}

/// The operation's path with values for names, and some of its parameters.
fn path(operation: &Operation, is_upload: bool, rng: &mut ChaCha8Rng) -> String {
    let mut path = String::new();
    for (place, part) in operation.path.split('/').enumerate() {
        if place > 0 {
            path.push('/');
        }
        match part.strip_prefix('{') {
            Some("route}") if is_upload || rng.random_bool(0.8) => path.push_str("line"),
            Some("batch}") if is_upload => {
                path.push_str(&format!("b-{}", rng.random_range(0..100_000)))
            }
            Some(_) => path.push_str(one_of(&VALUES, rng)),
            None => path.push_str(part),
        }
    }
    let mut separator = '?';
    for name in &operation.query {
        if rng.random_bool(0.3) {
            path.push_str(&format!("{separator}{name}={}", one_of(&VALUES, rng)));
            separator = '&';
        }
    }
    path
}

/// Bytes with a few of them replaced, a digit in another place, or an end cut off; some as they are.
fn mutated(body: &[u8], rng: &mut ChaCha8Rng) -> Vec<u8> {
    let mut body = body.to_vec();
    match rng.random_range(0..6) {
        0 => {}
        1 => body.truncate(rng.random_range(0..=body.len())),
        2 => {
            for _ in 0..rng.random_range(1..6) {
                let place = rng.random_range(0..body.len());
                body[place] = rng.random();
            }
        }
        3 => {
            let (from, to) = (
                rng.random_range(0..body.len()),
                rng.random_range(0..body.len()),
            );
            let part: Vec<u8> = body.iter().skip(from).take(40).copied().collect();
            body.splice(to..to, part);
        }
        _ => {
            // Still JSON, mostly: other numbers.
            let digits: Vec<usize> = (0..body.len())
                .filter(|k| body[*k].is_ascii_digit())
                .collect();
            for _ in 0..rng.random_range(1..4) {
                if let Some(place) = digits.get(rng.random_range(0..digits.len().max(1))) {
                    body[*place] = b"0123456789e-."[rng.random_range(0..13)];
                }
            }
        }
    }
    body
}
