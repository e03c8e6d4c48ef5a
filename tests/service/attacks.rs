//! Uploads that are formally right and ruinous: what honest vehicles have mapped stays as it is.

use mapshift::geometry::Pose2;
use serde_json::json;

use crate::client::Client;
use crate::drives::{Drive, HALL, second_vehicle, workshop};
use crate::odd_trips::{ended, with_map};
use crate::spoiled::with_scans;
use crate::state::State;

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

async fn assert_no_alert(client: &Client) {
    let alerts = client.list("/v1/alerts", 50).await;
    assert!(alerts.is_empty(), "{alerts:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn an_edge_of_a_stranger_moves_nobody() {
    let service = with_map(60).await;
    let client = &service.client;
    let before = State::of(client, "line").await;
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
    assert!(State::of(client, "line").await == before);
    service.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_edge_that_agrees_is_taken_however_sure_it_is() {
    let service = with_map(60).await;
    let client = &service.client;
    let before = State::of(client, "line").await;
    let pose = |k: usize| crate::state::pose_of(&before.nodes[k]["pose"]);
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
    let before = Picture::of(client).await;
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
    assert_same_walls(&before, &Picture::of(client).await);
    service.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn giant_steps_widen_no_picture() {
    let service = with_map(60).await;
    let client = &service.client;
    let before = Picture::of(client).await;
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
    assert_eq!(resolution(&before), resolution(&after));
    assert!(after.width < before.width + 400, "{}", after.width);
    service.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn another_building_in_the_middle_of_the_map_wears_no_wall_away() {
    let service = with_map(180).await;
    let client = &service.client;
    let before = Picture::of(client).await;
    let (walls, state) = (before.occupied(), State::of(client, "line").await);
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
    let after = Picture::of(client).await;
    assert_same_walls(&before, &after);
    assert!(walls > 1_000, "{walls}");
    let poses = State::of(client, "line").await.poses();
    for (key, pose) in state.poses() {
        let moved_m = (poses[&key].translation() - pose.translation()).norm();
        assert!(moved_m < 1e-9, "{key:?} moved by {moved_m}");
    }
    assert_no_alert(client).await;
    service.stop().await;
}
