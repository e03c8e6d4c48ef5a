//! The search over a window: rivals, edges, full turns.

use std::f64::consts::PI;

use mapshift::geometry::{Pose2, Vector2, angle_difference_rad};
use mapshift::matching::{LikelihoodGrid, SearchParams, SearchWindow, search};
use mapshift::scan::surface_points;
use mapshift::sim::{Shape, World};
use proptest::prelude::*;

use crate::scans::{Noise, apart, lidar, look};

const PARAMS: SearchParams = SearchParams {
    score_min: 0.4,
    distinct_distance_m: 0.7,
    distinct_turn_rad: 0.35,
    rival_share: 0.9,
    wants_best_rival: true,
};

/// A room of 7 m × 5 m round a place with a box, a column and a slanted cupboard.
fn room(x: f64, y: f64) -> [Shape; 4] {
    [
        Shape::rectangle(&Pose2::new(x, y, 0.0), 7.0, 5.0),
        Shape::rectangle(&Pose2::new(x + 2.5, y + 1.0, 0.0), 0.8, 1.2),
        Shape::Round {
            centre: Vector2::new(x - 2.0, y + 1.5),
            radius_m: 0.3,
        },
        Shape::rectangle(&Pose2::new(x - 1.0, y - 1.8, 0.6), 1.4, 0.5),
    ]
}

fn scan_points(world: &World, at: &Pose2, seed: u64) -> Vec<Vector2<f64>> {
    let lidar = lidar(360, 360, Pose2::new(0.1, 0.0, 0.0), 0.01);
    let scan = look(world, &lidar, 360, at, &mut Noise::new(seed));
    surface_points(&scan).iter().map(|p| p.position).collect()
}

/// What scans at some places show, drawn.
fn draw(world: &World, places: &[Pose2]) -> LikelihoodGrid {
    let mut points = Vec::new();
    for (k, place) in places.iter().enumerate() {
        let seen = scan_points(world, place, 100 + k as u64);
        points.extend(seen.iter().map(|p| place.transform(p)));
    }
    LikelihoodGrid::new(points.iter().copied(), 0.1, 0.15, 7).unwrap()
}

#[test]
fn of_two_like_rooms_the_other_one_is_the_rival() {
    let offset = Vector2::new(12.0, 2.0);
    let world = World::new(room(0.0, 0.0).into_iter().chain(room(offset.x, offset.y)));
    let places = [(0.5, 0.0), (-1.0, 0.5), (12.5, 2.0), (11.0, 2.5)];
    let places = places.map(|(x, y)| Pose2::new(x, y, 0.3));
    let grid = draw(&world, &places);
    let truth = Pose2::new(0.1, 0.4, -2.0);
    let points = scan_points(&world, &truth, 1);
    let everywhere = SearchWindow::everywhere(&grid);
    let hit = search(&grid, &points, &everywhere, &PARAMS).unwrap();
    let (rival, score) = hit.rival.unwrap();
    let twin = Pose2::new(truth.x + offset.x, truth.y + offset.y, truth.theta);
    let found = [(truth, twin), (twin, truth)]
        .map(|(first, second)| apart(&hit.pose, &first).0 < 0.2 && apart(&rival, &second).0 < 0.2);
    assert!(found[0] || found[1], "{hit:?}");
    assert!(score >= 0.9 * hit.score && score <= hit.score, "{hit:?}");

    // If its position is known to within half the distance, the other room is excluded.
    let near = SearchWindow {
        centre: Pose2::new(1.0, 0.0, 0.0),
        half_width_m: 4.0,
        half_turn_rad: PI,
    };
    let hit = search(&grid, &points, &near, &PARAMS).unwrap();
    assert!(
        apart(&hit.pose, &truth).0 < 0.2 && hit.rival.is_none(),
        "{hit:?}"
    );
}

#[test]
fn what_stands_in_one_room_alone_tells_them_apart() {
    let mut shapes: Vec<Shape> = room(0.0, 0.0).into_iter().chain(room(12.0, 2.0)).collect();
    shapes.push(Shape::rectangle(&Pose2::new(1.5, -1.5, 0.2), 1.8, 0.9));
    shapes.push(Shape::rectangle(&Pose2::new(-2.6, 0.0, 0.0), 0.7, 1.4));
    let world = World::new(shapes);
    let places = [(0.5, 0.0), (-1.0, 0.5), (12.5, 2.0), (11.0, 2.5)];
    let grid = draw(&world, &places.map(|(x, y)| Pose2::new(x, y, 0.3)));
    let truth = Pose2::new(0.1, 0.4, -2.0);
    let points = scan_points(&world, &truth, 2);
    let hit = search(&grid, &points, &SearchWindow::everywhere(&grid), &PARAMS).unwrap();
    assert!(apart(&hit.pose, &truth).0 < 0.2, "{hit:?}");
    assert!(hit.rival.is_none(), "{hit:?}");
}

#[test]
fn a_room_that_is_its_own_half_turn_has_a_rival_half_a_turn_away() {
    let world = World::new([Shape::rectangle(&Pose2::IDENTITY, 7.0, 5.0)]);
    let grid = draw(
        &world,
        &[Pose2::new(0.5, 0.0, 0.0), Pose2::new(-1.0, 0.5, 0.3)],
    );
    let points = scan_points(&world, &Pose2::new(1.0, -0.5, 0.4), 3);
    let hit = search(&grid, &points, &SearchWindow::everywhere(&grid), &PARAMS).unwrap();
    let (rival, _) = hit.rival.unwrap();
    assert!(angle_difference_rad(rival.theta, hit.pose.theta) > PI - 0.1);
    let opposite = hit.pose.translation() + rival.translation();
    assert!(opposite.norm() < 0.3, "{hit:?}");
}

#[test]
fn any_heading_is_found_in_a_full_turn() {
    let world = World::new(room(0.0, 0.0));
    let grid = draw(
        &world,
        &[Pose2::new(0.5, 0.0, 0.0), Pose2::new(-1.0, 0.5, 0.3)],
    );
    for heading in [-PI, -3.13, -1.6, 0.0, 1.6, 3.13, PI] {
        for centre_heading in [0.0, 1.0, PI, -3.1] {
            let truth = Pose2::new(0.3, -0.2, heading);
            let points = scan_points(&world, &truth, 4);
            let window = SearchWindow {
                centre: Pose2::new(0.0, 0.0, centre_heading),
                half_width_m: 1.0,
                half_turn_rad: PI,
            };
            let hit = search(&grid, &points, &window, &PARAMS).unwrap();
            let (shift_m, turn_rad) = apart(&hit.pose, &truth);
            assert!(shift_m < 0.15 && turn_rad < 0.04, "{hit:?} {truth:?}");
            assert!(hit.rival.is_none(), "{hit:?}");
        }
    }
}

#[test]
fn the_window_bounds_what_is_found() {
    let world = World::new(room(0.0, 0.0));
    let grid = draw(
        &world,
        &[Pose2::new(0.5, 0.0, 0.0), Pose2::new(-1.0, 0.5, 0.3)],
    );
    let truth = Pose2::new(0.5, -0.5, 0.3);
    let points = scan_points(&world, &truth, 5);
    let window = |half_width_m: f64, half_turn_rad: f64| SearchWindow {
        centre: Pose2::IDENTITY,
        half_width_m,
        half_turn_rad,
    };
    let on_the_edge = search(&grid, &points, &window(0.5, 0.3), &PARAMS).unwrap();
    let (shift_m, turn_rad) = apart(&on_the_edge.pose, &truth);
    assert!(shift_m < 0.11 && turn_rad < 0.03, "{on_the_edge:?}");
    for (half_width_m, half_turn_rad) in [(0.3, 0.3), (0.5, 0.1), (0.0, 0.0)] {
        let window = window(half_width_m, half_turn_rad);
        let params = SearchParams {
            score_min: 0.0,
            ..PARAMS
        };
        let hit = search(&grid, &points, &window, &params).unwrap();
        assert!(hit.pose.x.abs() <= half_width_m + 1e-9, "{hit:?}");
        assert!(hit.pose.y.abs() <= half_width_m + 1e-9, "{hit:?}");
        assert!(hit.pose.theta.abs() <= half_turn_rad + 1e-9, "{hit:?}");
        assert!(hit.score < on_the_edge.score, "{hit:?}");
    }
    assert!(search(&grid, &[], &window(1.0, 1.0), &PARAMS).is_none());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]

    #[test]
    fn no_pose_in_the_window_fits_better(
        map in prop::collection::vec((-3.0..3.0_f64, -3.0..3.0_f64), 5..40),
        scan in prop::collection::vec((-2.0..2.0_f64, -2.0..2.0_f64), 3..15),
        x in -1.0..1.0_f64, y in -1.0..1.0_f64, theta in -PI..PI,
        half_width_m in 0.0..1.2_f64, half_turn_rad in 0.0..PI,
        samples in prop::collection::vec((-1.0..1.0_f64, -1.0..1.0_f64), 30),
    ) {
        let to_points = |pairs: Vec<(f64, f64)>| -> Vec<Vector2<f64>> {
            pairs.into_iter().map(|(x, y)| Vector2::new(x, y)).collect()
        };
        let (map, scan) = (to_points(map), to_points(scan));
        let grid = LikelihoodGrid::new(map.iter().copied(), 0.1, 0.15, 5).unwrap();
        let window = SearchWindow { centre: Pose2::new(x, y, theta), half_width_m, half_turn_rad };
        let params = SearchParams { score_min: 0.0, ..PARAMS };
        let score = |pose: &Pose2| {
            let values = scan.iter().map(|p| {
                let (x, y) = grid.cell_of(&pose.transform(p));
                f64::from(grid.value(0, x, y))
            });
            values.sum::<f64>() / (255.0 * scan.len() as f64)
        };
        let hit = search(&grid, &scan, &window, &params);
        let (best, best_turn) = hit.map_or((0.0, theta), |h| (h.score, h.pose.theta));
        if let Some(hit) = &hit {
            // A point on the border of two cells may be counted for either.
            prop_assert!((score(&hit.pose) - hit.score).abs() <= 1.01 / scan.len() as f64);
        }
        for (across, along) in samples {
            let cells = |share: f64| (share * half_width_m / 0.1).round() * 0.1;
            let pose = Pose2::new(x + cells(across), y + cells(along), best_turn);
            prop_assert!(score(&pose) <= best + 1.01 / scan.len() as f64);
        }
    }
}
