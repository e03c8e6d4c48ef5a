//! Uploads that are formally right and ruinous: what honest vehicles have mapped stays as it is. Each test
//! prints how far it was moved (`--nocapture`).
//!
//! Tested elsewhere: a trip's name that a stranger took, and removals of what was taken in all the same (`removals.rs`), clocks
//! (`changes/raised.rs`, `src/pipeline/tests/clocks.rs`), a trip that cannot be localised and has many
//! batches (`tests/store/lost.rs`), a faulty vehicle (`tests/reliability/faulty_vehicle.rs`).

use std::path::Path;
use std::process::Command;
use std::time::SystemTime;

use mapshift::geometry::Pose2;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};
use sqlx::ConnectOptions;
use sqlx::sqlite::SqliteConnectOptions;
use tempfile::TempDir;

use crate::client::Client;
use crate::drives::{Drive, HALL, second_vehicle, two_vehicles, workshop};
use crate::odd_trips::{ended, with_map};
use crate::process::Process;
use crate::spoiled::with_scans;
use crate::state::{State, pose_of};

/// Gray of an occupied cell in a `map.pgm`.
const OCCUPIED: u8 = 0;

/// A route's map as people and `map_server` get it.
struct Picture {
    width: usize,
    yaml: String,
    cells: Vec<u8>,
}

impl Picture {
    async fn of(client: &Client) -> Self {
        let pgm = client.bytes("/v1/routes/line/map.pgm").await;
        let header_end = pgm
            .iter()
            .enumerate()
            .filter(|(_, byte)| **byte == b'\n')
            .map(|(k, _)| k + 1)
            .nth(2)
            .unwrap();
        let header = String::from_utf8_lossy(&pgm[..header_end]).into_owned();
        let size = header.lines().nth(1).unwrap();
        Self {
            width: size.split(' ').next().unwrap().parse().unwrap(),
            yaml: client.text("/v1/routes/line/map.yaml").await,
            cells: pgm[header_end..].to_vec(),
        }
    }

    fn occupied(&self) -> usize {
        self.cells.iter().filter(|cell| **cell == OCCUPIED).count()
    }
}

/// That no wall was lost, and that nothing is drawn where nothing was.
fn assert_same_walls(before: &Picture, after: &Picture) {
    assert_eq!(before.yaml, after.yaml);
    assert_eq!(before.width, after.width);
    let differing = before.cells.iter().zip(&after.cells);
    let differing = differing.filter(|(old, new)| old != new).count();
    assert_eq!(differing, 0, "of {} wall cells", before.occupied());
}

/// What honest vehicles had before an attack.
struct Honest {
    state: State,
    picture: Picture,
}

impl Honest {
    async fn of(client: &Client) -> Self {
        Self {
            state: State::of(client, "line").await,
            picture: Picture::of(client).await,
        }
    }

    /// That an attack has moved no pose and no wall, and raised no alert.
    async fn assert_unharmed(&self, client: &Client, attack: &str) {
        self.assert_unmoved(client, attack, 1e-9).await;
        assert_same_walls(&self.picture, &Picture::of(client).await);
    }

    /// How far the farthest pose was moved, metres.
    async fn moved_m(&self, client: &Client) -> f64 {
        let poses = State::of(client, "line").await.poses();
        let ways_m = self.state.poses().into_iter().map(|(key, was)| {
            let now = &poses[&key];
            (now.translation() - was.translation()).norm()
        });
        ways_m.fold(0.0, f64::max)
    }

    async fn assert_unmoved(&self, client: &Client, attack: &str, within_m: f64) {
        let moved_m = self.moved_m(client).await;
        let alerts = client.list("/v1/alerts", 50).await;
        eprintln!(
            "{attack}: the farthest honest pose moved by {:.2} mm, {} alerts",
            1e3 * moved_m,
            alerts.len()
        );
        assert!(moved_m < within_m, "{attack}: {moved_m} m");
        assert!(alerts.is_empty(), "{attack}: {alerts:?}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn an_edge_of_a_stranger_moves_nobody() {
    let service = with_map(60).await;
    let client = &service.client;
    let honest = Honest::of(client).await;
    let before = &honest.state;
    let id = |k: usize| format!("map:{}", before.nodes[k]["id"]);
    let lie = |kind: &str, x: f64, information: f64| {
        let at_most = information.min(1e12);
        json!({
            "vehicle_id": "stranger", "nodes": [],
            "edges": [{
                "from": id(2), "to": id(9), "kind": kind,
                "measurement": {"x": x, "y": 0.0, "theta": 0.5},
                "information": [at_most, 0.0, 0.0, at_most, 0.0, at_most],
            }],
        })
    };
    for (k, (kind, x, information)) in [
        ("loop_closure", 50.0, 1e12),
        ("odometry", 50.0, 1e12),
        ("loop_closure", 6.0, 1e6),
    ]
    .into_iter()
    .enumerate()
    {
        let name = format!("lie-{k}");
        let (status, answer) = client
            .put_edges("line", &name, &lie(kind, x, information))
            .await;
        assert_eq!(status, 202, "{answer}");
        let batch = client.ended("line", &name).await;
        assert_eq!(batch["status"], "quarantined", "{batch}");
        let reason = batch["reason"].as_str().unwrap();
        assert!(reason.contains("move what others have mapped"), "{reason}");
    }
    assert!(State::of(client, "line").await == *before);
    honest
        .assert_unharmed(client, "an edge that is 50 m off")
        .await;
    service.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_edge_that_agrees_is_taken_however_sure_it_is() {
    let service = with_map(60).await;
    let client = &service.client;
    let before = State::of(client, "line").await;
    let pose = |k: usize| pose_of(&before.nodes[k]["pose"]);
    let motion = pose(2).between(&pose(9));
    let batch = json!({
        "vehicle_id": "stranger", "nodes": [],
        "edges": [{
            "from": format!("map:{}", before.nodes[2]["id"]),
            "to": format!("map:{}", before.nodes[9]["id"]),
            "kind": "loop_closure",
            "measurement": {"x": motion.x + 0.003, "y": motion.y, "theta": motion.theta},
            "information": [1e12, 0.0, 0.0, 1e12, 0.0, 1e12],
        }],
    });
    let (status, answer) = client.put_edges("line", "true", &batch).await;
    assert_eq!(status, 202, "{answer}");
    let reported = client.ended("line", "true").await;
    assert_eq!(reported["status"], "merged", "{reported}");
    let after = State::of(client, "line").await;
    let (moved_m, _) = after.distance_to(&before);
    assert!(moved_m < 0.02, "{moved_m}");
    let edge = after.edges.last().unwrap();
    let information = edge["information"].as_array().unwrap();
    assert!(
        information.iter().all(|v| v.as_f64().unwrap() <= 1e8),
        "{edge}"
    );
    service.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_start_at_the_end_of_the_world_is_held_apart() {
    let service = with_map(60).await;
    let client = &service.client;
    let honest = Honest::of(client).await;
    let drive = Drive::through(&HALL, &second_vehicle(), ("agv-02", "far"), 24, 2);
    let drive = Drive {
        initial_pose: Some(Pose2::new(9e5, -9e5, 0.0)),
        ..drive
    };
    client.put_all("line", &drive.batches(12)).await;
    let batch = ended(client, "far-000").await;
    assert_eq!(batch["status"], "unanchored", "{batch}");
    let reason = batch["reason"].as_str().unwrap();
    assert!(reason.contains("m from the map"), "{reason}");
    honest
        .assert_unharmed(client, "a start 1,273 km away")
        .await;
    service.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn giant_steps_widen_no_picture() {
    let service = with_map(60).await;
    let client = &service.client;
    let honest = Honest::of(client).await;
    let before = &honest.picture;
    let drive = Drive::through(&HALL, &second_vehicle(), ("agv-02", "giant"), 48, 2);
    // At 10 m/s, which is no speed to be refused for.
    for batch in drive.batches(12) {
        let sequence: usize = batch.id[6..].parse().unwrap();
        let striding = with_scans(&batch, |k, scan| {
            let steps = 12 * sequence + k;
            let at = drive.began + jiff::SignedDuration::from_secs(10 * steps as i64);
            scan["stamp"] = json!(at.to_string());
            scan["odometry"] = json!({"x": 99.0 * steps as f64, "y": 0.0, "theta": 0.0});
        });
        client.put("line", &striding).await;
        ended(client, &batch.id).await;
    }
    // What it saw between its steps is part of the hall.
    let after = Picture::of(client).await;
    let resolution = |picture: &Picture| picture.yaml.lines().nth(2).map(str::to_owned);
    assert_eq!(resolution(before), resolution(&after));
    assert!(after.width < before.width + 400, "{}", after.width);
    // What it saw between its steps fits, and closes loops: the route is still being mapped.
    honest.assert_unmoved(client, "steps of 99 m", 0.05).await;
    let moved_m = honest.moved_m(client).await;
    // No edge says what the wheels did.
    for edge in State::of(client, "line").await.edges {
        let way_m = pose_of(&edge["measurement"]).translation().norm();
        assert!(way_m < 6.0, "{edge}");
    }
    service.stop().await;

    // The same trip with sound odometry does the same to a map that is as young.
    let service = with_map(60).await;
    service.client.put_all("line", &drive.batches(12)).await;
    service.client.merged("line").await;
    let sound_m = honest.moved_m(&service.client).await;
    eprintln!("the same trip with sound odometry: {:.2} mm", 1e3 * sound_m);
    assert!(moved_m < sound_m + 0.005, "{moved_m} m, {sound_m} m");
    service.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn another_building_in_the_middle_of_the_map_wears_no_wall_away() {
    let service = with_map(180).await;
    let client = &service.client;
    let honest = Honest::of(client).await;
    let drive = Drive::through(&workshop(), &second_vehicle(), ("agv-02", "wrong"), 96, 7);
    let inside = HALL.route.pose_at(3.0);
    let drive = Drive {
        initial_pose: Some(inside),
        ..drive
    };
    client.put_all("line", &drive.batches(24)).await;
    let mut reported = Vec::new();
    for batch in drive.batches(24) {
        reported.push(ended(client, &batch.id).await);
    }
    assert_eq!(
        reported[3]["flags"],
        json!(["not_localised"]),
        "{reported:?}"
    );
    assert!(honest.picture.occupied() > 1_000);
    honest
        .assert_unharmed(client, "another building in the middle of the map")
        .await;
    service.stop().await;
}

/// A batch of edges of a drive along a line, with closures between nodes of it.
fn edges_of(nodes: usize, closures: &[(usize, usize)]) -> Value {
    let pose = |x: f64| json!({"x": x, "y": 0.0, "theta": 0.0});
    let edge = |kind: &str, from: usize, to: usize| {
        json!({
            "from": format!("{from}"), "to": format!("{to}"), "kind": kind,
            "measurement": pose(to as f64 - from as f64),
            "information": [400.0, 0.0, 0.0, 400.0, 0.0, 2500.0],
        })
    };
    let odometry = (1..nodes).map(|k| edge("odometry", k - 1, k));
    let closures = closures.iter().filter(|(from, to)| from != to);
    let closures = closures.map(|(from, to)| edge("loop_closure", *from, *to));
    json!({
        "vehicle_id": "dense",
        "nodes": (0..nodes).map(|k| json!({"id": format!("{k}"), "pose": pose(k as f64)})).collect::<Vec<_>>(),
        "edges": odometry.chain(closures).collect::<Vec<_>>(),
    })
}

#[tokio::test(flavor = "multi_thread")]
async fn closures_all_over_the_map_are_refused_unsolved() {
    let service = with_map(60).await;
    let client = &service.client;
    let honest = Honest::of(client).await;
    let nodes = 800;
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let closures: Vec<(usize, usize)> = (0..6_000)
        .map(|_| (random.random_range(0..nodes), random.random_range(0..nodes)))
        .collect();
    let mut dense = edges_of(nodes, &closures);
    let tie = json!({
        "from": format!("map:{}", honest.state.nodes[5]["id"]), "to": "0", "kind": "odometry",
        "measurement": {"x": 1.0, "y": 0.0, "theta": 0.0},
        "information": [400.0, 0.0, 0.0, 400.0, 0.0, 2500.0],
    });
    dense["edges"].as_array_mut().unwrap().push(tie);
    let (status, answer) = client.put_edges("line", "dense", &dense).await;
    assert_eq!(status, 202, "{answer}");
    let batch = client.ended("line", "dense").await;
    assert_eq!(batch["status"], "quarantined", "{batch}");
    let reason = batch["reason"].as_str().unwrap();
    assert!(
        reason.contains("so densely") && reason.contains("thin them"),
        "{reason}"
    );
    honest
        .assert_unharmed(client, "800 nodes with 6,000 closures at random")
        .await;
    service.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn beams_that_lie_upon_each_other_are_refused() {
    let service = with_map(60).await;
    let client = &service.client;
    let honest = Honest::of(client).await;
    let drive = Drive::through(&HALL, &second_vehicle(), ("agv-02", "narrow"), 12, 2);
    let mut body: Value = serde_json::from_slice(&drive.batches(12)[0].body).unwrap();
    body["lidar"]["angle_increment"] = json!(1e-12);
    let (status, problem) = client
        .put_body("/v1/routes/line/batches/narrow-000".to_owned(), &body)
        .await;
    assert_eq!(status, 422, "{problem}");
    assert_eq!(problem["type"], "/problems/scan-geometry", "{problem}");
    honest
        .assert_unharmed(client, "beams 1e-12 rad apart")
        .await;
    service.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn noise_is_no_world() {
    let service = with_map(60).await;
    let client = &service.client;
    let honest = Honest::of(client).await;
    let drive = Drive::through(&HALL, &second_vehicle(), ("agv-02", "noise"), 24, 2);
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let noise: Vec<Vec<f64>> = (0..24)
        .map(|_| (0..720).map(|_| random.random_range(0.5..15.0)).collect())
        .collect();
    let batches = drive.batches(12);
    for (sequence, batch) in batches.iter().enumerate() {
        let noisy = with_scans(batch, |k, scan| {
            let ranges = scan["ranges"].as_array_mut().unwrap();
            for (range, noise) in ranges.iter_mut().zip(&noise[12 * sequence + k]) {
                *range = json!(noise);
            }
        });
        client.put("line", &noisy).await;
        ended(client, &batch.id).await;
    }
    // A start that nothing confirms, again and again.
    for (k, batch) in batches.iter().enumerate() {
        let body: Value = serde_json::from_slice(&batch.body).unwrap();
        let mut scan = body["scans"][0].clone();
        scan["ranges"] = json!(noise[k][..scan["ranges"].as_array().unwrap().len()]);
        let start = drive.scans[12 * k].map_from_base;
        let name = format!("single-{k}");
        let single = batch.with(
            &name,
            json!({
                "trip_id": name, "sequence": 0, "scans": [scan],
                "initial_pose": {"x": start.x, "y": start.y, "theta": start.theta},
            }),
        );
        client.put("line", &single).await;
        ended(client, &name).await;
    }
    honest
        .assert_unmoved(client, "26 scans of random ranges", 0.02)
        .await;
    let after = Picture::of(client).await;
    assert_eq!(honest.picture.yaml, after.yaml);
    let pairs = honest.picture.cells.iter().zip(&after.cells);
    let filled = pairs.filter(|(old, new)| **new == OCCUPIED && old != new);
    eprintln!(
        "walls: {} cells, {} before",
        after.occupied(),
        honest.picture.occupied()
    );
    assert_eq!(filled.count(), 0);
    service.stop().await;
}

/// When something was last made in a directory, or taken out of it.
fn changed_at(directory: &Path) -> SystemTime {
    std::fs::metadata(directory).unwrap().modified().unwrap()
}

/// Not a test: what SQLite writes beside the database when it may, for the test below.
#[tokio::test]
#[ignore = "runs in the directory that the test below watches"]
async fn sorts_in_a_file() {
    let options = SqliteConnectOptions::new().pragma("temp_store", "FILE");
    let mut raw = options.in_memory(true).connect().await.unwrap();
    let sorted = sqlx::query_scalar(
        "WITH RECURSIVE numbers (n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM numbers LIMIT 300000) \
         SELECT count(*) FROM (SELECT DISTINCT hex(randomblob(40)) FROM numbers ORDER BY 1)",
    );
    let count: i64 = sorted.fetch_one(&mut raw).await.unwrap();
    assert_eq!(count, 300_000);
}

/// `/var/tmp` and `TMPDIR` may be full, read-only or gone: nothing is ever written there.
#[tokio::test(flavor = "multi_thread")]
async fn no_statement_needs_a_directory_for_temporary_files() {
    let [data, temporary] = [(); 2].map(|()| TempDir::new().unwrap());
    let temporary = temporary.path();
    let before = changed_at(temporary);
    let mut command = Process::command(data.path());
    command.args(["--listen", "127.0.0.1:0"]);
    command.env("SQLITE_TMPDIR", temporary);
    let service = Process::started(command).unwrap();
    let client = Client::new(&service.url);
    for route in ["line", "other"] {
        client.put_route(route, Value::Null).await;
        for drive in two_vehicles(120) {
            client.put_all(route, &drive.batches(60)).await;
        }
        client.merged(route).await;
    }
    for read in [
        "graph",
        "graph.g2o",
        "map.png",
        "residuals",
        "trips",
        "nodes",
    ] {
        client.bytes(&format!("/v1/routes/line/{read}")).await;
    }
    let removal = client.remove("line", json!({"trips": ["two"]})).await;
    assert_eq!(removal["status"], "succeeded", "{removal}");
    // A transaction of many rows.
    assert_eq!(client.delete("/v1/routes/other").await, 204);
    assert!(changed_at(temporary) == before, "something was written");
    drop(service);

    let control = Command::new(std::env::current_exe().unwrap())
        .args(["--ignored", "--exact", "attacks::sorts_in_a_file"])
        .env("SQLITE_TMPDIR", temporary)
        .output()
        .unwrap();
    assert!(control.status.success(), "{control:?}");
    assert!(changed_at(temporary) != before, "nothing would be seen");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_large_picture_that_is_drawn_holds_up_no_other_route() {
    let service = with_map(60).await;
    let client = &service.client;
    client.put_route("wide", Value::Null).await;
    let [first, second] = two_vehicles(12);
    let far = Drive {
        initial_pose: Some(Pose2::new(900.0, 0.0, 0.0)),
        ..second
    };
    for drive in [first, far] {
        client.put_all("wide", &drive.batches(12)).await;
    }
    client.merged("wide").await;
    // In both layers, each more than once.
    let layers = ["", "?layer=observed"].into_iter().cycle().take(6);
    let mut drawn = tokio::task::JoinSet::new();
    for layer in layers {
        let client = client.clone();
        drawn.spawn(async move {
            client
                .bytes(&format!("/v1/routes/wide/map.pgm{layer}"))
                .await
        });
    }
    let other = client.bytes("/v1/routes/line/map.pgm");
    tokio::select! {
        _ = drawn.join_next() => panic!("the other route's picture waited"),
        picture = other => assert!(!picture.is_empty()),
    }
    let pictures = drawn.join_all().await;
    assert!(pictures.iter().all(|picture| picture.len() > 10_000_000));
    service.stop().await;
}
