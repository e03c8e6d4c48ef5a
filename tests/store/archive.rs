//! Reads whose work does not grow with the age of a route: pages, exports, and sums over what has
//! left the active graph.
//!
//! With SQL past the store, for SQLite: the sums that are stored, and what happens without them.

use std::collections::BTreeMap;

use mapshift::graph::{EdgeKind, EdgeStatus};
use mapshift::ids::{EdgeId, NodeId, TripId};
use mapshift::store::{
    EdgeFilter, EdgeRecord, GraphPart, NodeRecord, Store, SubgraphSums, TrajectoryPose, Within,
};

use crate::settled::settled;
use crate::support::{Fixture, open, route};

/// The sums of the route's sub-graphs, from all its nodes and edges.
async fn counted(store: &Store) -> BTreeMap<i64, SubgraphSums> {
    let mut sums: BTreeMap<i64, SubgraphSums> = BTreeMap::new();
    for node in store.nodes(&route()).await.unwrap() {
        if let Some(id) = node.subgraph_id {
            sums.entry(id).or_default().nodes += 1;
        }
    }
    for edge in store.edges(&route()).await.unwrap() {
        let Some(id) = edge.subgraph_id else { continue };
        let sum = sums.entry(id).or_default();
        if edge.status == EdgeStatus::Active {
            sum.edges += 1;
            sum.loop_closures += i64::from(edge.kind == EdgeKind::LoopClosure);
            sum.total += edge.residual;
        }
        if let Some(delta_f) = edge.delta_f {
            sum.closures += 1;
            sum.delta_f += delta_f;
        }
        if let Some(closure) = edge.closure {
            sum.scan_closures += 1;
            sum.all_points += closure.all_points_residual;
        }
    }
    sums
}

async fn assert_sums_are_those_counted(store: &Store) {
    let sums = store.subgraph_sums(&route()).await.unwrap();
    let counted = counted(store).await;
    assert!(!counted.is_empty());
    assert_eq!(
        sums.keys().collect::<Vec<_>>(),
        counted.keys().collect::<Vec<_>>()
    );
    for (id, sum) in &sums {
        let other = &counted[id];
        assert!((sum.total - other.total).abs() <= 1e-9 * (1.0 + other.total));
        let total = other.total;
        assert_eq!(SubgraphSums { total, ..*sum }, *other, "{id}");
    }
}

async fn sums_of_archive(fixture: &Fixture) -> Vec<(i64, i64, i64)> {
    sqlx::query_as("SELECT subgraph_id, nodes, edges FROM archive_sums ORDER BY subgraph_id")
        .fetch_all(&mut fixture.raw().await)
        .await
        .unwrap()
}

#[tokio::test]
async fn sums_hold_while_nodes_leave_and_come_back() {
    let fixture = settled().await;
    assert_sums_are_those_counted(&fixture.store).await;
    let left = sums_of_archive(&fixture).await;
    // Seven nodes of no sub-graph with the chain's edges around them, and three closures.
    assert_eq!(left.iter().map(|(_, nodes, _)| nodes).sum::<i64>(), 7);
    assert_eq!(left.iter().map(|(.., edges)| edges).sum::<i64>(), 8 + 3);

    let back = [4, 5, 15].map(NodeId).to_vec();
    let store = &fixture.store;
    store.reactivate_nodes(&route(), back).await.unwrap();
    assert_sums_are_those_counted(store).await;
    let left = sums_of_archive(&fixture).await;
    assert_eq!(left.iter().map(|(_, nodes, _)| nodes).sum::<i64>(), 5);
    // Back are the edge 4–5 and the closures 4–14 and 5–15.
    assert_eq!(left.iter().map(|(.., edges)| edges).sum::<i64>(), 7 + 1);

    let rest = [3, 6, 7, 8, 9].map(NodeId).to_vec();
    store.reactivate_nodes(&route(), rest).await.unwrap();
    assert_sums_are_those_counted(store).await;
    let left = sums_of_archive(&fixture).await;
    assert!(
        left.iter()
            .all(|(_, nodes, edges)| (*nodes, *edges) == (0, 0))
    );
}

async fn reopened(fixture: Fixture) -> Fixture {
    let Fixture { store, directory } = fixture;
    store.close().await.unwrap();
    let store = open(&directory).await;
    Fixture { store, directory }
}

#[tokio::test]
async fn what_left_before_there_were_sums_is_summed_up_at_the_start() {
    let fixture = settled().await;
    let before = sums_of_archive(&fixture).await;
    let fixture = reopened(fixture).await;
    assert_eq!(sums_of_archive(&fixture).await, before, "not twice");
    sqlx::query("DELETE FROM archive_sums")
        .execute(&mut fixture.raw().await)
        .await
        .unwrap();
    let fixture = reopened(fixture).await;
    assert_eq!(sums_of_archive(&fixture).await, before);
    assert_sums_are_those_counted(&fixture.store).await;
}

#[tokio::test]
async fn series_are_read_from_the_first_that_left_and_the_active_ones() {
    let Fixture { store, .. } = &settled().await;
    let read = store.series_closures(&route()).await.unwrap();
    let closures: Vec<_> = read
        .closures
        .iter()
        .map(|c| (c.id.0, c.from.0, c.to.0, c.delta_f, c.archived))
        .collect();
    let expected = [1, 2, 3, 4, 5].map(|k| (100 + k, k, 10 + k, k as f64, k >= 3));
    assert_eq!(closures, expected);
    assert_eq!(read.archive[&Some(1)].closures, 3);
    assert_eq!(read.archive[&Some(1)].delta_f, 3.0 + 4.0 + 5.0);
}

#[tokio::test]
async fn pages_of_edges_are_the_filtered_list() {
    let fixture = settled().await;
    let mut raw = fixture.raw().await;
    for (status, id) in [("retired", 3), ("quarantined", 102), ("retired", 104)] {
        sqlx::query("UPDATE edges SET status = ? WHERE edge_id = ?")
            .bind(status)
            .bind(id)
            .execute(&mut raw)
            .await
            .unwrap();
    }
    let all = fixture.store.edges(&route()).await.unwrap();
    let kinds = [None, Some(EdgeKind::Odometry), Some(EdgeKind::LoopClosure)];
    let statuses = [
        None,
        Some(EdgeStatus::Active),
        Some(EdgeStatus::Retired),
        Some(EdgeStatus::Quarantined),
    ];
    for (kind, status) in kinds.iter().flat_map(|k| statuses.map(|s| (*k, s))) {
        let wanted = |edge: &&EdgeRecord| {
            kind.is_none_or(|kind| edge.kind == kind)
                && status.is_none_or(|status| edge.status == status)
        };
        let expected: Vec<EdgeRecord> = all.iter().filter(wanted).cloned().collect();
        let filter = EdgeFilter { kind, status };
        let (mut found, mut after) = (Vec::new(), None);
        loop {
            let page = fixture.store.edge_page(&route(), filter, after, 2).await;
            let page = page.unwrap();
            assert!(page.len() <= 2);
            let Some(last) = page.last() else { break };
            after = Some(last.id);
            found.extend(page);
        }
        assert_eq!(found, expected, "{filter:?}");
    }
}

#[tokio::test]
async fn what_is_named_comes_by_id_and_what_is_not_there_does_not() {
    let Fixture { store, .. } = &settled().await;
    let named = [NodeId(12), NodeId(4), NodeId(99), NodeId(4)];
    let nodes = store.nodes_named(&route(), &named).await.unwrap();
    assert_eq!(nodes.iter().map(|n| n.id.0).collect::<Vec<_>>(), [4, 12]);
    let named = [EdgeId(104), EdgeId(7), EdgeId(-1)];
    let edges = store.edges_named(&route(), &named).await.unwrap();
    assert_eq!(edges.iter().map(|e| e.id.0).collect::<Vec<_>>(), [7, 104]);
    assert_eq!(store.nodes_named(&route(), &[]).await.unwrap(), vec![]);
}

async fn exported(store: &Store, within: Option<Within>) -> (Vec<NodeRecord>, Vec<EdgeRecord>) {
    let mut pieces = store.export_graph(&route(), within).await.unwrap();
    let (mut nodes, mut edges) = (Vec::new(), Vec::new());
    while let Some(part) = pieces.next().await.unwrap() {
        match part {
            GraphPart::Nodes(part) => {
                assert!(edges.is_empty(), "nodes come first");
                nodes.extend(part);
            }
            GraphPart::Edges(part) => edges.extend(part),
        }
    }
    (nodes, edges)
}

#[tokio::test]
async fn an_exported_graph_is_the_graph_or_what_lies_in_the_box() {
    let Fixture { store, .. } = &settled().await;
    let nodes = store.nodes(&route()).await.unwrap();
    let edges = store.edges(&route()).await.unwrap();
    assert_eq!(exported(store, None).await, (nodes.clone(), edges.clone()));
    let xs: Vec<f64> = nodes.iter().map(|node| node.pose.x).collect();
    for (low, high) in [(xs[2], xs[6]), (xs[4], xs[4]), (1e6, 2e6)] {
        let within = Within {
            x: [low, high],
            y: [-1e9, 1e9],
        };
        let holds = |node: &&NodeRecord| (low..=high).contains(&node.pose.x);
        let inside: Vec<NodeRecord> = nodes.iter().filter(holds).cloned().collect();
        let known = |id| inside.iter().any(|node| node.id == id);
        let between = edges.iter().filter(|e| known(e.from) && known(e.to));
        let expected = (inside.clone(), between.cloned().collect());
        assert_eq!(exported(store, Some(within)).await, expected);
    }
    let mut none = store
        .export_graph(&mapshift::ids::RouteId::new("none").unwrap(), None)
        .await
        .unwrap();
    assert!(none.next().await.unwrap().is_none());
}

#[tokio::test]
async fn an_exported_trajectory_is_the_trip_in_the_order_of_time() {
    let Fixture { store, .. } = &settled().await;
    for trip in ["old", "new", "none"] {
        let trip = TripId::new(trip).unwrap();
        for all_scans in [false, true] {
            let expected: Vec<TrajectoryPose> = if all_scans {
                store.trajectory(&route(), &trip).await.unwrap()
            } else {
                let nodes = store.trip_nodes(&route(), &trip).await.unwrap();
                let pose_of = |node: &NodeRecord| TrajectoryPose {
                    node_id: node.id,
                    is_keyframe: true,
                    stamp: node.stamp,
                    pose: node.pose,
                };
                nodes.iter().map(pose_of).collect()
            };
            let mut pieces = store
                .export_trajectory(&route(), &trip, all_scans)
                .await
                .unwrap();
            let mut poses = Vec::new();
            while let Some(piece) = pieces.next().await.unwrap() {
                poses.extend(piece);
            }
            assert_eq!(poses, expected, "{trip} {all_scans}");
        }
    }
}
