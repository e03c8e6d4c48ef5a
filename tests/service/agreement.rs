//! Everything that is reported of one route agrees with everything else.

use std::collections::{BTreeMap, BTreeSet};

use jiff::Timestamp;
use mapshift::geometry::wrap_angle;
use mapshift::ingest::g2o::read_g2o;
use serde_json::Value;

use crate::client::Client;
use crate::drives::{Batch, HALL, interleaved, two_vehicles};
use crate::running::Running;
use crate::state::{State, pose_of};

const ROUTE: &str = "/v1/routes/line";
const BATCHES_A_DRIVE: usize = 8;

/// Two numbers that were summed in another order.
fn close(a: f64, b: f64) -> bool {
    (a - b).abs() <= 1e-6 * a.abs().max(b.abs())
}

fn sum(values: &[Value], field: &str) -> f64 {
    values.iter().filter_map(|v| v[field].as_f64()).sum()
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_reported_of_a_map_agrees() {
    let service = Running::start().await;
    let client = &service.client;
    client.put_route("line", Value::Null).await;
    let drives = two_vehicles(160);
    let batches: Vec<Vec<Batch>> = drives.iter().map(|d| d.batches(20)).collect();
    client.put_all("line", &interleaved(&batches)).await;
    let reported = client.merged("line").await;
    assert_eq!(reported.len(), 2 * BATCHES_A_DRIVE);

    let state = State::of(client, "line").await;
    counts_agree(client, &state, &reported).await;
    lists_are_the_graph(client, &state).await;
    residuals_are_the_graph(client, &state).await;
    g2o_is_the_graph(client, &state).await;
    trajectories_are_the_drives(client, &state).await;
    poses_are_the_truth(&state);
    pictures_decode(client).await;
    service.stop().await;
}

async fn counts_agree(client: &Client, state: &State, reported: &[Value]) {
    let route = client.json(ROUTE).await;
    let counts = &route["counts"];
    let of_kind = |kind: &str| state.edges.iter().filter(|e| e["kind"] == kind).count();
    let (odometry, closures) = (of_kind("odometry"), of_kind("loop_closure"));
    assert!(closures > 100, "{closures}");
    assert_eq!(odometry + closures, state.edges.len());
    assert_eq!(
        odometry,
        state.nodes.len() - 2,
        "one odometry edge a node but for trips' first"
    );
    assert_eq!(counts["batches"], reported.len());
    assert_eq!(counts["scans"], 2 * 160);
    assert_eq!(counts["vehicles"], 2);
    assert_eq!(counts["nodes"], state.nodes.len());
    assert_eq!(counts["edges"], state.edges.len());
    assert_eq!(counts["loop_closures"], closures);
    assert_eq!(sum(reported, "scans"), 320.0);
    assert_eq!(sum(reported, "nodes_added"), state.nodes.len() as f64);
    assert_eq!(sum(reported, "loop_closures"), closures as f64);
    for batch in reported {
        let of_batch = |value: &&Value| value["batch_id"] == batch["id"];
        let nodes = state.nodes.iter().filter(of_batch).count();
        assert_eq!(batch["nodes_added"], nodes, "{batch}");
        let closures = state.edges.iter().filter(of_batch);
        let closures = closures.filter(|e| e["kind"] == "loop_closure").count();
        assert_eq!(batch["loop_closures"], closures, "{batch}");
    }
}

async fn lists_are_the_graph(client: &Client, state: &State) {
    assert_eq!(client.list(&format!("{ROUTE}/nodes"), 7).await, state.nodes);
    assert_eq!(
        client.list(&format!("{ROUTE}/edges"), 1_000).await,
        state.edges
    );
    let ids = |values: &[Value]| -> Vec<i64> {
        values.iter().map(|v| v["id"].as_i64().unwrap()).collect()
    };
    let nodes = ids(&state.nodes);
    for id in [ids(&state.edges), nodes.clone()] {
        assert!(id.windows(2).all(|w| w[0] < w[1]), "ids are not by id");
    }
    let nodes: BTreeSet<i64> = nodes.into_iter().collect();
    for edge in &state.edges {
        let end = |field: &str| edge[field].as_i64().unwrap();
        assert!(nodes.contains(&end("from")) && nodes.contains(&end("to")));
        assert!(end("from") < end("to"), "a closure is from old to new");
        let (from, to) = (node(state, end("from")), node(state, end("to")));
        assert_eq!(edge["batch_id"], to["batch_id"]);
        let odometry = edge["kind"] == "odometry";
        assert!(!odometry || from["trip_id"] == to["trip_id"]);
    }
}

fn node(state: &State, id: i64) -> &Value {
    state.nodes.iter().find(|n| n["id"] == id).unwrap()
}

/// F is what the closures added to it.
async fn residuals_are_the_graph(client: &Client, state: &State) {
    let active: Vec<Value> = state.edges.clone();
    assert!(active.iter().all(|e| e["status"] == "active"));
    let (total, added) = (sum(&active, "residual"), sum(&active, "delta_f"));
    assert!(total > 1.0 && close(total, added), "{total} {added}");

    let series = client.json(&format!("{ROUTE}/residuals")).await;
    let entries = series["entries"].as_array().unwrap();
    let closures = active.iter().filter(|e| e["kind"] == "loop_closure");
    for (k, (entry, edge)) in entries.iter().zip(closures.clone()).enumerate() {
        assert_eq!(entry["n"], k + 1);
        assert_eq!(entry["edge_id"], edge["id"]);
        assert_eq!(entry["delta_f"], edge["delta_f"]);
    }
    assert_eq!(entries.len(), closures.count());
    let last = entries.last().unwrap();
    assert!(close(last["total"].as_f64().unwrap(), added), "{last}");

    let subgraphs = client.list(&format!("{ROUTE}/subgraphs"), 10).await;
    let route = client.json(ROUTE).await;
    assert_eq!(route["counts"]["subgraphs"], subgraphs.len());
    assert!(
        close(sum(&subgraphs, "total"), total),
        "bridges add nothing"
    );
    for subgraph in &subgraphs {
        let id = subgraph["id"].as_i64().unwrap();
        let inside = |value: &&Value| value["subgraph_id"] == id;
        assert_eq!(subgraph["edges"], active.iter().filter(inside).count());
        assert_eq!(subgraph["nodes"], state.nodes.iter().filter(inside).count());
        let path = format!("{ROUTE}/residuals?subgraph_id={id}");
        let series = client.json(&path).await;
        let entries = series["entries"].as_array().unwrap();
        assert_eq!(subgraph["loop_closures"], entries.len());
        let own = active
            .iter()
            .filter(inside)
            .filter_map(|e| e["delta_f"].as_f64());
        let last = entries.last().unwrap()["total"].as_f64().unwrap();
        assert!(close(last, own.sum()), "{last}");
    }
}

async fn g2o_is_the_graph(client: &Client, state: &State) {
    let text = client.text(&format!("{ROUTE}/graph.g2o")).await;
    let read = read_g2o(&text).unwrap();
    assert!(read.without_pose.is_empty());
    assert_eq!(read.graph.nodes().len(), state.nodes.len());
    assert_eq!(read.graph.edges().len(), state.edges.len());
    for (read, reported) in read.graph.nodes().iter().zip(&state.nodes) {
        assert_eq!(reported["id"], read.id.0);
        // The test's own reader of JSON may miss the last bit of a number.
        let apart = pose_of(&reported["pose"]).between(&read.pose);
        assert!(apart.translation().norm() < 1e-12 && apart.theta.abs() < 1e-12);
    }
    let (cost, reported) = (read.graph.cost(), sum(&state.edges, "residual"));
    assert!(close(cost, reported), "{cost} {reported}");
}

async fn trajectories_are_the_drives(client: &Client, state: &State) {
    for drive in two_vehicles(160) {
        let path = format!("{ROUTE}/trajectories/{}", drive.trip);
        let reported = client.json(&path).await;
        let poses = reported["poses"].as_array().unwrap();
        let of_trip = state.nodes.iter().filter(|n| n["trip_id"] == drive.trip);
        let own: Vec<&Value> = of_trip.collect();
        assert_eq!(poses.len(), own.len());
        let tum = client.text(&format!("{path}/tum")).await;
        assert_eq!(tum.lines().count(), own.len());
        for ((pose, node), line) in poses.iter().zip(own).zip(tum.lines()) {
            assert_eq!(pose["node_id"], node["id"]);
            assert_eq!(
                (&pose["stamp"], &pose["pose"]),
                (&node["stamp"], &node["pose"])
            );
            assert_eq!(node["vehicle_id"], drive.vehicle);
            let stamp: Timestamp = node["stamp"].as_str().unwrap().parse().unwrap();
            let (time, numbers) = line.split_once(' ').unwrap();
            let (seconds, nanoseconds) = time.split_once('.').unwrap();
            let nanoseconds: i32 = nanoseconds.parse().unwrap();
            assert_eq!(seconds.parse::<i64>().unwrap(), stamp.as_second());
            assert_eq!(nanoseconds, stamp.subsec_nanosecond());
            let numbers: Vec<f64> = numbers.split(' ').map(|n| n.parse().unwrap()).collect();
            let [x, y, z, qx, qy, qz, qw] = numbers[..] else {
                panic!("{line}");
            };
            let at = pose_of(&node["pose"]);
            assert!((x - at.x).abs() < 1e-6 && (y - at.y).abs() < 1e-6, "{line}");
            assert!([z, qx, qy].iter().all(|v| *v == 0.0), "{line}");
            assert!(
                wrap_angle(2.0 * qz.atan2(qw) - at.theta).abs() < 1e-8,
                "{line}"
            );
        }
        assert!(tum.ends_with('\n'));
        let stamps: BTreeSet<String> = drive
            .scans
            .iter()
            .map(|scan| drive.stamp(scan).to_string())
            .collect();
        let known = |pose: &Value| stamps.contains(pose["stamp"].as_str().unwrap());
        assert!(poses.iter().all(known), "a keyframe has its scan's stamp");
    }
}

fn poses_are_the_truth(state: &State) {
    let drives = two_vehicles(160);
    let truth: BTreeMap<_, _> = drives
        .iter()
        .flat_map(|drive| {
            let keyed = |scan| (drive.trip.to_owned(), drive.stamp(scan).to_string());
            drive
                .scans
                .iter()
                .map(move |scan| (keyed(scan), scan.map_from_base))
        })
        .collect();
    for (key, pose) in state.poses() {
        let error = truth[&key].between(&pose);
        assert!(error.translation().norm() < 0.1, "{key:?} {error:?}");
        assert!(error.theta.abs() < 0.01, "{key:?} {error:?}");
    }
}

async fn pictures_decode(client: &Client) {
    let png = client.bytes(&format!("{ROUTE}/map.png")).await;
    let mut reader = png::Decoder::new(std::io::Cursor::new(png))
        .read_info()
        .unwrap();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut pixels).unwrap();
    let pgm = client.bytes(&format!("{ROUTE}/map.pgm")).await;
    let header = format!("P5\n{} {}\n255\n", info.width, info.height);
    assert!(pgm.starts_with(header.as_bytes()));
    let grey = &pgm[header.len()..];
    assert_eq!(grey.len(), pixels.len());
    // The two have different greys for the same three states.
    let pairs: BTreeSet<(u8, u8)> = pixels.into_iter().zip(grey.iter().copied()).collect();
    assert_eq!(pairs.len(), 3, "{pairs:?}");

    let yaml = client.text(&format!("{ROUTE}/map.yaml")).await;
    let field = |name: &str| {
        let line = yaml.lines().find_map(|line| line.strip_prefix(name));
        line.unwrap_or_else(|| panic!("no {name} in {yaml}")).trim()
    };
    assert_eq!(field("image:"), "map.pgm");
    let resolution: f64 = field("resolution:").parse().unwrap();
    let origin = field("origin:").trim_matches(['[', ']']);
    let origin: Vec<f64> = origin.split(", ").map(|n| n.parse().unwrap()).collect();
    // The route's start is free, and the hall's lower wall, at y = 0 below it, is not.
    let start = HALL.route.pose_at(0.0);
    let at = |x: f64, y: f64| {
        let cell = |v: f64, k: usize| ((v - origin[k]) / resolution).floor() as usize;
        let row = info.height as usize - 1 - cell(y, 1);
        grey[row * info.width as usize + cell(x, 0)]
    };
    assert_eq!(at(start.x, start.y), 254);
    let wall = (-3..=3).map(|k| at(start.x, f64::from(k) * 0.05));
    assert!(
        wall.clone().any(|grey| grey == 0),
        "{:?}",
        wall.collect::<Vec<_>>()
    );
}
