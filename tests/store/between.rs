//! Scans between keyframes.
//!
//! With SQL past the store, for SQLite: a scan that is not what was written.

use mapshift::geometry::Pose2;
use mapshift::ids::{NodeId, TripId};
use mapshift::model::BatchStatus;
use mapshift::store::{Applied, IntermediateRecord, NewIntermediate, NodeChange, StoreError};

use crate::support::{Fixture, intermediate, route, upload};

/// Trip `t` of three nodes, one batch after the other: behind node 2 come four scans with the
/// first batch and two with the second, behind node 3 comes one.
async fn driven() -> Fixture {
    let fixture = Fixture::new().await;
    fixture.journal(upload("b0", "t", 0)).await;
    let job = fixture.claim(0).await.unwrap();
    let mut first = fixture.chain(&job, 3).await;
    first.intermediate = (0..4).map(|place| intermediate(2, place)).collect();
    first.intermediate.push(intermediate(3, 0));
    let applied = fixture.store.apply_result(first).await.unwrap();
    assert_eq!(applied, Applied::Committed);
    fixture.journal(upload("b1", "t", 1)).await;
    let job = fixture.claim(0).await.unwrap();
    let mut second = fixture.result(&job, BatchStatus::Merged).await;
    second.intermediate = vec![intermediate(2, 4), intermediate(2, 5)];
    let applied = fixture.store.apply_result(second).await.unwrap();
    assert_eq!(applied, Applied::Committed);
    fixture
}

fn records(node: i64, places: u32) -> Vec<IntermediateRecord> {
    (0..places)
        .map(|place| intermediate(node, place).scan)
        .collect()
}

/// What a worker loads: the active nodes with the scans behind them.
async fn loaded(fixture: &Fixture) -> Vec<(i64, Vec<IntermediateRecord>)> {
    let graph = fixture.store.load_graph(&route()).await.unwrap().unwrap();
    let nodes = graph.nodes.into_iter();
    nodes.map(|n| (n.node.id.0, n.intermediate)).collect()
}

#[tokio::test]
async fn they_are_read_back_to_the_bit_and_leave_and_come_back_with_their_node() {
    let fixture = driven().await;
    let all = [(1, vec![]), (2, records(2, 6)), (3, records(3, 1))];
    assert_eq!(loaded(&fixture).await, all);
    // Pictures are drawn from them too.
    let nodes = fixture.store.nodes_with_scans(&route()).await.unwrap();
    let nodes: Vec<_> = nodes
        .into_iter()
        .map(|n| (n.node.id.0, n.intermediate))
        .collect();
    assert_eq!(nodes, all);

    fixture.journal(upload("b2", "t", 2)).await;
    let job = fixture.claim(0).await.unwrap();
    let mut leaving = fixture.result(&job, BatchStatus::Merged).await;
    leaving.changed_nodes = vec![NodeChange {
        id: NodeId(2),
        pose: Pose2::new(1.0, 2.0, std::f64::consts::FRAC_PI_2),
        sigma: None,
        subgraph_id: None,
        drift_m: 0.0,
        reference: false,
        active: false,
    }];
    fixture.store.apply_result(leaving).await.unwrap();
    assert_eq!(loaded(&fixture).await, [all[0].clone(), all[2].clone()]);
    let nodes = vec![NodeId(2)];
    fixture
        .store
        .reactivate_nodes(&route(), nodes)
        .await
        .unwrap();
    assert_eq!(loaded(&fixture).await, all);
}

#[tokio::test]
async fn a_trajectory_has_every_scan_in_the_order_of_time() {
    let fixture = driven().await;
    let store = &fixture.store;
    let trip = TripId::new("t").unwrap();
    let poses = store.trajectory(&route(), &trip).await.unwrap();
    let order: Vec<_> = poses
        .iter()
        .map(|pose| (pose.node_id.0, pose.is_keyframe))
        .collect();
    let mut expected = vec![(1, true), (2, true)];
    expected.extend([(2, false); 6]);
    expected.extend([(3, true), (3, false)]);
    assert_eq!(order, expected);
    assert!(poses.is_sorted_by(|a, b| a.stamp < b.stamp));
    let nodes = store.trip_nodes(&route(), &trip).await.unwrap();
    let scan = intermediate(2, 3).scan;
    assert_eq!(poses[1].pose, nodes[1].pose);
    assert_eq!(poses[5].stamp, scan.stamp);
    assert_eq!(
        poses[5].pose,
        nodes[1].pose.compose(&scan.keyframe_from_base)
    );
    let none = TripId::new("none").unwrap();
    assert_eq!(store.trajectory(&route(), &none).await.unwrap(), []);
}

#[tokio::test]
async fn what_does_not_fit_is_refused_and_nothing_is_written() {
    let fixture = driven().await;
    fixture.journal(upload("b2", "t", 2)).await;
    let job = fixture.claim(0).await.unwrap();
    let with = |spoil: fn(&mut NewIntermediate)| {
        let mut new = intermediate(2, 6);
        spoil(&mut new);
        new
    };
    for (new, is_known) in [
        (with(|new| new.place = 7), true),
        (with(|new| new.place = 5), false),
        (with(|new| new.node_id = NodeId(77)), false),
        (with(|new| new.scan.keyframe_from_base.x = f64::NAN), false),
        (with(|new| new.scan.odom_from_base.theta = 7.0), false),
    ] {
        let mut result = fixture.result(&job, BatchStatus::Merged).await;
        result.intermediate = vec![new.clone()];
        let refused = fixture.store.apply_result(result).await;
        let expected = match &refused {
            Err(StoreError::InvalidResult(_)) => is_known,
            Err(StoreError::Database(_)) => !is_known,
            _ => false,
        };
        assert!(expected, "{new:?}: {refused:?}");
    }
    assert_eq!(loaded(&fixture).await[1].1, records(2, 6));
}

#[tokio::test]
async fn rot_in_one_is_left_out() {
    let fixture = driven().await;
    sqlx::query("UPDATE intermediate_scans SET scan = x'00' WHERE node_id = 2 AND place = 4")
        .execute(&mut fixture.raw().await)
        .await
        .unwrap();
    let mut wanted = records(2, 6);
    assert!(wanted[4].scan.take().is_some());
    assert_eq!(loaded(&fixture).await[1].1, wanted);
}
