//! Nodes that have left the active graph, and bodies whose time is over.
//!
//! With SQL past the store, for SQLite: the length of a body as it is stored, and the statements of a migration.

use mapshift::graph::EdgeKind;
use mapshift::ids::{EdgeId, NodeId, RouteId, TripId};
use mapshift::model::BatchStatus;
use mapshift::store::{Applied, ClosureRecord, DeletedBodies, Journaled, NodeChange, Store};
use sqlx::Row;

use crate::support::{Fixture, at, batch_id, edge, intermediate, route, upload};

fn ids(ids: impl IntoIterator<Item = i64>) -> Vec<NodeId> {
    ids.into_iter().map(NodeId).collect()
}

/// A chain of ten nodes of trip `old` and one of five of trip `new`, with closures 100 + k from
/// node k to node 10 + k; nodes 3 to 9 have left.
pub async fn settled() -> Fixture {
    let fixture = Fixture::new().await;
    fixture.journal(upload("b0", "old", 0)).await;
    let job = fixture.claim(0).await.unwrap();
    let first = fixture.chain(&job, 10).await;
    fixture.store.apply_result(first.clone()).await.unwrap();
    fixture.journal(upload("b1", "new", 0)).await;
    let job = fixture.claim(0).await.unwrap();
    let mut second = fixture.chain(&job, 5).await;
    for k in 1..=5 {
        let mut closure = edge(&job.entries[0].batch, 100 + k, k, 10 + k);
        closure.kind = EdgeKind::LoopClosure;
        closure.subgraph_id = Some(1);
        closure.delta_f = Some(k as f64);
        closure.closure = Some(ClosureRecord {
            all_points_measurement: closure.measurement,
            all_points_information: closure.information,
            overlap: 0.5,
            inlier_share: 0.75,
            rmse_m: 0.01,
            all_points_residual: 0.0,
        });
        second.edges.push(closure);
    }
    let leaving = first.nodes.iter().map(|with_scan| &with_scan.node);
    let leaving = leaving.filter(|node| (3..=9).contains(&node.id.0));
    second.changed_nodes = leaving
        .map(|node| NodeChange {
            id: node.id,
            pose: node.pose,
            sigma: node.sigma,
            subgraph_id: node.subgraph_id,
            drift_m: node.drift_m,
            reference: false,
            active: false,
        })
        .collect();
    let applied = fixture.store.apply_result(second).await.unwrap();
    assert_eq!(applied, Applied::Committed);
    fixture
}

async fn active(store: &Store) -> (Vec<i64>, Vec<i64>) {
    let graph = store.load_graph(&route()).await.unwrap().unwrap();
    let nodes = graph.nodes.iter().map(|n| n.node.id.0).collect();
    (nodes, graph.edges.iter().map(|edge| edge.id.0).collect())
}

#[tokio::test]
async fn what_has_left_is_not_loaded_and_still_there() {
    let Fixture { store, .. } = &settled().await;
    let (nodes, edges) = active(store).await;
    assert_eq!(nodes, [1, 2, 10, 11, 12, 13, 14, 15]);
    // Of both chains the steps between active nodes, and two closures.
    assert_eq!(edges, [1, 10, 11, 12, 13, 101, 102]);
    assert_eq!(store.active_nodes(&route()).await.unwrap(), 8);
    let graph = store.load_graph(&route()).await.unwrap().unwrap();
    let settled = graph.archived_closures.iter();
    let settled: Vec<_> = settled
        .map(|c| (c.id.0, c.from.0, c.to.0, c.subgraph_id, c.delta_f))
        .collect();
    let expected = [3, 4, 5].map(|k| (100 + k, k, 10 + k, Some(1), k as f64));
    assert_eq!(settled, expected);

    assert_eq!(store.nodes(&route()).await.unwrap().len(), 15);
    assert_eq!(store.edges(&route()).await.unwrap().len(), 9 + 4 + 5);
    let old = TripId::new("old").unwrap();
    assert_eq!(store.trip_nodes(&route(), &old).await.unwrap().len(), 10);
    assert!(
        store
            .node_scan(&route(), NodeId(5))
            .await
            .unwrap()
            .is_some()
    );
    assert!(store.edge(&route(), EdgeId(104)).await.unwrap().is_some());
}

#[tokio::test]
async fn what_has_left_is_found_and_recalled() {
    let fixture = settled().await;
    let store = &fixture.store;
    let (old, new) = (TripId::new("old").unwrap(), TripId::new("new").unwrap());
    let tail = |trip, length| {
        let trip: &TripId = trip;
        let trip = trip.clone();
        async move { store.archived_tail(&route(), &trip, length).await.unwrap() }
    };
    assert_eq!(tail(&old, 4).await, ids(7..=9));
    assert_eq!(tail(&old, 100).await, ids(3..=9));
    assert_eq!(tail(&new, 100).await, []);
    assert_eq!(tail(&TripId::new("none").unwrap(), 9).await, []);
    let edges = [EdgeId(103), EdgeId(101), EdgeId(999)];
    let found = store
        .archived_among(&route(), &ids([2, 8, 77]), &edges)
        .await;
    assert_eq!(found.unwrap(), ids([3, 8]));

    let revision = fixture.revision(&route()).await;
    store
        .reactivate_nodes(&route(), ids([3, 4, 15, 77]))
        .await
        .unwrap();
    assert_eq!(fixture.revision(&route()).await, revision + 1);
    let (nodes, edges) = active(store).await;
    assert_eq!(nodes, [1, 2, 3, 4, 10, 11, 12, 13, 14, 15]);
    assert_eq!(edges, [1, 2, 3, 10, 11, 12, 13, 101, 102, 103, 104]);
    // Nobody is left to be recalled.
    store
        .reactivate_nodes(&route(), ids([3, 15]))
        .await
        .unwrap();
    assert_eq!(fixture.revision(&route()).await, revision + 1);
    let elsewhere = RouteId::new("elsewhere").unwrap();
    store.reactivate_nodes(&elsewhere, ids([5])).await.unwrap();
    assert_eq!(active(store).await.0.len(), 10);
}

/// What lies between archived keyframes goes; what lies between active ones stays, and so do keyframes.
#[tokio::test]
async fn only_trajectories_between_archived_keyframes_are_deleted() {
    let fixture = Fixture::new().await;
    let store = &fixture.store;
    fixture.journal(upload("b0", "t", 0)).await;
    let job = fixture.claim(0).await.unwrap();
    let mut result = fixture.chain(&job, 3).await;
    result.intermediate = (0..3).map(|place| intermediate(2, place)).collect();
    result.intermediate.push(intermediate(3, 0));
    let archived = result.nodes[1].node.clone();
    store.apply_result(result).await.unwrap();
    fixture.journal(upload("b1", "t", 1)).await;
    let job = fixture.claim(0).await.unwrap();
    let mut result = fixture.result(&job, BatchStatus::Merged).await;
    result.changed_nodes.push(NodeChange {
        id: archived.id,
        pose: archived.pose,
        sigma: archived.sigma,
        subgraph_id: archived.subgraph_id,
        drift_m: archived.drift_m,
        reference: false,
        active: false,
    });
    store.apply_result(result).await.unwrap();

    // Results are of second 50.
    let early = store.delete_trajectories(at(50), 0).await.unwrap();
    assert_eq!((early.scans, early.next), (0, None));
    let (mut deleted, mut after) = (0, Some(0));
    while let Some(key) = after {
        let step = store.delete_trajectories(at(51), key).await.unwrap();
        assert!(step.next.is_none_or(|next| next > key));
        (deleted, after) = (deleted + step.scans, step.next);
    }
    assert_eq!(deleted, 3);
    let nodes = store
        .scans_of_nodes(&route(), &ids(1..=3), 9)
        .await
        .unwrap();
    let behind: Vec<usize> = nodes.iter().map(|node| node.intermediate.len()).collect();
    assert_eq!(behind, [0, 0, 1]);
}

/// Whether the bodies of batches are there.
async fn bodies(fixture: &Fixture, names: &[&str]) -> Vec<bool> {
    let mut there = Vec::new();
    for name in names {
        let entry = fixture.store.journal_entry(&route(), &batch_id(name)).await;
        there.push(entry.unwrap().is_some());
    }
    there
}

#[tokio::test]
async fn only_bodies_of_what_is_long_in_the_map_are_deleted() {
    let fixture = Fixture::new().await;
    let store = &fixture.store;
    let names = ["merged", "given-up", "lost", "held", "queued"];
    for (name, trip) in [("merged", "a"), ("given-up", "b"), ("lost", "c")] {
        fixture.journal(upload(name, trip, 0)).await;
    }
    for end in [
        BatchStatus::Merged,
        BatchStatus::Quarantined,
        BatchStatus::Unanchored,
    ] {
        let job = fixture.claim(0).await.unwrap();
        let result = fixture.result(&job, end).await;
        store.apply_result(result).await.unwrap();
    }
    fixture.journal(upload("held", "d", 3)).await;
    fixture.journal(upload("queued", "e", 0)).await;
    // Results are of second 50.
    let early = store.delete_bodies(at(50)).await.unwrap();
    assert_eq!(early, DeletedBodies::default());
    assert_eq!(bodies(&fixture, &names).await, [true; 5]);
    let row = sqlx::query(
        "SELECT length(body) AS bytes FROM batch_bodies JOIN batches USING (batch_key) \
         WHERE id = 'merged'",
    );
    let bytes: i64 = row
        .fetch_one(&mut fixture.raw().await)
        .await
        .unwrap()
        .get("bytes");
    let deleted = store.delete_bodies(at(51)).await.unwrap();
    assert_eq!((deleted.bodies, deleted.bytes), (1, bytes as u64));
    assert_eq!(
        bodies(&fixture, &names).await,
        [false, true, true, true, true]
    );
    let again = store.delete_bodies(at(1_000_000)).await.unwrap();
    assert_eq!(again, DeletedBodies::default());
    // What the batch was is still known, and so are its bytes.
    assert_eq!(fixture.status("merged").await, BatchStatus::Merged);
    let replayed = fixture.journal(upload("merged", "a", 0)).await;
    assert_eq!(replayed, Journaled::Replayed);
}

#[tokio::test]
async fn many_bodies_are_deleted_in_steps() {
    let fixture = Fixture::new().await;
    for k in 0..40 {
        fixture
            .journal(upload(&format!("b{k}"), &format!("t{k}"), 0))
            .await;
        let job = fixture.claim(0).await.unwrap();
        let result = fixture.result(&job, BatchStatus::Merged).await;
        fixture.store.apply_result(result).await.unwrap();
    }
    let mut steps = Vec::new();
    loop {
        let deleted = fixture.store.delete_bodies(at(60)).await.unwrap();
        steps.push(deleted.bodies);
        if deleted.bodies == 0 {
            break;
        }
    }
    assert_eq!(steps, [32, 8, 0]);
}

/// The step from a database of the version before: what is in the file of the migration numbers
/// the nodes of every trip.
#[tokio::test]
async fn nodes_from_before_are_numbered_within_their_trips() {
    let fixture = Fixture::new().await;
    for (batch, trip, sequence) in [
        ("a0", "a", 0),
        ("b0", "b", 0),
        ("a1", "a", 1),
        ("b1", "b", 1),
    ] {
        fixture.journal(upload(batch, trip, sequence)).await;
        let job = fixture.claim(0).await.unwrap();
        let chain = fixture.chain(&job, 3).await;
        fixture.store.apply_result(chain).await.unwrap();
    }
    let mut raw = fixture.raw().await;
    let migration = include_str!("../../migrations/0004_settled.sql");
    let numbering = migration
        .split_inclusive(';')
        .find(|sql| sql.contains("UPDATE nodes"));
    sqlx::query("UPDATE nodes SET trip_order = 0, checksum = NULL")
        .execute(&mut raw)
        .await
        .unwrap();
    sqlx::query(numbering.unwrap())
        .execute(&mut raw)
        .await
        .unwrap();
    for trip in ["a", "b"] {
        let trip = TripId::new(trip).unwrap();
        let nodes = fixture.store.trip_nodes(&route(), &trip).await.unwrap();
        let orders: Vec<u32> = nodes.iter().map(|node| node.trip_order).collect();
        assert_eq!(orders, [0, 1, 2, 3, 4, 5]);
    }
}
