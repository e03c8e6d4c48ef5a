//! Trips and graphs that no map can be made of: each batch ends with a status, in time, and nothing
//! that is reported is without end.

use std::collections::BTreeMap;
use std::f64::consts::TAU;
use std::time::{Duration, Instant};

use mapshift::geometry::{Pose2, Vector2};
use mapshift::sim::{Hall, Route, Shape, World};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::client::Client;
use crate::drives::{Batch, Drive, first_vehicle, two_vehicles};
use crate::fsck;
use crate::process::Process;
use crate::row::{Finding, Form, Row, nothing_in_the_way, run};
use crate::spoiled::{blind, wild};

pub const ROW: Row = Row {
    name: "odd-maps",
    shows: "corridors, empty scans, wild odometry, false closures, torn and huge graphs: a status, finite numbers",
    obstacle: nothing_in_the_way,
    run: |form| run(odd_maps(form)),
};

/// A batch must have ended so soon after the last one was sent, or after the one before it: as long
/// as the service allows a job of a small body.
const BUDGET: Duration = Duration::from_secs(60);
const POLL: Duration = Duration::from_millis(10);
const SCANS: usize = 12;
/// Nodes of a batch of edges, and of a lap.
const NODES: usize = 1_000;
/// Reads of a route, all of which must be answered.
const READS: [&str; 6] = [
    "map.png",
    "map.yaml",
    "graph.g2o",
    "residuals",
    "subgraphs",
    "trajectories/one",
];
/// Statuses of batches that somebody still works on.
const UNDER_WAY: [&str; 3] = ["queued", "processing", "held"];

/// What is sent to a route of its own.
enum Uploads {
    Scans(Vec<Batch>),
    Edges(Vec<Value>),
}

async fn odd_maps(form: Form) -> Finding {
    let directory = TempDir::new().unwrap();
    let process = Process::start(directory.path());
    let client = Client::new(&process.url);
    let mut finding = Finding::default();
    for (name, uploads) in cases(form.choose(2_000, 100_000)) {
        client.put_route(name, Value::Null).await;
        let (statuses, longest, faults) = ends(&client, name, &uploads).await;
        finding.figure(format!(
            "{name}: {statuses:?}, the longest wait {:.1} s",
            longest.as_secs_f64()
        ));
        finding.faults.extend(faults);
        let graph = client.json(&format!("/v1/routes/{name}/graph")).await;
        finding.faults.extend(
            numbers(&graph)
                .into_iter()
                .map(|fault| format!("{name}: {fault}")),
        );
        finding.faults.extend(reads(&client, name).await);
    }
    finding.faults.extend(fsck::faults(directory.path()));
    // As JSON tells numbers without end.
    let broken =
        json!({"nodes": [{"id": 1, "pose": {"x": null, "y": 0.0, "theta": 0.0}}], "edges": []});
    finding.control = numbers(&broken);
    finding
}

/// Names, which are routes, and what is sent to them; the largest graph has this many nodes.
fn cases(nodes: usize) -> Vec<(&'static str, Uploads)> {
    let [first, _] = two_vehicles(48);
    let drive = first.batches(SCANS);
    vec![
        ("corridor", Uploads::Scans(corridor().batches(SCANS))),
        ("empty", Uploads::Scans(drive.iter().map(blind).collect())),
        ("wild", Uploads::Scans(drive.iter().map(wild).collect())),
        ("false-closures", Uploads::Edges(laps(3 * 200, 200, 0.4))),
        ("singular", Uploads::Edges(vec![singular()])),
        ("torn", Uploads::Edges(vec![chain(0..50), chain(100..150)])),
        ("huge", Uploads::Edges(laps(nodes, NODES, 0.0))),
    ]
}

/// A drive in a corridor whose ends are out of sight.
fn corridor() -> Drive {
    let wall = |y| Shape::rectangle(&Pose2::new(100.0, y, 0.0), 200.0, 0.2);
    let corners = [(60.0, 1.2), (140.0, 1.2), (140.0, 2.8), (60.0, 2.8)];
    let corners = corners.map(|(x, y)| Vector2::new(x, y));
    let hall = Hall {
        world: World::new([wall(0.0), wall(4.0)]),
        route: Route::new(&corners, 0.7).unwrap(),
    };
    Drive::through(&hall, &first_vehicle(), ("agv-01", "one"), 72, 3)
}

fn pose(x: f64, y: f64, theta: f64) -> Value {
    json!({"x": x, "y": y, "theta": theta})
}

fn upload(nodes: Vec<Value>, edges: Vec<Value>) -> Value {
    json!({"vehicle_id": "agv-01", "trip_id": "one", "nodes": nodes, "edges": edges})
}

fn edge(kind: &str, from: usize, to: usize, measurement: &Value, weight: f64) -> Value {
    json!({
        "kind": kind, "from": from.to_string(), "to": to.to_string(), "measurement": measurement,
        "information": [weight, 0.0, 0.0, weight, 0.0, weight],
    })
}

/// Laps round a circle, a batch a lap, with a closure of every tenth node to the first lap; such a
/// share of them is false.
fn laps(nodes: usize, lap: usize, false_share: f64) -> Vec<Value> {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let step = TAU / lap as f64;
    let motion = pose(1.0, 0.0, step);
    let node = |k: usize| json!({"id": k, "pose": pose(k as f64, 0.0, 0.0)});
    let of_lap = |first: usize| {
        let ends = first..nodes.min(first + lap);
        let mut edges = Vec::new();
        for k in ends.clone().filter(|k| *k > 0) {
            edges.push(edge("odometry", k - 1, k, &motion, 400.0));
            if k >= lap && k % 10 == 0 {
                let off_m = if rng.random_bool(false_share) {
                    rng.random_range(2.0..50.0)
                } else {
                    0.0
                };
                edges.push(edge(
                    "loop_closure",
                    k % lap,
                    k,
                    &pose(off_m, 0.0, 0.0),
                    400.0,
                ));
            }
        }
        upload(ends.map(node).collect(), edges)
    };
    (0..nodes).step_by(lap).map(of_lap).collect()
}

/// Nodes on one spot, with weights from next to none to all there is, and one closure again and again.
fn singular() -> Value {
    let still = pose(0.0, 0.0, 0.0);
    let nodes = (0..30).map(|k| json!({"id": k, "pose": still}));
    let weights = [1e-9, 1.0, 1e12];
    let mut edges: Vec<Value> = (1..30)
        .map(|k| edge("odometry", k - 1, k, &still, weights[k % weights.len()]))
        .collect();
    edges.extend((0..20).map(|_| edge("loop_closure", 0, 29, &pose(1e-9, 0.0, 3.0), 1e12)));
    upload(nodes.collect(), edges)
}

/// A chain that hangs on nothing.
fn chain(names: std::ops::Range<usize>) -> Value {
    let nodes = names
        .clone()
        .map(|k| json!({"id": k, "pose": pose(k as f64, 0.0, 0.0)}));
    let edges = names.clone().skip(1);
    let edges = edges.map(|k| edge("odometry", k - 1, k, &pose(1.0, 0.0, 0.0), 400.0));
    upload(nodes.collect(), edges.collect())
}

/// How batches ended, the longest time that one took, and what is wrong with that.
async fn ends(
    client: &Client,
    route: &str,
    uploads: &Uploads,
) -> (BTreeMap<String, usize>, Duration, Vec<String>) {
    let mut faults = Vec::new();
    let ids: Vec<String> = match uploads {
        Uploads::Scans(batches) => {
            client.put_all(route, batches).await;
            batches.iter().map(|batch| batch.id.clone()).collect()
        }
        Uploads::Edges(batches) => {
            for (k, batch) in batches.iter().enumerate() {
                let (status, answer) = client.put_edges(route, &format!("e-{k}"), batch).await;
                if status != 202 {
                    faults.push(format!("{route}: e-{k} got {status}: {answer}"));
                }
            }
            (0..batches.len()).map(|k| format!("e-{k}")).collect()
        }
    };
    let (mut statuses, mut longest) = (BTreeMap::new(), Duration::ZERO);
    for id in ids {
        let began = Instant::now();
        let status = loop {
            let (_, batch) = client
                .get_any(&format!("/v1/routes/{route}/batches/{id}"))
                .await;
            let status = batch["status"].as_str().unwrap_or("missing").to_owned();
            if !UNDER_WAY.contains(&status.as_str()) {
                break status;
            }
            if began.elapsed() > BUDGET {
                faults.push(format!("{route}: {id} is still {status} after {BUDGET:?}"));
                break status;
            }
            tokio::time::sleep(POLL).await;
        };
        longest = longest.max(began.elapsed());
        *statuses.entry(status).or_default() += 1;
    }
    (statuses, longest, faults)
}

/// Numbers of a graph that are none.
fn numbers(graph: &Value) -> Vec<String> {
    let is_pose = |pose: &Value| ["x", "y", "theta"].iter().all(|field| pose[field].is_f64());
    let nodes = graph["nodes"].as_array().unwrap().iter();
    let nodes = nodes.filter(|node| !is_pose(&node["pose"]));
    let edges = graph["edges"].as_array().unwrap().iter();
    let edges = edges.filter(|edge| !is_pose(&edge["measurement"]) || !edge["residual"].is_f64());
    nodes
        .chain(edges)
        .map(|what| format!("it has no number: {what}"))
        .collect()
}

/// Reads of a route that are not answered, or tell numbers without end.
async fn reads(client: &Client, route: &str) -> Vec<String> {
    let mut faults = Vec::new();
    for read in READS {
        let path = format!("/v1/routes/{route}/{read}");
        let status = client.status_of(&path).await.as_u16();
        if ![200, 404].contains(&status) {
            faults.push(format!("{path} got {status}"));
        }
    }
    let g2o = client
        .text(&format!("/v1/routes/{route}/graph.g2o"))
        .await
        .to_lowercase();
    if g2o.contains("nan") || g2o.contains("inf") {
        faults.push(format!("{route}: graph.g2o has numbers without end"));
    }
    faults
}
