//! What was bad is taken out again, and the map is as if it had never been there.

use serde_json::{Value, json};
use tempfile::TempDir;

use crate::client::{Client, POLL};
use crate::drives::{Drive, HALL, first_vehicle, second_vehicle, two_vehicles};
use crate::odd_trips::ended;
use crate::running::Running;
use crate::state::{State, pose_of};

/// Five laps by two vehicles in turn, each a trip.
fn laps() -> Vec<Drive> {
    (0..5).map(|k| lap(k, 96)).collect()
}

fn lap(k: usize, scans: usize) -> Drive {
    let (vehicle, name) = match k % 2 {
        0 => (first_vehicle(), "agv-01"),
        _ => (second_vehicle(), "agv-02"),
    };
    let trip = format!("lap-{k}");
    Drive::through(&HALL, &vehicle, (name, &trip), scans, 1 + k as u64)
}

async fn driven(drives: &[Drive], without: Option<&str>) -> Running {
    let service = Running::start().await;
    service.client.put_route("line", Value::Null).await;
    for drive in drives {
        if without != Some(drive.trip.as_str()) {
            service.client.put_all("line", &drive.batches(24)).await;
            service.client.settled("line", true).await;
        }
    }
    service
}

async fn alerts(client: &Client) -> Vec<(String, String)> {
    let text = |alert: &Value, field: &str| alert[field].as_str().unwrap().to_owned();
    let alerts = client.list("/v1/alerts", 50).await;
    let alerts = alerts.iter().filter(|alert| alert["status"] == "open");
    alerts
        .map(|a| (text(a, "kind"), a["location"].to_string()))
        .collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_map_without_a_trip_is_as_if_the_trip_had_never_been_driven() {
    let drives = laps();
    let service = driven(&drives, None).await;
    service.client.merged("line").await;
    let client = &service.client;
    let before = State::of(client, "line").await;
    let trial = client
        .remove("line", json!({"trips": ["lap-2"], "dry_run": true}))
        .await;
    assert_eq!(trial["status"], "succeeded", "{trial}");
    assert!(
        State::of(client, "line").await == before,
        "a dry run changes nothing"
    );

    let asked = json!({"trips": ["lap-2"], "note": "its lidar was loose"});
    let done = client.remove("line", asked).await;
    assert_eq!(
        (&done["status"], &done["progress"]),
        (&json!("succeeded"), &json!(1.0)),
        "{done}"
    );
    for what in ["batches", "nodes", "edges"] {
        assert_eq!(done["result"][what], trial["result"][what]);
    }
    assert_eq!(done["result"]["batches"], 4);
    let rebuilt = [&trial, &done].map(|operation| &operation["result"]["rebuilt"]);
    assert_eq!(rebuilt, [&json!(false), &json!(true)], "{done}");

    let after = State::of(client, "line").await;
    let is_gone = |node: &Value| node["trip_id"] == "lap-2";
    assert!(before.nodes.iter().any(is_gone) && !after.nodes.iter().any(is_gone));
    let counts = client.route("line").await["counts"].clone();
    assert_eq!(counts["nodes"], after.nodes.len());
    assert_eq!(counts["edges"], after.edges.len());
    let closures = after
        .edges
        .iter()
        .filter(|edge| edge["kind"] == "loop_closure");
    assert_eq!(counts["loop_closures"], closures.count());
    let batch = client.batch("line", "lap-2-000").await;
    assert_eq!(
        (&batch["status"], &batch["reason"], &batch["nodes_added"]),
        (&json!("removed"), &json!("its lidar was loose"), &json!(0))
    );

    let never = driven(&drives, Some("lap-2")).await;
    let expected = State::of(&never.client, "line").await;
    assert!(after.nodes.len() > 100);
    let (apart_m, apart_rad) = after.distance_to(&expected);
    println!("apart by {apart_m:e} m and {apart_rad:e} rad at most");
    assert!(apart_m < 1e-9 && apart_rad < 1e-9, "{apart_m} {apart_rad}");
    assert_eq!(alerts(client).await, alerts(&never.client).await);
    never.stop().await;

    // The trip may be sent again, and another removal finds nothing of the old one.
    let again = client
        .remove("line", json!({"batches": ["lap-2-000"]}))
        .await;
    assert_eq!(again["result"]["batches"], 0, "{again}");
    for batch in drives[2].batches(24) {
        let renamed = batch.named(&format!("{}-again", batch.id));
        client.put("line", &renamed).await;
        let reported = ended(client, &renamed.id).await;
        assert_eq!(reported["status"], "merged", "{reported}");
    }
    service.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_removal_that_a_restart_cuts_off_is_carried_on() {
    let directory = TempDir::new().unwrap();
    let service = Running::start_in(directory.path()).await;
    let client = &service.client;
    client.put_route("line", Value::Null).await;
    for drive in laps() {
        client.put_all("line", &drive.batches(24)).await;
        client.settled("line", true).await;
    }
    let removals = "/v1/routes/line/removals".to_owned();
    let (status, asked) = client.post(removals, json!({"trips": ["lap-2"]})).await;
    assert_eq!(status, 202, "{asked}");
    while client.batch("line", "lap-2-000").await["status"] != "removed" {
        tokio::time::sleep(POLL).await;
    }
    service.stop().await;

    let service = Running::start_in(directory.path()).await;
    let client = &service.client;
    let operation = format!("/v1/operations/{}", asked["id"].as_str().unwrap());
    let done = client.ended_operation(&operation).await;
    assert_eq!(done["status"], "succeeded", "{done}");
    let result = &done["result"];
    assert_eq!(
        (&result["batches"], &result["rebuilt"]),
        (&json!(4), &json!(true))
    );
    service.stop().await;
}

/// `cargo test --release --test service -- --ignored --nocapture one_of_fifty`
#[tokio::test(flavor = "multi_thread")]
#[ignore = "takes minutes"]
async fn one_of_fifty_laps_is_taken_out() {
    for bad in [1, 25] {
        let mut drives: Vec<Drive> = (0..50).map(|k| lap(k, 96)).collect();
        let scans = drives[bad].scans.iter_mut();
        for range_m in scans.flat_map(|scan| &mut scan.ranges_m) {
            *range_m = range_m.map(|range_m| range_m * 1.03);
        }
        let trip = format!("lap-{bad}");
        let service = driven(&drives, None).await;
        let client = &service.client;
        let kept_out = |batches: &[Value]| {
            let quarantined = batches.iter().filter(|b| b["status"] == "quarantined");
            quarantined.count()
        };
        let before = kept_out(&client.settled("line", true).await);
        let begun = std::time::Instant::now();
        let done = client.remove("line", json!({"trips": [&trip]})).await;
        let took = begun.elapsed();
        assert_eq!(done["result"]["rebuilt"], true, "{done}");
        let after = client.settled("line", true).await;
        assert_eq!(kept_out(&after), 0);
        let never = driven(&drives, Some(&trip)).await;
        let state = State::of(client, "line").await;
        let (apart_m, _) = state.distance_to(&State::of(&never.client, "line").await);
        println!(
            "lap {bad}: {} in {took:.1?}, {before} batches had been kept out; {} poses, apart by {apart_m:e} m at most",
            done["result"],
            state.nodes.len(),
        );
        assert!(apart_m < 1e-9);
        assert_eq!(alerts(client).await, alerts(&never.client).await);
        never.stop().await;
        service.stop().await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn the_first_trip_can_go_and_the_map_lives_on() {
    let drives = laps();
    let service = driven(&drives, None).await;
    service.client.merged("line").await;
    let client = &service.client;
    let before = State::of(client, "line").await.poses();
    let done = client
        .remove("line", json!({"trips": ["lap-0"], "erase": true}))
        .await;
    assert_eq!(done["status"], "succeeded", "{done}");
    let after = State::of(client, "line").await;
    for (key, pose) in after.poses() {
        let moved_m = (pose.translation() - before[&key].translation()).norm();
        assert!(moved_m < 0.1, "{key:?} moved by {moved_m} m");
    }
    assert!(after.nodes.iter().any(|node| node["reference"] == true));
    let lap = Drive::through(&HALL, &first_vehicle(), ("agv-03", "after"), 96, 9);
    client
        .put_all("line", &lap.without_pose().batches(24))
        .await;
    let reported = client.settled("line", true).await;
    let last = reported.last().unwrap();
    assert_eq!(last["status"], "merged", "{last}");
    assert!(last["loop_closures"].as_i64().unwrap() > 5, "{last}");
    service.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_a_sender_added_stays_with_a_removed_batch_and_goes_with_an_erased_one() {
    let service = driven(&[], None).await;
    let client = &service.client;
    let extensions = json!({"operator": "kim"});
    let batch = lap(0, 2).batches(2)[0].with("noted", json!({"extensions": extensions}));
    client.put_all("line", [&batch]).await;
    client.settled("line", true).await;
    client.remove("line", json!({"batches": ["noted"]})).await;
    let removed = client.batch("line", "noted").await;
    assert_eq!(removed["extensions"], extensions, "{removed}");

    let again = batch.with("erased", json!({"trip_id": "again"}));
    client.put_all("line", [&again]).await;
    client.settled("line", true).await;
    let erase = json!({"batches": ["erased"], "erase": true});
    client.remove("line", erase).await;
    let erased = client.batch("line", "erased").await;
    assert_eq!(
        (&erased["status"], &erased["extensions"]),
        (&json!("removed"), &Value::Null)
    );
    service.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stranger_who_took_a_trips_name_is_removed_and_the_trip_tried_again() {
    let service = Running::start().await;
    let client = &service.client;
    client.put_route("line", Value::Null).await;
    let [honest, _] = two_vehicles(36);
    let batches = honest.batches(12);
    let theft = batches[0].with("theft", json!({"vehicle_id": "stranger"}));
    client.put("line", &theft).await;
    client.put_all("line", &batches).await;
    for batch in &batches {
        assert_eq!(ended(client, &batch.id).await["status"], "quarantined");
    }
    let (status, problem) = client.retry("line", &batches[0].id).await;
    assert_eq!(
        (status, problem["type"].as_str()),
        (409, Some("/problems/retry-refused"))
    );
    assert!(
        problem["detail"]
            .as_str()
            .unwrap()
            .contains("remove that trip first")
    );

    let asked = json!({"vehicle_id": "stranger", "since": "2020-01-01T00:00:00Z"});
    let done = client.remove("line", asked).await;
    assert_eq!(done["result"]["batches"], 1, "{done}");
    for batch in &batches {
        let (status, reported) = client.retry("line", &batch.id).await;
        assert_eq!(status, 202, "{reported}");
        assert_eq!(ended(client, &batch.id).await["status"], "merged");
    }
    let (status, problem) = client.retry("line", &batches[0].id).await;
    assert_eq!(status, 409, "{problem}");
    assert_eq!(client.retry("line", "none").await.0, 404);
    let state = State::of(client, "line").await;
    assert!(
        state
            .nodes
            .iter()
            .all(|node| node["vehicle_id"] == "agv-01")
    );
    assert!(pose_of(&state.nodes[0]["pose"]).is_finite());
    service.stop().await;
}
