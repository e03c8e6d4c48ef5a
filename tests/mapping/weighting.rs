//! The paper's weighting.

use mapshift::geometry::Information;
use mapshift::graph::EdgeKind;
use mapshift::mapping::{RouteMap, Weighting};

use crate::support::{Trip, assert_sound, errors, extend_by, largest, vehicle, workshop};

#[test]
fn all_points_with_identity_optimises_what_it_watches() {
    let (world, route) = workshop();
    let trip = Trip::record("first", (&world, &route), &vehicle(), 2, 41);
    let mut map = RouteMap::new(Weighting::AllPointsIdentity);
    let added = extend_by(&mut map, &trip.batches(40, trip.start()));
    assert_sound(&map);
    let identity = Information::identity();
    let edges = map.graph().edges();
    assert!(edges.iter().all(|e| e.information == identity));
    let closures = edges.iter().filter(|e| e.kind == EdgeKind::LoopClosure);
    assert!(added.closures.len() > 40);
    for (edge, closure) in closures.zip(&added.closures) {
        assert_eq!(edge.id, closure.edge);
        assert_eq!(edge.measurement, closure.all_points_measurement);
        assert_eq!(closure.all_points_information, identity);
        assert!(closure.all_points_residual >= 0.0 && closure.delta_f > -1e-12);
    }
    let added: f64 = added.closures.iter().map(|c| c.delta_f).sum();
    let cost = map.graph().cost();
    assert!((added - cost).abs() < 1e-6 * cost, "{added} {cost}");
    let (shifts_m, _) = errors(&map, &[&trip]);
    assert!(largest(&shifts_m) < 1.0);
}

#[test]
fn robust_maps_keep_both_measurements_apart() {
    let (world, route) = workshop();
    let trip = Trip::record("first", (&world, &route), &vehicle(), 2, 42);
    let mut map = RouteMap::new(Weighting::Robust);
    let added = extend_by(&mut map, &trip.batches(40, trip.start()));
    for closure in &added.closures {
        let edge = map.graph().edge(closure.edge).unwrap();
        assert_eq!(edge.measurement, closure.robust.pose);
        assert_eq!(edge.information, closure.robust.information);
        assert_ne!(closure.all_points_measurement, closure.robust.pose);
        assert!(closure.all_points_information.is_positive_semidefinite());
        assert!(closure.all_points_residual.is_finite() && closure.all_points_residual >= 0.0);
    }
}
