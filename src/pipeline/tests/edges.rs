//! Batches of edges over many laps: what is archived, and what they name of it.

use std::f64::consts::FRAC_PI_2;

use jiff::Timestamp;
use serde_json::{Value, json};

use super::bench::{Bench, at, route};
use crate::ids::{BatchId, TripId, VehicleId};
use crate::model::BatchStatus;
use crate::store::{BatchContent, BatchRecord, NewBatch, NodeRecord};

/// This many segments stay active.
const SEGMENTS: usize = 3;
/// Nodes of a lap round a square, a metre apart.
const LAP: usize = 20;

/// A motion without noise; closures stay where they are.
fn edge(from: String, to: String, ahead: bool, turned: bool) -> Value {
    let x = if ahead { 1.0 } else { 0.0 };
    let theta = if ahead && turned { FRAC_PI_2 } else { 0.0 };
    json!({
        "from": from, "to": to,
        "measurement": {"x": x, "y": 0.0, "theta": theta},
        "information": [2500.0, 0.0, 0.0, 2500.0, 0.0, 1e4],
        "kind": if ahead { "odometry" } else { "loop_closure" },
    })
}

/// A lap as a trip of its own, an hour after the one before, tied node by node to lap `tied_to`.
fn lap(hour: i64, tied_to: Option<i64>) -> NewBatch {
    let name = |hour: i64, k: usize| format!("{hour}.{k}");
    let nodes = (0..LAP).map(|k| {
        let stamp = Timestamp::from_second(at(hour).as_second() + k as i64).unwrap();
        json!({"id": name(hour, k), "pose": {"x": 0.0, "y": 0.0, "theta": 0.0}, "stamp": stamp})
    });
    let odometry = (1..LAP).map(|k| {
        let turned = k.is_multiple_of(LAP / 4);
        edge(name(hour, k - 1), name(hour, k), true, turned)
    });
    let ties = (0..LAP).filter_map(|k| {
        let old = name(tied_to?, k);
        Some(edge(old, name(hour, k), false, false))
    });
    let body = json!({
        "vehicle_id": "tugger",
        "nodes": nodes.collect::<Vec<_>>(),
        "edges": odometry.chain(ties).collect::<Vec<_>>(),
    });
    NewBatch {
        route_id: route(),
        id: BatchId::new(format!("lap-{hour}")).unwrap(),
        vehicle_id: VehicleId::new("tugger").unwrap(),
        trip_id: TripId::new(format!("lap-{hour}")).unwrap(),
        content: BatchContent::Edges,
        flags: Vec::new(),
        out_of_range: None,
        extensions: None,
        body: serde_json::to_vec(&body).unwrap(),
        received_at: at(hour),
    }
}

async fn merge(bench: &Bench, batch: NewBatch) -> BatchRecord {
    let merged = bench.merge(batch, SEGMENTS).await;
    assert_eq!(merged.status, BatchStatus::Merged, "{merged:?}");
    merged
}

async fn nodes_of(bench: &Bench, hour: i64) -> Vec<NodeRecord> {
    let trip = TripId::new(format!("lap-{hour}")).unwrap();
    let store = &bench.engine.store;
    store.trip_nodes(&route(), &trip).await.unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn laps_are_archived_and_reactivated_when_they_are_named() {
    let bench = Bench::new().await;
    merge(&bench, lap(0, None)).await;
    for hour in 1..=9 {
        merge(&bench, lap(hour, Some(0))).await;
    }
    let store = &bench.engine.store;
    let active = store.active_nodes(&route()).await.unwrap() as usize;
    assert!(active <= (SEGMENTS + 3) * LAP, "{active}");
    let first = nodes_of(&bench, 0).await;
    assert!(first.iter().all(|node| node.reference && node.active));
    let second = nodes_of(&bench, 1).await;
    assert!(second.iter().all(|node| !node.reference && !node.active));
    // The second lap is no reference; who names it gets it all the same.
    let late = merge(&bench, lap(10, Some(1))).await;
    assert_eq!(late.loop_closures, LAP as i64);
    assert!(nodes_of(&bench, 1).await.iter().all(|node| node.active));
    let [new, old] = [nodes_of(&bench, 10).await, nodes_of(&bench, 1).await];
    for (new, old) in new.iter().zip(&old) {
        let apart = new.pose.between(&old.pose);
        assert!(apart.translation().norm() < 1e-6 && apart.theta.abs() < 1e-6);
    }
    for hour in 11..=14 {
        merge(&bench, lap(hour, Some(0))).await;
    }
    assert!(nodes_of(&bench, 1).await.iter().all(|node| !node.active));
    let state = bench.state().await;
    let bench = bench.restarted().await;
    assert_eq!(bench.state().await, state);
}
