//! Neither the order of arrival nor a restart changes what is reported in the end.

use serde_json::Value;
use tempfile::TempDir;

use super::reordering::{difference, laps, reordered, sorted};
use super::reported::{ROUTE, alerts, empty_route};
use crate::drives::Batch;
use crate::running::Running;

async fn reported_of(uploads: &[Batch]) -> Vec<Value> {
    let service = empty_route().await;
    service.client.put_all(ROUTE, uploads).await;
    service.client.merged(ROUTE).await;
    let reported = alerts(&service.client).await;
    service.stop().await;
    reported
}

async fn any_order_tells_the_same(seeds: std::ops::Range<u64>) {
    let laps = laps();
    let expected = sorted(reported_of(&laps.concat()).await);
    let kinds: Vec<&Value> = expected.iter().map(|alert| &alert["kind"]).collect();
    assert_eq!(kinds, ["appeared", "disappeared"], "{expected:?}");
    let mut wrong = Vec::new();
    for seed in seeds {
        let uploads = reordered(&laps, seed);
        let reported = sorted(reported_of(&uploads).await);
        if let Some(difference) = difference(&expected, &reported) {
            let order: Vec<&str> = uploads.iter().map(|b| b.id.as_str()).collect();
            wrong.push(format!("seed {seed}, {order:?}: {difference}"));
        }
    }
    assert!(
        wrong.is_empty(),
        "{} orders differ\n{}",
        wrong.len(),
        wrong.join("\n")
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn any_order_ends_in_the_same_alerts() {
    any_order_tells_the_same(0..5).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_restart_in_the_middle_tells_the_same() {
    let laps = laps();
    let undisturbed = sorted(reported_of(&laps.concat()).await);
    let directory = TempDir::new().unwrap();
    for (lap, batches) in laps.iter().enumerate() {
        // The batches of the lap before are still under way, or were just reported.
        let service = Running::start_in(directory.path()).await;
        service.client.put_route(ROUTE, Value::Null).await;
        service.client.put_all(ROUTE, batches).await;
        if lap % 2 == 1 {
            service.client.merged(ROUTE).await;
        }
        service.stop().await;
    }
    let service = Running::start_in(directory.path()).await;
    service.client.merged(ROUTE).await;
    let reported = sorted(alerts(&service.client).await);
    service.stop().await;
    assert_eq!(difference(&undisturbed, &reported), None);
    for (a, b) in undisturbed.iter().zip(&reported) {
        for field in [
            "edge_ids",
            "node_ids",
            "trip_ids",
            "views",
            "since",
            "last_seen",
        ] {
            assert_eq!(a[field], b[field], "{field}");
        }
    }
}
