//! `mapshift replay`: from the journal of what shaped it, a map is rebuilt to the bit.

use std::path::Path;
use std::process::Command;

use mapshift::store::fsck;
use serde_json::{Value, json};
use sqlx::ConnectOptions;
use sqlx::sqlite::SqliteConnectOptions;
use tempfile::TempDir;

use crate::changes::{ROUTE, Shop, alerts, only};
use crate::client::Client;
use crate::running::Running;
use crate::state::State;

/// Everything that shapes a map, one after the other.
pub async fn live_through_everything(client: &Client) {
    client.put_route(ROUTE, json!({"hold_s": 0})).await;
    let shop = Shop::new(5).with_crate(2, None);
    for lap in 0..2 {
        drive(client, &shop, lap).await;
    }
    let reported = only(drive(client, &shop, 2).await);
    let talked_about = format!("/v1/alerts/{}/comments", reported["id"].as_str().unwrap());
    let comment = json!({"text": "a crate, it seems"});
    assert_eq!(client.post(talked_about, comment).await.0, 201);
    let zone =
        json!({"polygon": [[5.0, 3.0], [8.0, 3.0], [8.0, 5.0], [5.0, 5.0]], "purpose": "mute"});
    let zones = format!("/v1/routes/{ROUTE}/zones");
    assert_eq!(client.post(zones, zone).await.0, 201);
    let taken_up = client.decide(&reported, "acknowledge").await;
    let accepted = client.decide(&taken_up, "accept").await;
    let undone = client.decide(&accepted, "undo").await;
    client
        .put_route(ROUTE, json!({"false_alarm_rate": 0.05}))
        .await;
    drive(client, &shop, 3).await;
    let reported = alerts(client).await;
    let reported = reported.iter().find(|alert| alert["id"] == undone["id"]);
    let versions = format!("/v1/routes/{ROUTE}/versions");
    let release = json!({"note": "first one"});
    client.post(format!("{versions}/3/release"), release).await;
    client.decide(reported.unwrap(), "accept").await;
    let release = json!({});
    client.post(format!("{versions}/5/release"), release).await;
    client
        .post(format!("{versions}/3/retire"), Value::Null)
        .await;

    let vehicle = format!("/v1/routes/{ROUTE}/vehicles/agv-00");
    client
        .post(format!("{vehicle}/quarantine"), json!({}))
        .await;
    for batch in shop.lap(4) {
        client.put(ROUTE, &batch).await;
        assert_eq!(
            client.ended(ROUTE, &batch.id).await["status"],
            "quarantined"
        );
    }
    client.post(format!("{vehicle}/release"), Value::Null).await;

    // The first batch never comes: the others are used without it.
    let torn = &shop.lap(5)[1..];
    client.put_all(ROUTE, torn).await;
    let reported = client.settled(ROUTE, true).await;
    assert!(
        reported
            .iter()
            .any(|batch| batch["flags"] == json!(["gap"]))
    );
    let removed = client.remove(ROUTE, json!({"trips": ["lap-01"]})).await;
    assert_eq!(removed["status"], "succeeded", "{removed}");
    drive(client, &shop, 6).await;
    // What waits at the end waits in the copy as well.
    client.put_route(ROUTE, json!({"hold_s": 600})).await;
    client.put_all(ROUTE, &shop.lap(7)[1..]).await;
}

/// Sends one lap and hands back every alert when it has ended, the newest first.
async fn drive(client: &Client, shop: &Shop, lap: usize) -> Vec<Value> {
    client.put_all(ROUTE, &shop.lap(lap)).await;
    client.settled(ROUTE, true).await;
    alerts(client).await
}

/// Whether `mapshift replay` ends well, and what it says of its one route.
pub fn replay(data: &Path, rest: &[&str]) -> (bool, Value) {
    let replayed = Command::new(env!("CARGO_BIN_EXE_mapshift"))
        .args(["replay", "--data"])
        .arg(data)
        .args(rest)
        .output()
        .unwrap();
    let report: Value = serde_json::from_slice(&replayed.stdout).unwrap();
    assert_eq!(report.as_array().map(Vec::len), Some(1), "{replayed:?}");
    (replayed.status.success(), report[0].clone())
}

async fn execute(data: &Path, statement: &'static str) {
    let options = SqliteConnectOptions::new().filename(data.join("mapshift.db"));
    let mut raw = options.connect().await.unwrap();
    let done = sqlx::query(statement).execute(&mut raw).await.unwrap();
    assert_eq!(done.rows_affected(), 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_map_made_anew_is_the_same_to_the_bit() {
    let directory = TempDir::new().unwrap();
    let service = Running::start_in(directory.path()).await;
    let client = &service.client;
    live_through_everything(client).await;
    let data = directory.path().join("data");

    // Beside the running service.
    let copy = directory.path().join("copy");
    let (ended_well, reported) = replay(&data, &["--compare", "--into", copy.to_str().unwrap()]);
    assert!(
        ended_well && reported["comparison"]["same"] == true,
        "{reported}"
    );
    let none = json!({"to_occupied": 0, "to_free": 0, "to_unknown": 0, "from_unknown": 0});
    assert_eq!(reported["cells"], none);
    assert_eq!(reported["decisions_left_out"], json!([]));
    assert_eq!(reported["versions_left_out"], json!([]));
    assert_eq!(reported["without_body"], 0);
    let (state, reported) = (State::of(client, ROUTE).await, alerts(client).await);
    let batches = client
        .list(&format!("/v1/routes/{ROUTE}/batches"), 50)
        .await;
    assert!(batches.iter().any(|batch| batch["status"] == "held"));
    service.stop().await;
    let left: Vec<_> = std::fs::read_dir(directory.path()).unwrap().collect();
    assert_eq!(left.len(), 2, "{left:?}");

    let report = fsck(&copy, true, &|_, _| {}).await.unwrap();
    assert!(report.sound, "{:?}", report.faults);
    let copied = TempDir::new().unwrap();
    std::fs::rename(&copy, copied.path().join("data")).unwrap();
    let service = Running::start_in(copied.path()).await;
    let client = &service.client;
    assert!(State::of(client, ROUTE).await == state);
    assert_eq!(alerts(client).await, reported);
    let again = client
        .list(&format!("/v1/routes/{ROUTE}/batches"), 50)
        .await;
    assert_eq!(again, batches);
    service.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_does_not_follow_from_the_journal_is_reported() {
    let directory = TempDir::new().unwrap();
    let service = Running::start_in(directory.path()).await;
    let client = &service.client;
    client.put_route(ROUTE, Value::Null).await;
    let shop = Shop::new(5);
    for lap in 0..2 {
        for batch in shop.lap(lap) {
            client.put(ROUTE, &batch).await;
            assert_eq!(client.ended(ROUTE, &batch.id).await["status"], "merged");
        }
    }
    service.stop().await;
    let data = directory.path().join("data");

    execute(&data, "UPDATE nodes SET x = x + 0.25 WHERE node_id = 7").await;
    let (ended_well, reported) = replay(&data, &["--compare"]);
    assert!(!ended_well);
    let comparison = &reported["comparison"];
    let apart = json!({"nodes": {"only_before": 1, "only_now": 1}});
    assert_eq!(
        (&comparison["same"], &comparison["tables"]),
        (&json!(false), &apart)
    );
    assert_eq!(comparison["poses"]["moved"], 1);
    assert_eq!(comparison["poses"]["max_m"], 0.25);
    let cells = reported["cells"].as_object().unwrap().values();
    assert!(
        cells.filter_map(Value::as_u64).sum::<u64>() > 0,
        "{reported}"
    );
    execute(&data, "UPDATE nodes SET x = x - 0.25 WHERE node_id = 7").await;
    assert!(replay(&data, &["--compare"]).0);

    execute(
        &data,
        "UPDATE batches SET body_kept = 0 WHERE id = 'lap-01-001'",
    )
    .await;
    let (ended_well, reported) = replay(&data, &["--compare"]);
    assert!(!ended_well);
    assert_eq!(reported["without_body"], 1, "{reported}");

    execute(
        &data,
        "DELETE FROM inputs WHERE input_key = (SELECT min(input_key) FROM inputs)",
    )
    .await;
    let (ended_well, reported) = replay(&data, &["--compare"]);
    let error = reported["error"].as_str().unwrap();
    assert!(
        !ended_well && error.contains("begins after its first batches"),
        "{reported}"
    );
}
