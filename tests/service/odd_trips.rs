//! Trips with something wrong: each ends in a state with a reason, and nothing else is touched.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use mapshift::geometry::Pose2;
use serde_json::{Value, json};

use crate::client::Client;
use crate::drives::{Batch, Drive, HALL, first_vehicle, second_vehicle, two_vehicles, workshop};
use crate::running::Running;
use crate::spoiled::{blind, wild};
use crate::state::{Key, State};

const PATIENCE: Duration = Duration::from_secs(60);

/// A service whose route holds the first vehicle's drive.
pub async fn with_map(scans: usize) -> Running {
    let service = Running::start().await;
    service.client.put_route("line", Value::Null).await;
    let [first, _] = two_vehicles(scans);
    service.client.put_all("line", &first.batches(12)).await;
    service.client.merged("line").await;
    service
}

async fn until(client: &Client, id: &str, done: impl Fn(&Value) -> bool) -> Value {
    let give_up = Instant::now() + PATIENCE;
    loop {
        let batch = client.batch("line", id).await;
        if done(&batch) {
            return batch;
        }
        assert!(Instant::now() < give_up, "{batch}");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

pub async fn ended(client: &Client, id: &str) -> Value {
    let under_way = ["queued", "processing", "held"];
    until(client, id, |b| {
        !under_way.contains(&b["status"].as_str().unwrap())
    })
    .await
}

async fn all_numbers_are_finite(client: &Client) {
    let state = State::of(client, "line").await;
    // A number that is not finite would be null.
    let numbers = |v: &Value| ["x", "y", "theta"].iter().all(|f| v[f].is_f64());
    assert!(state.nodes.iter().all(|node| numbers(&node["pose"])));
    assert!(state.edges.iter().all(|edge| edge["residual"].is_f64()));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_gap_is_waited_for_then_skipped() {
    let service = with_map(36).await;
    let client = &service.client;
    client.put_route("line", json!({"hold_s": 1})).await;
    let [_, second] = two_vehicles(36);
    let headless = second.clone().without_pose().batches(12);
    let broken_drive = Drive {
        trip: "three".to_owned(),
        ..second.clone()
    };
    let broken = broken_drive.batches(12);
    client.put_all("line", [&headless[2], &headless[1]]).await;
    client.put_all("line", [&broken[0], &broken[2]]).await;
    for id in ["two-001", "two-002", "three-002"] {
        let batch = client.batch("line", id).await;
        assert_eq!(batch["status"], "held", "{batch}");
    }

    let mut flags = Vec::new();
    for id in ["two-001", "two-002", "three-000", "three-002"] {
        let batch = ended(client, id).await;
        assert_eq!(batch["status"], "merged", "{batch}");
        assert!(batch["nodes_added"].as_i64().unwrap() > 5, "{batch}");
        flags.push(batch["flags"].clone());
    }
    assert_eq!(json!(flags), json!([["gap"], [], [], ["gap"]]));
    let state = State::of(client, "line").await;
    for drive in [&second, &broken_drive] {
        assert_near_the_truth(drive, &state.poses(), 0.2);
    }

    client.put_all("line", [&headless[0], &broken[1]]).await;
    for id in ["two-000", "three-001"] {
        let late = ended(client, id).await;
        assert_eq!(late["status"], "quarantined", "{late}");
        let reason = late["reason"].as_str().unwrap();
        assert!(reason.contains("after its successors"), "{late}");
    }
    assert!(State::of(client, "line").await == state);
    service.stop().await;
}

/// That the keyframes of a drive are where the vehicle was.
fn assert_near_the_truth(drive: &Drive, reported: &BTreeMap<Key, Pose2>, within_m: f64) {
    let mut compared = 0;
    for scan in &drive.scans {
        let key = (drive.trip.to_owned(), drive.stamp(scan).to_string());
        if let Some(pose) = reported.get(&key) {
            let error_m = (pose.translation() - scan.map_from_base.translation()).norm();
            assert!(error_m < within_m, "{key:?} is off by {error_m} m");
            compared += 1;
        }
    }
    assert!(compared > 10, "{compared}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_place_in_a_trip_is_taken_once() {
    let service = with_map(24).await;
    let client = &service.client;
    let before = State::of(client, "line").await;
    let [first, _] = two_vehicles(36);
    let first = first.batches(12);
    let same_place = first[1].with("one-001-again", json!({}));
    let other_vehicle = first[2].with("one-002-of-another", json!({"vehicle_id": "agv-02"}));
    client.put_all("line", [&same_place, &other_vehicle]).await;
    for (id, reason) in [
        ("one-001-again", "was already used by one-001"),
        ("one-002-of-another", "belongs to vehicle agv-01"),
    ] {
        let batch = ended(client, id).await;
        assert_eq!(batch["status"], "quarantined");
        assert!(
            batch["reason"].as_str().unwrap().contains(reason),
            "{batch}"
        );
    }
    assert!(State::of(client, "line").await == before);

    // Neither stands in the way of the right one.
    client.put("line", &first[2]).await;
    assert_eq!(ended(client, "one-002").await["status"], "merged");
    service.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_trip_from_elsewhere_changes_nothing() {
    let service = with_map(60).await;
    let client = &service.client;
    let g2o = "/v1/routes/line/graph.g2o";
    let before = client.bytes(g2o).await;
    let elsewhere = Drive::through(&workshop(), &second_vehicle(), ("agv-02", "lost"), 48, 7);
    let elsewhere = elsewhere.without_pose().batches(16);
    client.put_all("line", &elsewhere).await;
    for batch in &elsewhere {
        let batch = ended(client, &batch.id).await;
        assert_eq!(batch["status"], "unanchored", "{batch}");
        assert!(!batch["reason"].as_str().unwrap().is_empty());
        assert_eq!(batch["nodes_added"], 0);
    }
    assert!(client.bytes(g2o).await == before);
    service.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_trip_without_a_place_is_tried_again_when_the_map_has_grown() {
    let service = with_map(36).await;
    let client = &service.client;
    let mut second = Drive::through(&HALL, &second_vehicle(), ("agv-02", "two"), 144, 2);
    second.scans.drain(..108);
    let second_drive = second.without_pose();
    let second = second_drive.batches(12);
    client.put_all("line", &second).await;
    for batch in &second {
        let batch = ended(client, &batch.id).await;
        assert_eq!(batch["status"], "unanchored", "{batch}");
    }

    let first = Drive::through(&HALL, &first_vehicle(), ("agv-01", "one"), 180, 1);
    client.put_all("line", &first.batches(12)[3..]).await;
    let mut closures = 0;
    for batch in &second {
        let merged = |b: &Value| b["status"] == "merged";
        let batch = until(client, &batch.id, merged).await;
        assert!(batch["nodes_added"].as_i64().unwrap() > 5, "{batch}");
        assert_eq!(batch["reason"], Value::Null);
        closures += batch["loop_closures"].as_i64().unwrap();
    }
    assert!(closures > 5, "{closures}");
    client.merged("line").await;
    let reported = State::of(client, "line").await.poses();
    for drive in [first, second_drive] {
        assert_near_the_truth(&drive, &reported, 0.2);
    }
    service.stop().await;
}

/// Sends a drive whose first and third batches are spoiled; hands back the outcomes of the four.
async fn half_spoiled(
    client: &Client,
    trip: &str,
    drive: &Drive,
    spoil: fn(&Batch) -> Batch,
) -> Vec<Value> {
    let own = |b: &Batch| b.with(&format!("{trip}-{}", b.id), json!({ "trip_id": trip }));
    let mut sent: Vec<Batch> = drive.batches(12).iter().map(own).collect();
    for k in [0, 2] {
        sent[k] = spoil(&sent[k]);
    }
    client.put_all("line", &sent).await;
    let mut reported = Vec::new();
    for batch in &sent {
        reported.push(ended(client, &batch.id).await);
    }
    reported
}

fn column(batches: &[Value], field: &str) -> Value {
    batches.iter().map(|batch| batch[field].clone()).collect()
}

async fn everything_is_reported(client: &Client) {
    all_numbers_are_finite(client).await;
    for part in [
        "map.png",
        "map.pgm",
        "map.yaml",
        "graph.g2o",
        "subgraphs",
        "residuals",
    ] {
        let path = format!("/v1/routes/line/{part}");
        assert_eq!(client.status_of(&path).await, 200, "{part}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn blind_batches_are_driven_by_odometry() {
    let service = with_map(36).await;
    let client = &service.client;
    let [_, drive] = two_vehicles(48);
    let reported = half_spoiled(client, "posed", &drive, blind).await;
    let flagged = json!([["empty_scans"], [], ["empty_scans"], []]);
    assert_eq!(column(&reported, "flags"), flagged);
    assert!(
        reported.iter().all(|b| b["status"] == "merged"),
        "{reported:?}"
    );

    let drive = drive.without_pose();
    let reported = half_spoiled(client, "unposed", &drive, blind).await;
    assert_eq!(column(&reported, "flags"), flagged);
    everything_is_reported(client).await;
    service.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn wild_batches_are_kept_out() {
    let service = with_map(36).await;
    let client = &service.client;
    let before = client.text("/v1/routes/line/map.yaml").await;
    let [_, drive] = two_vehicles(48);
    for (trip, drive) in [("posed", drive.clone()), ("unposed", drive.without_pose())] {
        let reported = half_spoiled(client, trip, &drive, wild).await;
        assert_eq!(
            column(&reported, "status"),
            json!(["quarantined", "merged", "quarantined", "merged"]),
            "{reported:?}"
        );
        assert_eq!(
            column(&reported, "flags"),
            json!([["wild_odometry"], ["gap"], ["wild_odometry"], ["gap"]])
        );
        for k in [0, 2] {
            let reason = reported[k]["reason"].as_str().unwrap();
            assert!(reason.contains("odometry jumps by"), "{reason}");
        }
    }
    everything_is_reported(client).await;
    let after = client.text("/v1/routes/line/map.yaml").await;
    let resolution = |yaml: &str| {
        yaml.lines()
            .find(|l| l.contains("resolution"))
            .map(str::to_owned)
    };
    assert_eq!(resolution(&after), resolution(&before));
    service.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_route_may_begin_blind() {
    let service = Running::start().await;
    let client = &service.client;
    client.put_route("line", Value::Null).await;
    let [first, second] = two_vehicles(24);
    let first = first.without_pose().batches(12);
    client.put_all("line", [&blind(&first[0]), &first[1]]).await;
    client.merged("line").await;
    for picture in ["map.png", "map.yaml", "graph.g2o", "residuals"] {
        let path = format!("/v1/routes/line/{picture}");
        assert_eq!(client.status_of(&path).await, 200, "{picture}");
    }
    let second = second.without_pose().batches(12);
    client.put_all("line", &second).await;
    for batch in &second {
        ended(client, &batch.id).await;
    }
    all_numbers_are_finite(client).await;
    service.stop().await;
}
