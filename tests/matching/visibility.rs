//! What one scan says of a point, by hand.

use std::f64::consts::{FRAC_PI_2, PI, TAU};
use std::sync::Arc;

use mapshift::geometry::{Pose2, Vector2};
use mapshift::matching::{Agreement, DepthTolerance, View, Views, Visibility, agreement};
use mapshift::scan::{LaserScan, Lidar, SurfacePoint, surface_points};

use Visibility::{Free, Occluded, Surface, Unseen};

fn geometry(angle_min_rad: f64, angle_increment_rad: f64, mount: Pose2) -> Arc<Lidar> {
    Arc::new(Lidar {
        angle_min_rad,
        angle_increment_rad,
        range_min_m: 0.05,
        range_max_m: 10.0,
        mount,
        range_sigma_m: 0.01,
        band: None,
    })
}

fn within(depth_m: f64, sigma_theta_rad: f64) -> DepthTolerance {
    DepthTolerance {
        depth_m,
        sigma_theta_rad,
        is_across: false,
    }
}

fn at(angle_rad: f64, range_m: f64) -> Vector2<f64> {
    Vector2::new(range_m * angle_rad.cos(), range_m * angle_rad.sin())
}

/// Beams at −20°, −19° … 20°, all 4 m long.
fn arc_ahead(mount: Pose2) -> LaserScan {
    let degree = 1.0_f64.to_radians();
    LaserScan::new(geometry(-20.0 * degree, degree, mount), vec![Some(4.0); 41]).unwrap()
}

#[test]
fn before_on_and_behind_a_wall() {
    let scan = arc_ahead(Pose2::IDENTITY);
    for (range_m, expected) in [
        (0.04, Unseen),
        (0.06, Free),
        (0.5, Free),
        (3.89, Free),
        (3.91, Surface),
        (4.0, Surface),
        (4.09, Surface),
        (4.11, Occluded),
        (9.99, Occluded),
        (10.01, Unseen),
    ] {
        let seen = View::new(&scan).look_at(&at(0.1, range_m), None, 0.1);
        assert_eq!(seen, expected, "{range_m} m");
    }
}

/// A wall at a slant: two views of it that differ by 0.1 m across it differ by more along a beam.
#[test]
fn along_a_beam_that_grazes_a_surface_views_of_it_differ_by_more() {
    for (incidence_deg, depth_m) in [(0.0, 0.1), (60.0, 0.2), (-60.0, 0.2), (90.0, 0.5)] {
        let normal = at(PI + f64::to_radians(incidence_deg), 1.0);
        for (apart_m, expected) in [
            (-1.01, Free),
            (-0.99, Surface),
            (0.99, Surface),
            (1.01, Occluded),
        ] {
            let point = at(0.0, 4.0 + apart_m * depth_m);
            // The mount turns the normal with the point.
            for mount in [Pose2::IDENTITY, Pose2::new(1.0, 0.5, FRAC_PI_2)] {
                let scan = arc_ahead(mount);
                let normal = mount.to_transform().turn(&normal);
                let seen = View::new(&scan).look_at(&mount.transform(&point), Some(&normal), 0.1);
                assert_eq!(seen, expected, "{incidence_deg}°, {apart_m} of {depth_m} m");
            }
        }
    }
}

#[test]
fn outside_the_field_of_view_nothing_is_known() {
    let scan = arc_ahead(Pose2::IDENTITY);
    for (degrees, expected) in [
        (0.0, Free),
        (20.4, Free),
        (-20.4, Free),
        (20.6, Unseen),
        (-20.6, Unseen),
        (90.0, Unseen),
        (180.0, Unseen),
        (-179.0, Unseen),
    ] {
        let seen = View::new(&scan).look_at(&at(f64::to_radians(degrees), 2.0), None, 0.1);
        assert_eq!(seen, expected, "{degrees}°");
    }
}

#[test]
fn the_mount_is_where_the_beams_begin() {
    let mount = Pose2::new(1.0, 0.5, FRAC_PI_2);
    let scan = arc_ahead(mount);
    for (range_m, expected) in [(3.0, Free), (4.0, Surface), (5.0, Occluded)] {
        let point = mount.transform(&at(0.0, range_m));
        assert!((point - Vector2::new(1.0, 0.5 + range_m)).norm() < 1e-12);
        assert_eq!(View::new(&scan).look_at(&point, None, 0.1), expected);
    }
    assert_eq!(View::new(&scan).look_at(&at(0.0, 3.0), None, 0.1), Unseen);
}

#[test]
fn no_return_is_no_evidence() {
    let degree = 1.0_f64.to_radians();
    let mut ranges = vec![Some(4.0); 41];
    ranges[20] = None;
    let scan = LaserScan::new(geometry(-20.0 * degree, degree, Pose2::IDENTITY), ranges).unwrap();
    for range_m in [1.0, 4.0, 9.0] {
        assert_eq!(
            View::new(&scan).look_at(&at(0.0, range_m), None, 0.1),
            Unseen
        );
    }
    // The beam beside it looks at its own evidence.
    assert_eq!(View::new(&scan).look_at(&at(degree, 1.0), None, 0.1), Free);
}

#[test]
fn beside_a_depth_edge_both_depths_count() {
    // Beams 0–19 end at 2 m, beams 20–40 at 5 m.
    let degree = 1.0_f64.to_radians();
    let ranges = (0..41).map(|k| Some(if k < 20 { 2.0 } else { 5.0 }));
    let scan = LaserScan::new(geometry(-20.0 * degree, degree, Pose2::IDENTITY), ranges).unwrap();
    let seen = |beam: f64, range_m: f64| {
        View::new(&scan).look_at(&at((beam - 20.0) * degree, range_m), None, 0.1)
    };
    // Far from the edge.
    assert_eq!(
        [seen(10.0, 1.0), seen(10.0, 2.0), seen(10.0, 3.5)],
        [Free, Surface, Occluded]
    );
    assert_eq!(
        [seen(30.0, 3.5), seen(30.0, 5.0), seen(30.0, 7.0)],
        [Free, Surface, Occluded]
    );
    // At the edge neither free space nor shadow is claimed between the two depths.
    for beam in [19.0, 20.0] {
        for range_m in [2.0, 3.5, 5.0] {
            assert_eq!(seen(beam, range_m), Surface, "beam {beam} at {range_m} m");
        }
        assert_eq!(seen(beam, 1.0), Free);
        assert_eq!(seen(beam, 6.0), Occluded);
    }
}

#[test]
fn a_full_turn_has_no_seam() {
    let beams = 360;
    let increment_rad = TAU / beams as f64;
    for angle_min_rad in [-PI, 0.0, 1.0, -TAU] {
        let lidar = geometry(angle_min_rad, increment_rad, Pose2::IDENTITY);
        // Near beams at the end and the beginning of the sweep, far ones elsewhere: the depth
        // edges lie at beams 10 and 350.
        let ranges = (0..beams).map(|k| Some(if !(10..350).contains(&k) { 2.0 } else { 5.0 }));
        let scan = LaserScan::new(lidar, ranges).unwrap();
        for tenth in -3600..3600 {
            let beam = f64::from(tenth) / 10.0 + 0.01;
            let nearest = beam.round().rem_euclid(360.0);
            let point = |range_m| at(angle_min_rad + beam * increment_rad, range_m);
            let seen =
                [1.0, 3.5, 6.0].map(|range_m| View::new(&scan).look_at(&point(range_m), None, 0.1));
            let near = !(9.0..=350.0).contains(&nearest);
            let edge = [9.0, 10.0, 349.0, 350.0].contains(&nearest);
            let between = match (edge, near) {
                (true, _) => Surface,
                (false, true) => Occluded,
                (false, false) => Free,
            };
            assert_eq!(seen, [Free, between, Occluded], "beam {beam}");
        }
    }
}

#[test]
fn a_depth_edge_at_the_seam_of_a_full_turn_counts() {
    // The first half of the sweep ends at 2 m, the second at 5 m: one edge lies at the seam.
    let beams = 360;
    let lidar = geometry(-PI, TAU / beams as f64, Pose2::IDENTITY);
    let ranges = (0..beams).map(|k| Some(if k < 180 { 2.0 } else { 5.0 }));
    let scan = LaserScan::new(lidar, ranges).unwrap();
    for beam in [0.0, 359.0] {
        let angle_rad = -PI + beam * TAU / beams as f64;
        assert_eq!(
            View::new(&scan).look_at(&at(angle_rad, 3.5), None, 0.1),
            Surface,
            "beam {beam}"
        );
    }
}

#[test]
fn a_field_of_view_short_of_a_full_turn_has_no_neighbours_across_its_gap() {
    // 270°: the last beam's neighbour is not the first.
    let degree = 1.0_f64.to_radians();
    let ranges = (0..271).map(|k| Some(if k == 0 { 2.0 } else { 5.0 }));
    let lidar = geometry(-135.0 * degree, degree, Pose2::IDENTITY);
    let scan = LaserScan::new(lidar, ranges).unwrap();
    assert_eq!(
        View::new(&scan).look_at(&at(135.0 * degree, 3.5), None, 0.1),
        Free
    );
}

#[test]
fn agreement_counts_by_hand_and_widens_with_range() {
    let scan = arc_ahead(Pose2::IDENTITY);
    let point = |position: Vector2<f64>| SurfacePoint {
        position,
        normal: None,
        beam: 0,
        range_m: position.norm(),
    };
    // The points' frame lies 1 m before the scan's.
    let seen_by_from_points = Pose2::new(1.0, 0.0, 0.0);
    let at = |x: f64, y: f64| point(Vector2::new(x - 1.0, y));
    let points = [
        at(2.0, 0.0),
        at(3.0, 0.0),
        at(3.85, 0.0),
        at(4.0, 0.0),
        at(6.0, 0.0),
        at(0.0, 3.0),
    ];
    let counts = agreement(
        &points,
        &Views::new(&scan),
        &seen_by_from_points,
        &within(0.1, 0.0),
    );
    let expected = Agreement {
        surface: 1,
        free: 3,
        occluded: 1,
        unseen: 1,
    };
    assert_eq!(counts, expected);
    assert!((counts.contradiction_share() - 0.75).abs() < 1e-12);
    // 3 · 0.005 rad · 3.85 m = 5.8 cm more: the third point is on the wall now.
    let counts = agreement(
        &points,
        &Views::new(&scan),
        &seen_by_from_points,
        &within(0.1, 0.005),
    );
    assert_eq!((counts.free, counts.surface), (2, 2));
    assert_eq!(Agreement::default().contradiction_share(), 0.0);
}

#[test]
fn across_a_surface_a_tolerance_is_meant_in_the_frame_of_who_looks() {
    // 0.15 m before the wall, on a surface that the beam meets at 60°.
    let moved = Pose2::new(1.0, 0.5, FRAC_PI_2);
    let back = moved.inverse();
    let slanted = SurfacePoint {
        position: back.transform(&at(0.0, 3.85)),
        normal: Some(back.to_transform().turn(&at(PI + PI / 3.0, 1.0))),
        beam: 0,
        range_m: 3.85,
    };
    let scan = arc_ahead(Pose2::IDENTITY);
    for (is_across, free) in [(false, 1), (true, 0)] {
        let tolerance = DepthTolerance {
            is_across,
            ..within(0.1, 0.0)
        };
        let counts = agreement(&[slanted], &Views::new(&scan), &moved, &tolerance);
        assert_eq!((counts.free, counts.surface), (free, 1 - free));
    }
}

#[test]
fn a_scan_agrees_with_itself() {
    let scan = arc_ahead(Pose2::new(0.3, -0.1, 2.0));
    let points = surface_points(&scan);
    let counts = agreement(
        &points,
        &Views::new(&scan),
        &Pose2::IDENTITY,
        &within(0.01, 0.0),
    );
    assert_eq!(counts.surface, points.len());
    assert_eq!(counts.contradiction_share(), 0.0);
}

/// One lidar ahead of the base looks on, one behind it looks back; the second scan was taken half a
/// metre farther on.
#[test]
fn each_of_several_scans_is_looked_at_from_its_own_origin() {
    let (ahead, back) = (
        arc_ahead(Pose2::new(1.0, 0.0, 0.0)),
        arc_ahead(Pose2::new(-1.0, 0.0, PI)),
    );
    let moved = Pose2::new(0.5, 0.0, 0.0);
    let views = Views::new(&ahead).with([(moved, &back)].into_iter());
    for (x, expected) in [
        (5.5, Occluded),
        (5.0, Surface),
        (3.0, Free),
        // Between the two nobody looks.
        (0.0, Unseen),
        (-1.0, Free),
        (-4.5, Surface),
        (-5.0, Occluded),
    ] {
        let seen = views.look_at(&Vector2::new(x, 0.0), None, 0.1);
        assert_eq!(seen, expected, "{x} m");
    }
    // Two that look the same way: a surface of either is one, and what is hidden from one alone
    // may be free.
    let near = LaserScan::new(ahead.lidar().clone(), vec![Some(2.0); 41]).unwrap();
    let both = Views::new(&near).with([(Pose2::IDENTITY, &ahead)].into_iter());
    for (x, expected) in [
        (2.0, Free),
        (3.0, Surface),
        (4.0, Free),
        (5.0, Surface),
        (6.0, Occluded),
    ] {
        assert_eq!(
            both.look_at(&Vector2::new(x, 0.0), None, 0.1),
            expected,
            "{x} m"
        );
    }
}
