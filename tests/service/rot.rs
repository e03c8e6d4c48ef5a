//! Bits that flip on the disk: what reads answer then, what becomes of later batches, and what
//! `mapshift fsck` says.

use std::path::Path;
use std::process::Command;
use std::time::Duration;

use serde_json::{Value, json};
use sqlx::sqlite::{SqliteConnectOptions, SqliteConnection};
use sqlx::{AssertSqlSafe, ConnectOptions};
use tempfile::TempDir;

use crate::client::Client;
use crate::drives::{Batch, two_vehicles};
use crate::running::Running;

/// Rot is in the first one alone.
const ROUTES: [&str; 2] = ["line", "other"];

/// Two routes with the same batches, as a service leaves them that was stopped.
async fn driven(batches: &[&Batch]) -> TempDir {
    let directory = TempDir::new().unwrap();
    let service = Running::start_in(directory.path()).await;
    for route in ROUTES {
        service.client.put_route(route, Value::Null).await;
        service.client.put_all(route, batches.iter().copied()).await;
        service.client.settled(route, false).await;
    }
    service.stop().await;
    directory
}

async fn raw(directory: &Path) -> SqliteConnection {
    let path = directory.join("data").join("mapshift.db");
    let options = SqliteConnectOptions::new().filename(path);
    options.connect().await.unwrap()
}

/// Flips a bit of some bytes.
async fn flip_bytes(directory: &Path, table: &str, column: &str, which: &str) {
    let mut raw = raw(directory).await;
    let read = format!("SELECT {column} FROM {table} WHERE {which}");
    let read = sqlx::query_scalar(AssertSqlSafe(read)).fetch_one(&mut raw);
    let mut bytes: Vec<u8> = read.await.unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    let write = format!("UPDATE {table} SET {column} = ? WHERE {which}");
    let write = sqlx::query(AssertSqlSafe(write)).bind(bytes);
    assert_eq!(write.execute(&mut raw).await.unwrap().rows_affected(), 1);
}

/// Flips a bit of a number, or flips it back.
async fn flip_number(directory: &Path, table: &str, column: &str, which: &str) {
    let mut raw = raw(directory).await;
    let read = format!("SELECT {column} FROM {table} WHERE {which}");
    let read = sqlx::query_scalar(AssertSqlSafe(read)).fetch_one(&mut raw);
    let number: f64 = read.await.unwrap();
    let write = format!("UPDATE {table} SET {column} = ? WHERE {which}");
    let write = sqlx::query(AssertSqlSafe(write)).bind(f64::from_bits(number.to_bits() ^ 1));
    assert_eq!(write.execute(&mut raw).await.unwrap().rows_affected(), 1);
}

/// Whether `mapshift fsck` ends well, and what it prints.
fn fsck(directory: &Path) -> (bool, Value) {
    let checked = Command::new(env!("CARGO_BIN_EXE_mapshift"))
        .args(["fsck", "--data"])
        .arg(directory.join("data"))
        .output()
        .unwrap();
    assert!(checked.stderr.is_empty(), "{checked:?}");
    let report = serde_json::from_slice(&checked.stdout).unwrap();
    (checked.status.success(), report)
}

/// What `mapshift fsck` finds, which is something.
fn faults(directory: &Path) -> Vec<String> {
    let (ended_well, report) = fsck(directory);
    assert!(!ended_well);
    assert_eq!(report["sound"], false);
    let faults = report["faults"].as_array().unwrap().iter();
    let what = faults.map(|fault| fault["what"].as_str().unwrap().to_owned());
    what.collect()
}

async fn is_corrupt(client: &Client, path: &str, what: &str) {
    let (status, problem) = client.get_any(path).await;
    assert_eq!(status, 500, "{problem}");
    assert_eq!(problem["type"], "/problems/corrupt");
    assert_eq!(problem["detail"], format!("{what} is corrupt on the disk"));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_corrupt_scan_or_body_costs_no_batch_but_its_own() {
    let [first, second] = two_vehicles(60);
    let (first, second) = (first.batches(12), second.batches(12));
    // The fourth waits for the third.
    let directory = driven(&[&first[0], &first[1], &first[3]]).await;
    let directory = directory.path();
    let (is_sound, report) = fsck(directory);
    assert!(is_sound, "{report}");
    assert_eq!(
        (&report["sound"], &report["routes"]),
        (&json!(true), &json!(2))
    );
    assert_eq!(
        (&report["batches"], &report["faults"]),
        (&json!(6), &json!([]))
    );
    assert!(report["nodes"].as_u64() > Some(20) && report["edges"].as_u64() > Some(20));

    // The last node is the one that the trip's next scans are matched with.
    let of_line = "route_key = (SELECT route_key FROM routes WHERE id = 'line')";
    let last = "node_id = (SELECT max(node_id) FROM nodes AS other \
                WHERE other.route_key = node_scans.route_key)";
    flip_bytes(
        directory,
        "node_scans",
        "scan",
        &format!("{of_line} AND {last}"),
    )
    .await;
    let body = format!(
        "batch_key = (SELECT batch_key FROM batches WHERE {of_line} AND id = '{}')",
        first[3].id
    );
    flip_bytes(directory, "batch_bodies", "body", &body).await;
    let found = faults(directory);
    let node = found[1].split_whitespace().nth(4).unwrap();
    let scan = format!("the scan of node {node} of route line");
    let body = format!("the body of batch {} of route line", first[3].id);
    assert_eq!(found, [body.as_str(), scan.as_str()]);

    let service = Running::start_in(directory).await;
    let client = &service.client;
    is_corrupt(client, &format!("/v1/routes/line/nodes/{node}/scan"), &scan).await;
    for path in [
        "nodes",
        "edges",
        "graph",
        "map.png",
        "residuals",
        "subgraphs",
    ] {
        client.bytes(&format!("/v1/routes/line/{path}")).await;
    }
    for route in ROUTES {
        client
            .put_all(route, [&first[2], &first[4]].into_iter().chain(&second))
            .await;
        for batch in client.settled(route, true).await {
            let is_rotten = route == "line" && batch["id"] == first[3].id.as_str();
            let expected = if is_rotten { "quarantined" } else { "merged" };
            assert_eq!(batch["status"], expected, "{batch}");
            assert!(!is_rotten || batch["reason"].as_str().unwrap().contains("corrupt"));
        }
    }
    service.stop().await;
    assert_eq!(faults(directory).len(), 2);
}

/// The reason that a batch has by now.
async fn reason(client: &Client, route: &str, id: &str) -> String {
    loop {
        let batch = client.batch(route, id).await;
        if let Some(reason) = batch["reason"].as_str() {
            return reason.to_owned();
        }
        assert_ne!(batch["status"], "merged");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_corrupt_node_or_edge_stops_its_route_and_no_other() {
    let [first, _] = two_vehicles(48);
    let batches = first.batches(12);
    let directory = driven(&[&batches[0], &batches[1]]).await;
    let directory = directory.path();
    let of_line = "route_key = (SELECT route_key FROM routes WHERE id = 'line')";
    for (batch, table, column, key, what, list) in [
        (&batches[2], "nodes", "odom_x", "node_id", "node 3", "nodes"),
        (
            &batches[3],
            "edges",
            "info_tt",
            "edge_id",
            "edge 3",
            "edges",
        ),
    ] {
        let which = format!("{of_line} AND {key} = 3");
        flip_number(directory, table, column, &which).await;
        assert_eq!(faults(directory), [format!("{what} of route line")]);

        let service = Running::start_in(directory).await;
        let client = &service.client;
        is_corrupt(client, &format!("/v1/routes/line/{list}"), what).await;
        is_corrupt(client, &format!("/v1/routes/line/{list}/3"), what).await;
        client.put_all("line", [batch]).await;
        client.put_all("other", [batch]).await;
        client.merged("other").await;
        client.bytes(&format!("/v1/routes/other/{list}")).await;
        let reason = reason(client, "line", &batch.id).await;
        assert!(reason.contains(&format!("{what} is corrupt")), "{reason}");
        // As nothing was written meanwhile, the batch is none the worse for it.
        flip_number(directory, table, column, &which).await;
        client.merged("line").await;
        assert!(fsck(directory).0);
        service.stop().await;
    }
}
