//! A map from its saved parts goes on as if it had never been put away.

use mapshift::geometry::Pose2;
use mapshift::ids::{EdgeId, NodeId};
use mapshift::mapping::{Drive, IntermediateScan, Keyframe, RouteMap, Weighting};
use mapshift::scan::{LaserScan, decode_scan, encode_scan};

use crate::support::{Trip, assert_equal, other_vehicle, vehicle, workshop};

fn through_bytes(scan: &LaserScan) -> LaserScan {
    decode_scan(&encode_scan(scan).unwrap()).unwrap()
}

/// The map after a way through the bytes of a store.
pub fn put_away(map: &RouteMap, weighting: Weighting) -> RouteMap {
    let nodes: Vec<(Pose2, Keyframe)> = map
        .keyframes()
        .iter()
        .zip(map.graph().nodes())
        .map(|(keyframe, node)| {
            let scan = through_bytes(keyframe.scan.as_ref().unwrap());
            let (trip, stamp) = (keyframe.trip.clone(), keyframe.stamp);
            let mut again = Keyframe::new(node.id, trip, stamp, keyframe.odom_from_base, scan);
            again.reference = keyframe.reference;
            again.drift_m = keyframe.drift_m;
            again.lidar.clone_from(&keyframe.lidar);
            let intermediate = keyframe.intermediate.iter();
            let intermediate = intermediate.map(|between| IntermediateScan {
                scan: between.scan.as_ref().map(through_bytes),
                ..between.clone()
            });
            (node.pose, again.with_intermediate(intermediate.collect()))
        })
        .collect();
    let edges = map.graph().edges().to_vec();
    let (next_node, next_edge) = (map.next_node_id(), map.next_edge_id());
    RouteMap::restore(weighting, nodes, edges, next_node, next_edge).unwrap()
}

#[test]
fn a_map_restored_after_every_batch_is_the_same_to_the_bit() {
    let (world, route) = workshop();
    let first = Trip::record("first", (&world, &route), &vehicle(), 2, 11);
    let second = Trip::record("second", (&world, &route), &other_vehicle(), 1, 12);
    for weighting in [Weighting::Robust, Weighting::AllPointsIdentity] {
        let mut kept = RouteMap::new(weighting);
        let mut restored = RouteMap::new(weighting);
        let mut scans_between = 0;
        let mut extend_both = |drive: &Drive| {
            let added = kept.extend(drive).map_err(|reason| reason.to_string());
            restored = put_away(&restored, weighting);
            let added_again = restored.extend(drive).map_err(|reason| reason.to_string());
            assert_eq!(added, added_again);
            assert_equal(&kept, &restored);
            let between = added.map(|added| added.intermediate.len());
            scans_between += *between.as_ref().unwrap_or(&0);
            between.is_ok()
        };
        for drive in first.batches(25, first.start()) {
            assert!(extend_both(&drive));
        }
        // The second trip finds its place by itself, once it has seen enough; the paper's
        // weighting makes a map that is too rough for that.
        if weighting == Weighting::AllPointsIdentity {
            assert!(scans_between > 20, "{scans_between}");
            continue;
        }
        let mut waiting = Vec::new();
        for drive in second.batches(25, None) {
            waiting.extend(drive.scans);
            let scans = waiting.clone();
            if extend_both(&Drive {
                wheels: Default::default(),
                scans,
                trip: second.id.clone(),
                initial_pose: None,
            }) {
                waiting.clear();
            }
        }
        assert!(waiting.is_empty());
        assert!(scans_between > 40, "{scans_between}");
    }
}

#[test]
fn the_same_drives_are_the_same_map_to_the_bit() {
    let (world, route) = workshop();
    let trip = Trip::record("first", (&world, &route), &vehicle(), 2, 13);
    let once = crate::support::map_of(&[&trip], 40);
    let again = crate::support::map_of(&[&trip], 40);
    assert_eq!(once.1, again.1);
    assert_equal(&once.0, &again.0);
}

#[test]
fn parts_that_do_not_fit_are_refused() {
    let (world, route) = workshop();
    let trip = Trip::record("first", (&world, &route), &vehicle(), 1, 14);
    let (map, _) = crate::support::map_of(&[&trip.part("first", 0..20)], 20);
    let keyframes = map.keyframes().iter().cloned();
    let poses = map.graph().nodes().iter().map(|n| n.pose);
    let nodes: Vec<_> = poses.zip(keyframes).collect();
    let edges = map.graph().edges().to_vec();
    let restore = |nodes: Vec<(Pose2, Keyframe)>, edges: Vec<_>| {
        RouteMap::restore(Weighting::Robust, nodes, edges, NodeId(99), EdgeId(99))
    };
    assert!(restore(nodes.clone(), edges.clone()).is_ok());
    assert!(restore(nodes[1..].to_vec(), edges.clone()).is_err());
    assert!(restore([&nodes[..], &nodes[..1]].concat(), edges.clone()).is_err());
    assert!(restore(nodes, [&edges[..], &edges[..1]].concat()).is_err());
}
