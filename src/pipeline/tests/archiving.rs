//! Trips that are archived, and what reactivates them.

use std::collections::BTreeMap;

use jiff::{SignedDuration, Timestamp};

use super::bench::{Bench, at, route, upload, upload_part, upload_spaced};
use crate::change::{AlertAction, AlertStatus};
use crate::graph::{EdgeKind, EdgeStatus};
use crate::ids::{NodeId, TripId};
use crate::model::BatchStatus;
use crate::store::{BatchContent, NewBatch, NodeRecord};

/// This many segments stay active.
const SEGMENTS: usize = 3;

/// A map of two laps, and laps of the hours after that, in which a box stands there.
async fn driven(hours: std::ops::RangeInclusive<i64>) -> Bench {
    let bench = Bench::new().await;
    bench.merge(upload("before", 0, 2), SEGMENTS).await;
    for hour in hours {
        lap(&bench, hour).await;
    }
    bench
}

async fn lap(bench: &Bench, hour: i64) {
    let batch = bench.merge(upload(&format!("lap-{hour}"), hour, 1), SEGMENTS);
    assert_eq!(batch.await.status, BatchStatus::Merged);
}

fn by_id(nodes: &[NodeRecord]) -> BTreeMap<NodeId, &NodeRecord> {
    nodes.iter().map(|node| (node.id, node)).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn archived_nodes_leave_the_map_and_stay_in_the_store() {
    let bench = driven(1..=5).await;
    let early = bench.state().await;
    let mut active = Vec::new();
    for hour in 6..=12 {
        lap(&bench, hour).await;
        active.push(bench.engine.store.active_nodes(&route()).await.unwrap());
    }
    let late = bench.state().await;
    assert!(late.nodes.len() > 2 * early.nodes.len());
    // It goes up and down by a lap or two, and no higher for it.
    let most = active.iter().max().unwrap();
    let lap_nodes = (late.nodes.len() - early.nodes.len()) as i64 / 7;
    let references = late.nodes.iter().filter(|node| node.reference).count() as i64;
    assert!(*most < references + 6 * lap_nodes, "{active:?}");
    let late_nodes = by_id(&late.nodes);
    let mut settled = 0;
    for node in &early.nodes {
        let now = late_nodes[&node.id];
        assert_eq!(
            (&node.trip_id, node.trip_order),
            (&now.trip_id, now.trip_order)
        );
        assert!(now.active || !now.reference);
        assert_eq!(node.subgraph_id, now.subgraph_id);
        settled += i32::from(!now.active);
        if !node.active {
            assert_eq!(node, now, "what has left does not move");
        }
    }
    assert!(settled > 60, "{settled}");
    let edges = early.edges.iter().zip(&late.edges);
    assert!(
        edges
            .clone()
            .all(|(then, now)| then.id == now.id && now.status == then.status)
    );

    // Its first nodes tell of the box since when it is there, and its last ones that it still is.
    let alert = &bench.alerts().await[0];
    assert_eq!(alert.status, AlertStatus::Open);
    assert_eq!(
        alert.evidence.since,
        late_first_look(&late.nodes, &alert.evidence.nodes)
    );
    let newest = late.nodes.last().unwrap().trip_id.clone();
    assert!(alert.evidence.trips.contains(&newest));
    assert!(
        alert
            .evidence
            .trips
            .contains(&TripId::new("lap-1").unwrap())
    );
}

/// The first of some nodes that is not of the drive before the change.
fn late_first_look(nodes: &[NodeRecord], named: &[NodeId]) -> crate::ids::StampNs {
    let named = nodes.iter().filter(|node| named.contains(&node.id));
    let after = named.filter(|node| node.trip_id.as_str() != "before");
    after.map(|node| node.stamp).min().unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_map_from_the_store_is_archived_as_the_one_in_memory() {
    let kept = driven(1..=8).await;
    let mut restarted = driven(1..=1).await;
    for hour in 2..=8 {
        restarted = restarted.restarted().await;
        lap(&restarted, hour).await;
    }
    let (kept_state, restarted_state) = (kept.state().await, restarted.state().await);
    assert!(kept_state.nodes.iter().any(|node| !node.active));
    assert!(kept_state == restarted_state);
    let evidence = |alerts: Vec<crate::store::AlertRecord>| -> Vec<_> {
        let raised = alerts.into_iter();
        raised.map(|a| (a.status, a.evidence, a.residual)).collect()
    };
    let (kept, restarted) = (kept.alerts().await, restarted.alerts().await);
    assert_eq!(evidence(kept), evidence(restarted));
}

/// A lap with a scan every 0.2 m, most of which make no keyframe, in two parts.
fn dense_lap(hour: i64) -> (NewBatch, NewBatch) {
    let trip = format!("lap-{hour}");
    let mut first = upload_spaced(&trip, hour, 1, 0, 0.2);
    let half = usize::try_from(first.content.scans() / 2 + hour).unwrap();
    let mut body: serde_json::Value = serde_json::from_slice(&first.body).unwrap();
    body["scans"].as_array_mut().unwrap().truncate(half);
    first.body = serde_json::to_vec(&body).unwrap();
    first.content = BatchContent::Scans {
        sequence: 0,
        scans: half as i64,
    };
    let second = upload_spaced(&trip, hour, 1, half, 0.2);
    (first, second)
}

#[tokio::test(flavor = "multi_thread")]
async fn scans_between_keyframes_are_the_same_after_restarts() {
    let kept = Bench::new().await;
    let mut restarted = Bench::new().await;
    let mut continued = 0;
    for hour in 0..=5 {
        let (first, second) = dense_lap(hour);
        let (trip, half) = (first.trip_id.clone(), first.content.scans() as usize);
        for batch in [first, second] {
            restarted = restarted.restarted().await;
            for bench in [&kept, &restarted] {
                let merged = bench.merge(batch.clone(), SEGMENTS).await;
                assert_eq!(merged.status, BatchStatus::Merged);
            }
        }
        let store = &kept.engine.store;
        let trajectory = store.trajectory(&route(), &trip).await.unwrap();
        // The second part may begin behind a keyframe of the first.
        continued += i32::from(!trajectory[half].is_keyframe);
    }
    let restarted = restarted.restarted().await;
    let (kept, restarted) = (kept.state().await, restarted.state().await);
    assert!(kept == restarted);
    let between = kept.intermediate.values().flatten();
    let between = between.filter(|between| between.scan.is_some()).count();
    assert!(between > 100, "{between}");
    assert!(continued > 0);
    assert!(kept.nodes.iter().any(|node| !node.active));
    assert!(kept.nodes.iter().all(|node| node.sigma.is_some()));
    assert!(kept.nodes[0].sigma.is_some_and(|sigma| sigma.x_m == 0.0));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_late_batch_of_an_archived_trip_goes_on_where_the_trip_ended() {
    let bench = driven(1..=1).await;
    let mut first_half = upload("late", 2, 1);
    let whole = first_half.content.scans();
    let from = usize::try_from(whole / 2).unwrap();
    let mut body: serde_json::Value = serde_json::from_slice(&first_half.body).unwrap();
    body["scans"].as_array_mut().unwrap().truncate(from);
    first_half.body = serde_json::to_vec(&body).unwrap();
    bench.merge(first_half, SEGMENTS).await;
    for hour in 3..=9 {
        lap(&bench, hour).await;
    }
    let store = &bench.engine.store;
    let trip = TripId::new("late").unwrap();
    let before = store.trip_nodes(&route(), &trip).await.unwrap();
    let last = before.last().unwrap().clone();
    assert!(!last.active);
    let edges_before = store.edges(&route()).await.unwrap().len();

    let late = upload_part("late", 2, 1, from);
    let late = bench.merge(late, SEGMENTS).await;
    assert_eq!(late.status, BatchStatus::Merged);
    assert!(late.nodes_added > 10 && late.loop_closures > 10, "{late:?}");
    let after = store.trip_nodes(&route(), &trip).await.unwrap();
    assert_eq!(after.len() as i64, before.len() as i64 + late.nodes_added);
    let orders: Vec<u32> = after.iter().map(|node| node.trip_order).collect();
    assert_eq!(orders, Vec::from_iter(0..after.len() as u32));
    let edges = store.edges(&route()).await.unwrap();
    let first = after[before.len()].id;
    let tie = edges[edges_before..]
        .iter()
        .find(|e| e.kind == EdgeKind::Odometry);
    let tie = tie.unwrap();
    assert_eq!((tie.from, tie.to), (last.id, first));
    let way_m = (after[before.len()].pose.translation() - last.pose.translation()).norm();
    assert!(way_m < 1.0, "{way_m}");
    // What the fetched nodes added to F is no news of the new ones.
    let deltas = edges[edges_before..].iter().filter_map(|edge| edge.delta_f);
    assert!(deltas.clone().all(|delta_f| delta_f > -1e-6));

    // Every scan is known with its pose, those between keyframes of either batch among them.
    let trajectory = store.trajectory(&route(), &trip).await.unwrap();
    assert_eq!(trajectory.len() as i64, whole);
    assert!(trajectory.is_sorted_by(|a, b| a.stamp < b.stamp));
    let keyframes = trajectory.iter().filter(|pose| pose.is_keyframe);
    let keyframes: Vec<_> = keyframes.map(|pose| (pose.node_id, pose.pose)).collect();
    let nodes: Vec<_> = after.iter().map(|node| (node.id, node.pose)).collect();
    assert_eq!(keyframes, nodes);
    let steps_m = trajectory.windows(2).map(|pair| {
        let [a, b] = [pair[0].pose, pair[1].pose].map(|pose| pose.translation());
        (b - a).norm()
    });
    assert!(steps_m.fold(0.0, f64::max) < 0.8);

    for hour in 10..=13 {
        lap(&bench, hour).await;
    }
    let left = store.trajectory(&route(), &trip).await.unwrap();
    assert_eq!(left.len(), trajectory.len(), "also of what has left");
    let settled = store.trip_nodes(&route(), &trip).await.unwrap();
    assert!(settled.iter().all(|node| !node.active || node.reference));
    bench.state().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_was_accepted_can_be_undone_after_it_was_archived() {
    let mut bench = driven(1..=2).await;
    let alert = bench.alerts().await.remove(0);
    let before = bench.state().await;
    let accepted = bench.decide(&alert, AlertAction::Accept).await;
    let retired = |state: &super::bench::MapState| -> Vec<i64> {
        let edges = state.edges.iter();
        let retired = edges.filter(|edge| edge.status == EdgeStatus::Retired);
        retired.map(|edge| edge.id.0).collect()
    };
    assert!(!retired(&bench.state().await).is_empty());
    for hour in 3..=9 {
        lap(&bench, hour).await;
    }
    bench = bench.restarted().await;
    let settled = bench.state().await;
    let nodes = by_id(&settled.nodes);
    let ends = settled
        .edges
        .iter()
        .filter(|e| e.status == EdgeStatus::Retired);
    let gone = ends.filter(|e| !nodes[&e.from].active || !nodes[&e.to].active);
    assert!(gone.count() > 0, "nothing of it has left");

    bench.decide(&accepted, AlertAction::Undo).await;
    let after = bench.state().await;
    assert!(retired(&after).is_empty());
    let known = by_id(&after.nodes);
    for node in &before.nodes {
        assert_eq!(node.reference, known[&node.id].reference, "{}", node.id);
    }
    // It can be accepted again, and the route goes on.
    lap(&bench, 10).await;
    let again = bench.alerts().await;
    let again = again
        .iter()
        .find(|alert| alert.status == AlertStatus::Open)
        .unwrap();
    bench.decide(again, AlertAction::Accept).await;
    lap(&bench, 11).await;
    bench.state().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_lies_between_archived_keyframes_is_deleted_and_nothing_else() {
    let bench = Bench::new().await;
    let trips = ["a", "b", "c", "d", "e", "f"];
    for (hour, trip) in (0..).zip(trips) {
        // Most of its scans make no keyframe.
        let lap = upload_spaced(trip, hour, 1, 0, 0.2);
        bench.merge(lap, SEGMENTS).await;
    }
    let before = bench.state().await;
    let archived = before.nodes.iter().filter(|node| !node.active);
    let archived: Vec<NodeId> = archived.map(|node| node.id).collect();
    let store = &bench.engine.store;
    let trajectories = || async {
        let mut all = Vec::new();
        for trip in trips {
            let trip = TripId::new(trip).unwrap();
            all.extend(store.trajectory(&route(), &trip).await.unwrap());
        }
        all
    };
    let mut expected = trajectories().await;
    let scans = expected.len();
    let early = store.delete_trajectories(at(0), 0).await.unwrap();
    assert_eq!((early.scans, early.next), (0, None));

    let later = Timestamp::now() + SignedDuration::from_hours(1);
    let deleted = store.delete_trajectories(later, 0).await.unwrap();
    let rest = store.delete_trajectories(later, deleted.next.unwrap());
    assert_eq!(rest.await.unwrap(), Default::default());
    let again = store.delete_trajectories(later, 0).await.unwrap();
    assert_eq!((again.scans, again.next), (0, deleted.next));
    assert!(deleted.scans > 20, "{deleted:?}");

    expected.retain(|pose| pose.is_keyframe || !archived.contains(&pose.node_id));
    assert_eq!(scans - expected.len(), deleted.scans as usize);
    assert!(trajectories().await == expected);
    assert!(bench.state().await == before, "the map is as it was");
}
