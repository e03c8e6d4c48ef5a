//! Laps in a hall: how true the map is.

use std::collections::BTreeMap;

use mapshift::graph::{EdgeKind, EdgeStatus};
use mapshift::ids::NodeId;
use mapshift::mapping::RouteMap;
use mapshift::sim::Hall;

use crate::scans::apart;
use crate::support::{
    Trip, assert_sound, closure_errors, errors, largest, map_of, vehicle, workshop,
};

#[test]
fn two_laps_of_a_hall_are_where_they_were_driven() {
    let hall = Hall::generate(31).unwrap();
    let trip = Trip::record("first", (&hall.world, &hall.route), &vehicle(), 2, 1);
    let (map, closures) = map_of(&[&trip], 60);
    assert_sound(&map);
    let (shifts_m, turns_rad) = errors(&map, &[&trip]);
    let (shift_m, turn_deg) = (largest(&shifts_m), largest(&turns_rad).to_degrees());
    assert!(shift_m < 0.03 && turn_deg < 0.5, "{shift_m} m, {turn_deg}°");

    let (shifts_m, turns_rad) = closure_errors(&map, &[&trip]);
    assert_eq!(shifts_m.len(), closures.len());
    let (shift_m, turn_deg) = (largest(&shifts_m), largest(&turns_rad).to_degrees());
    assert!(shift_m < 0.05 && turn_deg < 0.5, "{shift_m} m, {turn_deg}°");

    let ties = closures_of_nodes(&map);
    let lap_of = |k: usize| {
        let stamp = map.keyframes()[k].stamp;
        trip.laps[trip.scans.iter().position(|s| s.stamp == stamp).unwrap()]
    };
    let second: Vec<NodeId> = (0..map.keyframes().len())
        .filter(|&k| lap_of(k) == 1)
        .map(|k| map.keyframes()[k].node)
        .collect();
    let untied = second.iter().filter(|id| !ties.contains_key(id)).count();
    assert!(second.len() > 180, "{}", second.len());
    assert_eq!(untied, 0, "of {}", second.len());
}

/// Closures from each new node to old ones.
fn closures_of_nodes(map: &RouteMap) -> BTreeMap<NodeId, usize> {
    let mut ties = BTreeMap::new();
    let edges = map.graph().edges().iter();
    for edge in edges.filter(|e| e.kind == EdgeKind::LoopClosure) {
        *ties.entry(edge.to).or_insert(0) += 1;
    }
    ties
}

#[test]
fn closures_go_from_reference_nodes_to_newer_ones_and_are_at_most_three() {
    let (world, route) = workshop();
    let trip = Trip::record("first", (&world, &route), &vehicle(), 3, 2);
    let (map, _) = map_of(&[&trip], 30);
    for (node, count) in closures_of_nodes(&map) {
        assert!(count <= 3, "{count} at {node}");
    }
    let keyframes = map.keyframes();
    for (edge, &(from, to)) in map.graph().edges().iter().zip(map.graph().ends()) {
        match edge.kind {
            EdgeKind::Odometry => assert_eq!(from + 1, to, "{edge:?}"),
            EdgeKind::LoopClosure => {
                assert!(keyframes[from].reference, "{edge:?}");
                assert!(to - from > 20, "{edge:?}");
            }
        }
    }
    // Where the second and third laps pass nodes of the first, they become no references.
    let references = keyframes.iter().filter(|k| k.reference).count();
    assert!(references < keyframes.len() * 3 / 4, "{references}");
}

#[test]
fn what_closures_added_is_the_cost() {
    let (world, route) = workshop();
    let trip = Trip::record("first", (&world, &route), &vehicle(), 3, 3);
    let other = Trip::record("second", (&world, &route), &vehicle(), 1, 4);
    let (map, closures) = map_of(&[&trip, &other], 40);
    let edges = map.graph().edges();
    assert!(edges.iter().all(|e| e.status == EdgeStatus::Active));
    assert!(closures.len() > 100, "{}", closures.len());
    let added: f64 = closures.iter().map(|c| c.delta_f).sum();
    let cost = map.graph().cost();
    assert!((added - cost).abs() < 1e-6 * cost, "{added} {cost}");
    assert!(closures.iter().all(|c| c.delta_f > -1e-9 * cost));
    // Three coordinates a closure if all errors were as large as the information says; the
    // simulation has none of those that its floor stands for.
    let share = cost / closures.len() as f64;
    assert!((0.01..3.0).contains(&share), "{share}");
}

#[test]
fn the_size_of_the_batches_hardly_matters() {
    let (world, route) = workshop();
    let trip = Trip::record("first", (&world, &route), &vehicle(), 2, 5);
    let (small, small_closures) = map_of(&[&trip], 10);
    let (large, large_closures) = map_of(&[&trip], 60);
    assert_eq!(small_closures.len(), large_closures.len());
    assert_eq!(small.keyframes().len(), large.keyframes().len());
    for (a, b) in small.graph().nodes().iter().zip(large.graph().nodes()) {
        let (shift_m, turn_rad) = apart(&a.pose, &b.pose);
        assert!(shift_m < 1e-7 && turn_rad < 1e-7, "{a:?} {b:?}");
    }
}

#[test]
fn two_trips_at_once_give_the_map_of_one_after_the_other() {
    let (world, route) = workshop();
    let base = Trip::record("base", (&world, &route), &vehicle(), 1, 6);
    let a = Trip::record("a", (&world, &route), &vehicle(), 1, 7);
    let b = Trip::record("b", (&world, &route), &vehicle(), 1, 8);
    let (serial, _) = map_of(&[&base, &a, &b], 20);
    let (mut mixed, _) = map_of(&[&base], 20);
    let (of_a, of_b) = (a.batches(20, a.start()), b.batches(20, b.start()));
    for k in 0..of_a.len().max(of_b.len()) {
        for drive in of_b.get(k).into_iter().chain(of_a.get(k)) {
            mixed.extend(drive).unwrap();
        }
    }
    assert_sound(&mixed);
    let placed = |map: &RouteMap| -> BTreeMap<_, _> {
        let nodes = map.keyframes().iter().zip(map.graph().nodes());
        nodes
            .map(|(k, n)| ((k.trip.clone(), k.stamp), n.pose))
            .collect()
    };
    let (serial, mixed) = (placed(&serial), placed(&mixed));
    assert!(serial.keys().eq(mixed.keys()));
    let differences: (Vec<f64>, Vec<f64>) = serial
        .iter()
        .map(|(key, pose)| apart(pose, &mixed[key]))
        .unzip();
    let (shift_m, turn_deg) = (
        largest(&differences.0),
        largest(&differences.1).to_degrees(),
    );
    assert!(shift_m < 0.01 && turn_deg < 0.1, "{shift_m} m, {turn_deg}°");
}
