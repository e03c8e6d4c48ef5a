//! Neither the order of arrival nor a restart changes what is told in the end.

use serde_json::Value;
use tempfile::TempDir;

use super::shop::Shop;
use super::told::{ROUTE, alerts, brief, empty_route, place, statuses};
use crate::drives::{Batch, shuffled};
use crate::running::Running;

const LAPS: usize = 5;
/// Alerts of one kind so near to each other are the same, metres.
const SAME_M: f64 = 0.1;

/// A crate comes, the cupboard goes, and a second crate is parked for a lap.
fn shop() -> Shop {
    Shop::new(9).with_crate(2, None).without_cupboard(3)
}

fn laps() -> Vec<Vec<Batch>> {
    let shop = shop();
    (0..LAPS).map(|lap| shop.lap(lap)).collect()
}

async fn told_of(uploads: &[Batch]) -> Vec<Value> {
    let service = empty_route().await;
    service.client.put_all(ROUTE, uploads).await;
    service.client.merged(ROUTE).await;
    let told = alerts(&service.client).await;
    service.stop().await;
    told
}

/// In the order of kinds and places.
fn sorted(mut alerts: Vec<Value>) -> Vec<Value> {
    alerts.sort_by(|a, b| {
        let key = |alert: &Value| (alert["kind"].to_string(), alert["status"].to_string());
        let across = |alert: &Value| place(alert).x;
        key(a).cmp(&key(b)).then(across(a).total_cmp(&across(b)))
    });
    alerts
}

/// Why two sets of alerts are not the same.
fn difference(expected: &[Value], told: &[Value]) -> Option<String> {
    let same = |(a, b): (&Value, &Value)| {
        let of = |field: &str| a[field] == b[field];
        of("kind") && of("status") && (place(a) - place(b)).norm() <= SAME_M
    };
    let agree = expected.len() == told.len() && expected.iter().zip(told).all(same);
    let lines = |all: &[Value]| {
        let lines = all
            .iter()
            .map(|a| format!("{} {:?}", brief(a), statuses(a)));
        lines.collect::<Vec<_>>().join("\n  ")
    };
    (!agree).then(|| format!("expected\n  {}\ntold\n  {}", lines(expected), lines(told)))
}

/// Whole trips in another order, or all batches.
fn reordered(laps: &[Vec<Batch>], seed: u64) -> Vec<Batch> {
    if seed % 2 == 1 {
        return shuffled(laps.concat(), seed);
    }
    let firsts: Vec<Batch> = laps.iter().map(|lap| lap[0].clone()).collect();
    let of_lap = |first: Batch| laps.iter().find(move |lap| lap[0].id == first.id);
    let order = shuffled(firsts, seed).into_iter().filter_map(of_lap);
    order.flatten().cloned().collect()
}

async fn any_order_tells_the_same(seeds: std::ops::Range<u64>) {
    let laps = laps();
    let expected = sorted(told_of(&laps.concat()).await);
    let kinds: Vec<&Value> = expected.iter().map(|alert| &alert["kind"]).collect();
    assert_eq!(kinds, ["appeared", "disappeared"], "{expected:?}");
    let mut wrong = Vec::new();
    for seed in seeds {
        let uploads = reordered(&laps, seed);
        let told = sorted(told_of(&uploads).await);
        if let Some(difference) = difference(&expected, &told) {
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

/// `cargo test --release --test service -- --ignored twenty_orders`
#[tokio::test(flavor = "multi_thread")]
#[ignore = "takes a minute"]
async fn twenty_orders_end_in_the_same_alerts() {
    any_order_tells_the_same(100..120).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_restart_in_the_middle_tells_the_same() {
    let laps = laps();
    let undisturbed = sorted(told_of(&laps.concat()).await);
    let directory = TempDir::new().unwrap();
    for (lap, batches) in laps.iter().enumerate() {
        // The batches of the lap before are still under way, or were just told of.
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
    let told = sorted(alerts(&service.client).await);
    service.stop().await;
    assert_eq!(difference(&undisturbed, &told), None);
    for (a, b) in undisturbed.iter().zip(&told) {
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
