//! The paper's weighting.

use mapshift::geometry::{Information, Pose2};
use mapshift::graph::EdgeKind;
use mapshift::mapping::{ClosureRule, RouteMap, Weighting};
use mapshift::matching::{Estimate, IcpParams, ReferenceCloud, align};

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

#[test]
fn the_paper_s_map_is_one_of_matches_of_two_scans() {
    let (world, route) = workshop();
    let trip = Trip::record("first", (&world, &route), &vehicle(), 2, 43);
    let mut map = RouteMap::new(Weighting::Paper);
    let added = extend_by(&mut map, &trip.batches(40, trip.start()));
    assert_sound(&map);
    assert!(added.closures.len() > 40);
    let aligned = |from: usize, to: usize, start: &Pose2| -> Estimate {
        let [old, new] = [from, to].map(|k| &map.keyframes()[k]);
        let cloud = ReferenceCloud::new([(Pose2::IDENTITY, old.points.as_slice())]).unwrap();
        let sigma_m = new.scan.as_ref().unwrap().lidar().range_sigma_m;
        align(
            &cloud,
            &new.points,
            start,
            sigma_m,
            None,
            &IcpParams::ALL_POINTS,
        )
    };
    let score_min = ClosureRule::default().score_min();
    for (edge, &(from, to)) in map.graph().edges().iter().zip(map.graph().ends()) {
        assert_eq!(edge.information, Information::identity());
        match edge.kind {
            EdgeKind::Odometry => {
                let [last, new] = [from, to].map(|k| map.keyframes()[k].odom_from_base);
                let matched = aligned(from, to, &last.between(&new));
                assert_eq!(edge.measurement, matched.pose);
            }
            EdgeKind::LoopClosure => {
                // Where it started is not known any more; it ended where it stays.
                let again = aligned(from, to, &edge.measurement);
                let step = edge.measurement.between(&again.pose);
                assert!(step.translation().norm() < 0.02, "{step:?}");
                assert!(again.explained_share() > 0.9 * score_min);
            }
        }
    }
}

#[test]
fn the_paper_s_map_has_one_threshold() {
    let (world, route) = workshop();
    let trip = Trip::record("first", (&world, &route), &vehicle(), 2, 44);
    let closures = |overlap_min: f64, inlier_share_min: f64| {
        let rule = ClosureRule {
            overlap_min,
            inlier_share_min,
        };
        let mut map = RouteMap::new(Weighting::Paper).with_closure_rule(rule);
        extend_by(&mut map, &trip.batches(40, trip.start()))
            .closures
            .len()
    };
    // One number: which of the two is strict makes no difference.
    assert_eq!(closures(0.24, 1.0), closures(1.0, 0.24));
    assert!(closures(0.0, 0.0) >= closures(0.4, 0.6));
    assert_eq!(closures(1.01, 1.0), 0);
}
