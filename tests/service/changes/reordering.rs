//! Laps of a changing shop in another order, and whether what is reported of them is the same.

use serde_json::Value;

use super::reported::{brief, place, statuses};
use super::shop::Shop;
use crate::drives::{Batch, shuffled};

const LAPS: usize = 5;
/// Alerts of one kind so near to each other are the same, metres.
const SAME_M: f64 = 0.1;

/// A crate comes, and the cupboard goes.
fn shop() -> Shop {
    Shop::new(9).with_crate(2, None).without_cupboard(3)
}

pub fn laps() -> Vec<Vec<Batch>> {
    let shop = shop();
    (0..LAPS).map(|lap| shop.lap(lap)).collect()
}

/// In the order of kinds and places.
pub fn sorted(mut alerts: Vec<Value>) -> Vec<Value> {
    alerts.sort_by(|a, b| {
        let key = |alert: &Value| (alert["kind"].to_string(), alert["status"].to_string());
        let across = |alert: &Value| place(alert).x;
        key(a).cmp(&key(b)).then(across(a).total_cmp(&across(b)))
    });
    alerts
}

/// Why two sets of alerts are not the same.
pub fn difference(expected: &[Value], reported: &[Value]) -> Option<String> {
    let same = |(a, b): (&Value, &Value)| {
        let of = |field: &str| a[field] == b[field];
        of("kind") && of("status") && (place(a) - place(b)).norm() <= SAME_M
    };
    let agree = expected.len() == reported.len() && expected.iter().zip(reported).all(same);
    let lines = |all: &[Value]| {
        let lines = all
            .iter()
            .map(|a| format!("{} {:?}", brief(a), statuses(a)));
        lines.collect::<Vec<_>>().join("\n  ")
    };
    (!agree).then(|| {
        format!(
            "expected\n  {}\nreported\n  {}",
            lines(expected),
            lines(reported)
        )
    })
}

/// Whole trips in another order, or all batches.
pub fn reordered(laps: &[Vec<Batch>], seed: u64) -> Vec<Batch> {
    if seed % 2 == 1 {
        return shuffled(laps.concat(), seed);
    }
    let firsts: Vec<Batch> = laps.iter().map(|lap| lap[0].clone()).collect();
    let of_lap = |first: Batch| laps.iter().find(move |lap| lap[0].id == first.id);
    let order = shuffled(firsts, seed).into_iter().filter_map(of_lap);
    order.flatten().cloned().collect()
}
