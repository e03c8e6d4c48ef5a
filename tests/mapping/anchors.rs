//! Trips that do not say where they start, say it roughly, or drive elsewhere.

use mapshift::geometry::{Pose2, Vector2};
use mapshift::mapping::{AnchorError, Drive, InitialPose, NotExtended, RouteMap, Weighting};
use mapshift::sim::{Hall, Route, Shape, World};

use crate::support::{
    Trip, assert_equal, assert_sound, closure_errors, errors, extend_by, largest, map_of,
    other_vehicle, vehicle, workshop,
};

/// The reason why a drive is refused; fails if it is taken, or if the map has changed.
fn refusal(map: &mut RouteMap, before: &RouteMap, drive: &Drive) -> AnchorError {
    let refused = map.extend(drive).unwrap_err();
    assert_equal(map, before);
    assert!(!refused.to_string().is_empty());
    match refused {
        NotExtended::Unanchored(reason) => reason,
        other => panic!("{other}"),
    }
}

#[test]
fn a_second_vehicle_finds_its_place() {
    let (world, route) = workshop();
    let first = Trip::record("first", (&world, &route), &vehicle(), 1, 21);
    let lap = Trip::record("whole", (&world, &route), &other_vehicle(), 1, 22);
    // From several places of the lap; its odometry frame begins elsewhere each time.
    for from in [0, 30, 55, 80] {
        let (mut map, _) = map_of(&[&first], 30);
        let second = lap.part("second", from..lap.scans.len());
        let added = extend_by(&mut map, &second.batches(20, None));
        assert_sound(&map);
        let (shifts_m, turns_rad) = errors(&map, &[&first, &second]);
        let (shift_m, turn_deg) = (largest(&shifts_m), largest(&turns_rad).to_degrees());
        assert!(
            shift_m < 0.03 && turn_deg < 0.5,
            "{from}: {shift_m} m, {turn_deg}°"
        );
        assert!(added.closures.len() >= added.nodes.len(), "{from}");
        let (shifts_m, turns_rad) = closure_errors(&map, &[&first, &second]);
        let (shift_m, turn_deg) = (largest(&shifts_m), largest(&turns_rad).to_degrees());
        assert!(
            shift_m < 0.05 && turn_deg < 1.0,
            "{from}: {shift_m} m, {turn_deg}°"
        );
    }
}

#[test]
fn a_drive_in_another_hall_is_refused_and_leaves_the_map_alone() {
    let hall = Hall::generate(41).unwrap();
    let first = Trip::record("first", (&hall.world, &hall.route), &vehicle(), 1, 1);
    let first = first.part("first", 0..160);
    let (mut map, _) = map_of(&[&first], 80);
    let (before, _) = map_of(&[&first], 80);
    let (world, route) = workshop();
    let elsewhere = Trip::record("elsewhere", (&world, &route), &vehicle(), 1, 2);
    for from in [0, 40] {
        let part = elsewhere.part("elsewhere", from..from + 40);
        let reason = refusal(&mut map, &before, &part.batches(40, None)[0]);
        let expected = matches!(
            reason,
            AnchorError::Unknown | AnchorError::Contradicted { .. } | AnchorError::Ambiguous(..)
        );
        assert!(expected, "{reason}");
    }
}

#[test]
fn in_a_hall_of_the_same_walls_a_drive_is_refused_or_placed_by_the_walls() {
    // Most of what it shows is walls: at one place at least it is placed.
    assert!(refused_in_a_hall_of_the_same_walls(&[60, 120]) < 2);
}

#[test]
fn in_a_hall_of_the_same_walls_no_drive_slides_along_them() {
    // Between two walls everything was replaced: places along them are hardly distinguished.
    refused_in_a_hall_of_the_same_walls(&[0]);
}

/// How many drives are refused that begin at these scans of another hall; those that are not must
/// be where they are.
fn refused_in_a_hall_of_the_same_walls(begins: &[usize]) -> usize {
    let hall = Hall::generate(41).unwrap();
    let first = Trip::record("first", (&hall.world, &hall.route), &vehicle(), 1, 1);
    let first = first.part("first", 0..160);
    let (before, _) = map_of(&[&first], 80);
    // The same walls with other things between them.
    let hall = Hall::generate(42).unwrap();
    let other = Trip::record("other", (&hall.world, &hall.route), &vehicle(), 1, 3);
    let mut refused = 0;
    for &from in begins {
        let (mut map, _) = map_of(&[&first], 80);
        let part = other.part("other", from..from + 40);
        let drive = &part.batches(40, None)[0];
        if map.extend(drive).is_ok() {
            let (shifts_m, _) = errors(&map, &[&first, &part]);
            assert!(largest(&shifts_m) < 0.05, "{}", largest(&shifts_m));
        } else {
            let reason = refusal(&mut map, &before, drive);
            let expected = matches!(
                reason,
                AnchorError::Contradicted { .. } | AnchorError::Ambiguous(..)
            );
            assert!(expected, "{reason}");
            refused += 1;
        }
    }
    refused
}

#[test]
fn too_short_a_trip_waits_and_is_localised_once_it_is_longer() {
    let (world, route) = workshop();
    let first = Trip::record("first", (&world, &route), &vehicle(), 1, 23);
    let (mut map, _) = map_of(&[&first], 40);
    let (before, _) = map_of(&[&first], 40);
    let second = Trip::record("second", (&world, &route), &vehicle(), 1, 24);
    let short = Drive {
        wheels: Default::default(),
        trip: second.id.clone(),
        initial_pose: None,
        scans: second.scans[..4].to_vec(),
    };
    let reason = refusal(&mut map, &before, &short);
    assert!(matches!(reason, AnchorError::TooShort(1..4)), "{reason}");
    let nothing = Drive {
        scans: Vec::new(),
        ..short.clone()
    };
    let reason = refusal(&mut map, &before, &nothing);
    assert_eq!(reason, AnchorError::TooShort(0));
    let longer = Drive {
        scans: second.scans[..40].to_vec(),
        ..short
    };
    assert!(!map.extend(&longer).unwrap().closures.is_empty());
}

#[test]
fn of_two_like_rooms_neither_is_chosen() {
    // Two equal rooms with a wall between them, and a drive through each.
    let room = |x: f64| {
        [
            Shape::rectangle(&Pose2::new(x + 4.0, 3.0, 0.0), 8.0, 6.0),
            Shape::rectangle(&Pose2::new(x + 6.9, 1.0, 0.3), 1.0, 0.7),
            Shape::rectangle(&Pose2::new(x + 4.0, 3.0, 0.0), 1.0, 0.5),
        ]
    };
    let world = World::new(room(0.0).into_iter().chain(room(10.0)));
    let route = |x: f64| {
        let corners = [(1.5, 1.5), (5.8, 1.5), (5.8, 4.5), (1.5, 4.5)];
        Route::new(&corners.map(|(cx, cy)| Vector2::new(x + cx, cy)), 0.8).unwrap()
    };
    let west = Trip::record("west", (&world, &route(0.0)), &vehicle(), 1, 25);
    let east = Trip::record("east", (&world, &route(10.0)), &vehicle(), 1, 26);
    let (mut map, _) = map_of(&[&west, &east], 60);
    let (before, _) = map_of(&[&west, &east], 60);
    let lost = Trip::record("lost", (&world, &route(0.0)), &vehicle(), 1, 27);
    let lost = lost.batches(60, None);
    let reason = refusal(&mut map, &before, &lost[0]);
    let AnchorError::Ambiguous(one, other) = &reason else {
        panic!("{reason}");
    };
    assert!(((one.x - other.x).abs() - 10.0).abs() < 0.3, "{reason}");
    assert!((one.y - other.y).abs() < 0.3, "{reason}");
}

#[test]
fn a_rough_initial_pose_is_pulled_in() {
    let (world, route) = workshop();
    let first = Trip::record("first", (&world, &route), &vehicle(), 1, 28);
    let second = Trip::record("second", (&world, &route), &other_vehicle(), 1, 29);
    for (k, angle) in [0.3_f64, 2.4, 4.5].into_iter().enumerate() {
        let (mut map, _) = map_of(&[&first], 30);
        let turn_rad = 10.0_f64.to_radians() * if k == 1 { -1.0 } else { 1.0 };
        let off = Pose2::new(0.5 * angle.cos(), 0.5 * angle.sin(), turn_rad);
        let initial = InitialPose {
            pose: second.truth[0].compose(&off),
            sigma_xy_m: 0.3,
            sigma_theta_rad: 0.1,
        };
        let added = extend_by(&mut map, &second.batches(25, Some(initial)));
        assert_sound(&map);
        assert!(!added.closures.is_empty());
        let (shifts_m, turns_rad) = errors(&map, &[&first, &second]);
        let (shift_m, turn_deg) = (largest(&shifts_m), largest(&turns_rad).to_degrees());
        assert!(shift_m < 0.03 && turn_deg < 0.5, "{shift_m} m, {turn_deg}°");
    }
}

#[test]
fn a_false_initial_pose_makes_no_false_closure() {
    let (world, route) = workshop();
    let first = Trip::record("first", (&world, &route), &vehicle(), 1, 30);
    let second = Trip::record("second", (&world, &route), &vehicle(), 1, 31);
    for off in [Pose2::new(3.0, 2.0, 0.5), Pose2::new(-6.0, 4.0, 3.0)] {
        let (mut map, _) = map_of(&[&first], 30);
        let initial = InitialPose {
            pose: second.truth[0].compose(&off),
            sigma_xy_m: 0.05,
            sigma_theta_rad: 0.02,
        };
        extend_by(&mut map, &second.batches(30, Some(initial)));
        assert_sound(&map);
        let (shifts_m, turns_rad) = closure_errors(&map, &[&first, &second]);
        let (shift_m, turn_deg) = (largest(&shifts_m), largest(&turns_rad).to_degrees());
        assert!(shift_m < 0.05 && turn_deg < 1.0, "{shift_m} m, {turn_deg}°");
    }
}

#[test]
fn the_first_trip_of_a_map_starts_at_the_origin() {
    let (world, route) = workshop();
    let trip = Trip::record("first", (&world, &route), &vehicle(), 1, 32);
    let mut map = RouteMap::new(Weighting::Robust);
    extend_by(&mut map, &trip.part("first", 0..12).batches(6, None));
    assert_eq!(map.graph().nodes()[0].pose, Pose2::IDENTITY);
    assert!(map.keyframes()[0].reference);
}
