//! Drives as they should not be.

use mapshift::geometry::Pose2;
use mapshift::ids::{StampNs, TripId};
use mapshift::mapping::{Drive, DriveScan, RouteMap, Weighting};
use mapshift::scan::LaserScan;
use mapshift::sim::{Shape, World};

use crate::scans::{Noise, lidar, look};
use crate::support::{
    Trip, assert_sound, closure_errors, errors, extend_by, largest, vehicle, workshop,
};

#[test]
fn odometry_that_jumps_spoils_no_closure() {
    let (world, route) = workshop();
    let mut trip = Trip::record("first", (&world, &route), &vehicle(), 2, 1);
    let jump = Pose2::new(5.0, -1.0, 2.0);
    for scan in &mut trip.scans[70..] {
        scan.odom_from_base = jump.compose(&scan.odom_from_base);
    }
    let mut map = RouteMap::new(Weighting::Robust);
    extend_by(&mut map, &trip.batches(30, trip.start()));
    assert_sound(&map);
    let (shifts_m, turns_rad) = closure_errors(&map, &[&trip]);
    let (shift_m, turn_deg) = (largest(&shifts_m), largest(&turns_rad).to_degrees());
    assert!(!shifts_m.is_empty());
    assert!(shift_m < 0.05 && turn_deg < 1.0, "{shift_m} m, {turn_deg}°");
}

#[test]
fn a_wild_number_in_the_odometry_is_driven_over() {
    let (world, route) = workshop();
    for wild in [
        Pose2::new(1e6, -1e6, 3.0),
        Pose2::new(1e300, 0.0, 0.0),
        Pose2::new(0.0, -1e15, 1.0),
    ] {
        let mut trip = Trip::record("first", (&world, &route), &vehicle(), 1, 5);
        trip.scans[30].odom_from_base = wild;
        let trip = trip.part("first", 0..60);
        let mut map = RouteMap::new(Weighting::Robust);
        extend_by(&mut map, &trip.batches(20, trip.start()));
        assert_sound(&map);
        let (shifts_m, turns_rad) = errors(&map, &[&trip]);
        let (shift_m, turn_rad) = (largest(&shifts_m), largest(&turns_rad));
        assert!(shift_m < 0.03 && turn_rad < 0.01, "{shift_m} m, {turn_rad}");
    }
}

#[test]
fn odometry_that_begins_anew_is_driven_over() {
    let (world, route) = workshop();
    let mut trip = Trip::record("first", (&world, &route), &vehicle(), 2, 6);
    for scan in &mut trip.scans[50..] {
        scan.odom_from_base.x += 5_000.0;
    }
    let mut map = RouteMap::new(Weighting::Robust);
    extend_by(&mut map, &trip.batches(20, trip.start()));
    assert_sound(&map);
    let (shifts_m, _) = errors(&map, &[&trip]);
    assert!(largest(&shifts_m) < 0.03, "{}", largest(&shifts_m));
}

#[test]
fn scans_without_returns_are_driven_through() {
    let (world, route) = workshop();
    let mut trip = Trip::record("first", (&world, &route), &vehicle(), 2, 3);
    for scan in &mut trip.scans[60..66] {
        let beams = scan.scan.beam_count();
        scan.scan = LaserScan::new(scan.scan.lidar().clone(), vec![None; beams]).unwrap();
    }
    let mut map = RouteMap::new(Weighting::Robust);
    extend_by(&mut map, &trip.batches(30, trip.start()));
    assert_sound(&map);
    let (shifts_m, turns_rad) = errors(&map, &[&trip]);
    let (shift_m, turn_deg) = (largest(&shifts_m), largest(&turns_rad).to_degrees());
    assert!(shift_m < 0.08 && turn_deg < 1.0, "{shift_m} m, {turn_deg}°");
    let (shifts_m, _) = closure_errors(&map, &[&trip]);
    assert!(largest(&shifts_m) < 0.05);
}

#[test]
fn nothing_but_empty_scans_is_a_chain_of_odometry() {
    let (world, route) = workshop();
    let mut trip = Trip::record("first", (&world, &route), &vehicle(), 1, 4);
    for scan in &mut trip.scans {
        let beams = scan.scan.beam_count();
        scan.scan = LaserScan::new(scan.scan.lidar().clone(), vec![None; beams]).unwrap();
    }
    let mut map = RouteMap::new(Weighting::Robust);
    let added = extend_by(&mut map, &trip.batches(30, None));
    assert_sound(&map);
    assert!(added.closures.is_empty());
    let keyframes = map.keyframes().iter().zip(map.graph().nodes());
    for (keyframe, node) in keyframes {
        let by_odometry = trip.scans[0]
            .odom_from_base
            .between(&keyframe.odom_from_base);
        assert!((by_odometry.translation() - node.pose.translation()).norm() < 1e-9);
    }
    // Such a map places nobody.
    let other = Trip::record("second", (&world, &route), &vehicle(), 1, 5);
    assert!(map.extend(&other.batches(60, None)[0]).is_err());
}

#[test]
fn single_scans_are_maps_and_drives() {
    let (world, route) = workshop();
    let trip = Trip::record("first", (&world, &route), &vehicle(), 1, 6);
    let mut map = RouteMap::new(Weighting::Robust);
    let added = extend_by(&mut map, &trip.part("first", 0..1).batches(1, None));
    assert_eq!((added.nodes.len(), added.edges.len()), (1, 0));
    // The same scan again, and one that has hardly moved, add nothing.
    let again = extend_by(&mut map, &trip.part("first", 0..2).batches(1, None));
    assert_eq!(again, Default::default());
    // The whole drive scan by scan.
    let added = extend_by(&mut map, &trip.part("first", 1..30).batches(1, None));
    assert_eq!(added.nodes.len() - added.edges.len(), 0);
    assert_sound(&map);
    // A single scan of another trip that says where it is is tied to the map.
    let other = Trip::record("second", (&world, &route), &vehicle(), 1, 7);
    let one = other.part("second", 8..9);
    let mut initial = one.start().unwrap();
    let first_from_map = trip.truth[0].inverse();
    initial.pose = first_from_map.compose(&initial.pose);
    let added = extend_by(&mut map, &one.batches(1, Some(initial)));
    assert_eq!(added.nodes.len(), 1);
    assert!(!added.closures.is_empty());
    assert_sound(&map);
}

/// A drive along the middle of a corridor without ends, with the truth beside it.
fn along_a_corridor(scale: f64, seed: u64) -> (Vec<DriveScan>, Vec<Pose2>) {
    let world = World::new([Shape::rectangle(&Pose2::IDENTITY, 400.0, 3.0)]);
    let lidar = lidar(360, 360, Pose2::new(0.2, 0.0, 0.0), 0.01);
    let mut noise = Noise::new(seed);
    let (mut scans, mut truth) = (Vec::new(), Vec::new());
    for k in 0..80 {
        let way_m = 0.25 * f64::from(k);
        let at = Pose2::new(way_m, 0.2 * (0.3 * way_m).sin(), 0.06 * (0.3 * way_m).cos());
        scans.push(DriveScan {
            beam_interval_s: 0.0,
            lidar: Default::default(),
            stamp: StampNs(i64::from(k) * 250_000_000),
            odom_from_base: Pose2::new(at.x * scale, at.y, at.theta),
            scan: look(&world, &lidar, 360, &at, &mut noise),
        });
        truth.push(at);
    }
    (scans, truth)
}

#[test]
fn along_a_corridor_odometry_tells_the_way() {
    let (scans, truth) = along_a_corridor(1.02, 1);
    let drive = Drive {
        wheels: Default::default(),
        trip: TripId::new("first").unwrap(),
        initial_pose: None,
        scans,
    };
    let mut map = RouteMap::new(Weighting::Robust);
    map.extend(&drive).unwrap();
    assert_sound(&map);
    let first = truth[0];
    for (keyframe, node) in map.keyframes().iter().zip(map.graph().nodes()) {
        let expected = first.between(&truth[(keyframe.stamp.0 / 250_000_000) as usize]);
        let way_m = expected.x;
        assert!(
            (node.pose.x - 1.02 * way_m).abs() < 0.1 + 0.01 * way_m,
            "{node:?} {expected:?}"
        );
        assert!(
            (node.pose.y - expected.y).abs() < 0.03,
            "{node:?} {expected:?}"
        );
        assert!(
            (node.pose.theta - expected.theta).abs() < 0.01,
            "{node:?} {expected:?}"
        );
    }
    // Another vehicle cannot tell where along the corridor it is.
    let (scans, _) = along_a_corridor(1.0, 2);
    let lost = Drive {
        wheels: Default::default(),
        trip: TripId::new("second").unwrap(),
        initial_pose: None,
        scans: scans[..40].to_vec(),
    };
    assert!(map.extend(&lost).is_err());
}
