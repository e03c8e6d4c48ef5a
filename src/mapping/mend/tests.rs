use std::collections::BTreeMap;
use std::sync::Arc;

use super::super::evidence::Sites;
use super::super::keyframe::Keyframe;
use super::super::testing::{BEAMS, EVERY_S, SCANS, drive_through, rooms, truth};
use super::*;
use crate::ids::StampNs;
use crate::observation::testing::{World, all_round};

/// Where the segment lies that should not.
const BY: [f64; 2] = [0.35, -0.2];
/// The scans of the second trip that it is made of.
const SEGMENT: std::ops::Range<i64> = 60..130;
const SECOND_S: f64 = 1e4;

/// A trip that made the map, of two laps, and one through a world that may have changed.
fn two_trips(world: &World) -> RouteMap {
    let mut map = RouteMap::new(Weighting::Robust);
    for (world, trip, start_s, laps) in
        [(&rooms(), "first", 0.0, 2), (world, "second", SECOND_S, 1)]
    {
        let drive = drive_through(world, trip, start_s, 0..laps * SCANS, |_, motion| motion);
        map.extend(&drive).unwrap();
    }
    map
}

fn scan_of(keyframe: &Keyframe, start_s: f64) -> i64 {
    ((keyframe.stamp.seconds() - start_s) / EVERY_S).round() as i64
}

/// The nodes of some scans of a trip.
fn nodes_of(
    map: &RouteMap,
    trip: &str,
    start_s: f64,
    scans: &std::ops::Range<i64>,
) -> BTreeSet<NodeId> {
    let keyframes = map.keyframes().iter().filter(|k| k.trip.as_str() == trip);
    let of_segment = keyframes.filter(|k| scans.contains(&scan_of(k, start_s)));
    of_segment.map(|k| k.node).collect()
}

fn displaced(map: &RouteMap, keeps_closures: bool) -> RouteMap {
    let segment = nodes_of(map, "second", SECOND_S, &SEGMENT);
    assert!(segment.len() > 10);
    map.falsified(&segment, &BY.into(), keeps_closures).unwrap()
}

/// How far the worst keyframe is from the truth, metres.
fn worst_m(map: &RouteMap) -> f64 {
    let keyframes = map.keyframes().iter().zip(map.graph().nodes());
    let off_m = keyframes.map(|(keyframe, node)| {
        let start_s = if keyframe.trip.as_str() == "second" {
            SECOND_S
        } else {
            0.0
        };
        let there = truth(scan_of(keyframe, start_s));
        (node.pose.translation() - there.translation()).norm()
    });
    off_m.fold(0.0, f64::max)
}

fn judged(map: &mut RouteMap) -> (Vec<Finding>, Vec<Mending>) {
    let scope = Scope {
        sites: Sites::All,
        pending: &[],
        false_alerts_per_lap: 0.01,
        accepted: &[],
        vehicles: &BTreeMap::new(),
        suspects: &[],
    };
    map.findings_and_mendings(&scope, &[]).unwrap()
}

/// A mismatch of the second trip's segment.
fn mismatch(shift: Option<[f64; 2]>) -> Finding {
    let stamp = |scan: i64| StampNs((1e9 * (SECOND_S + EVERY_S * scan as f64)) as i64);
    Finding {
        trips: vec![TripId::new("second").unwrap()],
        shift: shift.map(Vector2::from),
        since: stamp(SEGMENT.start),
        last_seen: stamp(SEGMENT.end),
        ..crate::change::testing::finding(ChangeKind::MapMismatch, [7.0, 3.5], 3.0, 0)
    }
}

fn bits(map: &RouteMap) -> Vec<[u64; 3]> {
    let nodes = map.graph().nodes().iter();
    let bits = nodes.map(|n| [n.pose.x, n.pose.y, n.pose.theta].map(f64::to_bits));
    bits.collect()
}

#[test]
fn a_segment_is_put_right_where_it_belongs() {
    let sound = two_trips(&rooms());
    assert!(worst_m(&sound) < 0.02, "{}", worst_m(&sound));
    for keeps_closures in [true, false] {
        let mut map = displaced(&sound, keeps_closures);
        assert!(worst_m(&map) > 0.35);
        let (findings, mendings) = judged(&mut map);
        assert_eq!(findings, [], "closures: {keeps_closures}");
        assert!(!mendings.is_empty());
        assert!(worst_m(&map) < 0.02, "{keeps_closures}: {}", worst_m(&map));
        let off = mendings[0].shift + Vector2::from(BY);
        assert!(off.norm() < 0.02, "{off}");
        assert!(mendings[0].closures.len() >= 3);
        // It is not done again, and the next lap stands on it.
        assert_eq!(judged(&mut map), (Vec::new(), Vec::new()));
        let third = drive_through(&rooms(), "third", 2e4, 0..SCANS, |_, motion| motion);
        map.extend(&third).unwrap();
        assert_eq!(judged(&mut map), (Vec::new(), Vec::new()));
    }
}

#[test]
fn what_has_changed_there_is_still_found() {
    let with_box = rooms().with_rectangle([7.9, 5.6], [8.5, 6.2]);
    let sound = judged(&mut two_trips(&with_box)).0;
    assert_eq!(sound.len(), 1, "{sound:?}");
    let mut map = displaced(&two_trips(&with_box), true);
    let (findings, mendings) = judged(&mut map);
    assert!(!mendings.is_empty());
    assert_eq!(findings.len(), 1, "{findings:?}");
    assert_eq!(findings[0].kind, ChangeKind::Appeared);
    assert!((findings[0].location - sound[0].location).norm() < 0.05);
}

#[test]
fn the_same_map_is_mended_to_the_same_bits() {
    let sound = two_trips(&rooms());
    let mended = || {
        let mut map = displaced(&sound, true);
        let mendings = judged(&mut map).1;
        (bits(&map), mendings)
    };
    assert_eq!(mended(), mended());
}

#[test]
fn a_map_that_is_right_is_not_bent_whatever_is_said_of_it() {
    let mut map = two_trips(&rooms());
    assert_eq!(judged(&mut map), (Vec::new(), Vec::new()));
    let before = (bits(&map), map.graph().edges().to_vec(), map.next_edge_id());
    for shift in [[0.3, 0.0], [-0.1, 0.4], [0.0, -0.2]] {
        assert_eq!(map.mend(&[mismatch(Some(shift))]).unwrap(), []);
    }
    let after = (bits(&map), map.graph().edges().to_vec(), map.next_edge_id());
    assert_eq!(before, after);
}

/// Along bare walls nothing says where a segment belongs.
#[test]
fn a_corridor_proves_nothing() {
    let world = World::default()
        .with_side([-40.0, -1.2], [60.0, -1.2])
        .with_side([-40.0, 1.2], [60.0, 1.2]);
    let lidar = Arc::new(all_round(BEAMS));
    let keyframes = |trip: &str, start_s: f64, first: i64, off_m: f64| -> Vec<(Pose2, Keyframe)> {
        let taken = (0..40).map(|k| {
            let at = Pose2::new(0.4 * k as f64, 0.05, 0.0);
            let stamp = StampNs((1e9 * (start_s + EVERY_S * k as f64)) as i64);
            let scan = world.scan(&lidar, BEAMS, &at, || 0.0);
            let trip = TripId::new(trip).unwrap();
            let mut keyframe = Keyframe::new(NodeId(first + k), trip, stamp, at, scan);
            keyframe.reference = true;
            (Pose2::new(at.x + off_m, at.y, 0.0), keyframe)
        });
        taken.collect()
    };
    let first = keyframes("first", 0.0, 1, 0.0);
    let second = keyframes("second", SECOND_S, 41, 0.4);
    let nodes = [first, second].concat();
    let mut map = RouteMap::restore(Weighting::Robust, nodes, [], NodeId(81), EdgeId(1)).unwrap();
    let before = bits(&map);
    let told = Finding {
        last_seen: StampNs(i64::MAX),
        since: StampNs(0),
        ..mismatch(Some([-0.4, 0.0]))
    };
    let unknown = Finding {
        shift: None,
        ..told.clone()
    };
    assert_eq!(map.mend(&[told, unknown]).unwrap(), []);
    assert_eq!(bits(&map), before);
    // No closure ties the second trip, and that is still said.
    let (findings, mendings) = judged(&mut map);
    assert_eq!((findings.len(), mendings.len()), (1, 0), "{findings:?}");
    assert_eq!(findings[0].kind, ChangeKind::MapMismatch);
    assert_eq!(findings[0].nodes, Vec::from_iter((41..81).map(NodeId)));
}

#[test]
fn a_trip_that_never_ends_is_mended_by_its_own_first_lap() {
    let mut map = RouteMap::new(Weighting::Robust);
    let endless = drive_through(&rooms(), "endless", 0.0, 0..3 * SCANS, |_, motion| motion);
    map.extend(&endless).unwrap();
    let segment = nodes_of(&map, "endless", 0.0, &(SCANS + 60..SCANS + 130));
    let mut map = map.falsified(&segment, &BY.into(), false).unwrap();
    assert!(worst_m(&map) > 0.35);
    let told = map.findings(&Scope {
        sites: Sites::All,
        pending: &[],
        false_alerts_per_lap: 0.01,
        accepted: &[],
        vehicles: &BTreeMap::new(),
        suspects: &[],
    });
    let told: Vec<&Finding> = told
        .iter()
        .filter(|f| f.kind == ChangeKind::MapMismatch)
        .collect();
    assert_eq!(told.len(), 1, "{told:?}");
    assert!(told[0].nodes.iter().all(|node| segment.contains(node)));
    let (findings, mendings) = judged(&mut map);
    assert_eq!(findings, []);
    assert!(!mendings.is_empty());
    assert!(worst_m(&map) < 0.02, "{}", worst_m(&map));
}
