//! One match of two scans in a simulated room: from a near guess, and by a wide search.

// Clippy lets tests unwrap, and not yet benches.
#![allow(clippy::unwrap_used, missing_docs)]

use std::hint::black_box;
use std::sync::Arc;

use criterion::{Criterion, criterion_group, criterion_main};
use mapshift::geometry::{Pose2, Vector2};
use mapshift::matching::{
    IcpParams, LikelihoodGrid, ReferenceCloud, SearchParams, SearchWindow, align, search,
};
use mapshift::scan::{LaserScan, Lidar, SurfacePoint, surface_points};
use mapshift::sim::{Shape, World};

const BEAMS: usize = 720;
const RANGE_SIGMA_M: f64 = 0.01;
const RESOLUTION_M: f64 = 0.1;
const SEARCH: SearchParams = SearchParams {
    score_min: 0.3,
    distinct_distance_m: f64::INFINITY,
    distinct_turn_rad: f64::INFINITY,
    rival_share: 1.0,
    wants_best_rival: true,
};

/// What a lidar without noise sees in a room with three boxes.
fn scan(map_from_lidar: &Pose2) -> LaserScan {
    let world = World::new([
        Shape::rectangle(&Pose2::IDENTITY, 14.0, 9.0),
        Shape::rectangle(&Pose2::new(3.0, 2.0, 0.3), 1.2, 0.8),
        Shape::rectangle(&Pose2::new(-4.0, -1.5, 0.0), 0.8, 2.0),
        Shape::rectangle(&Pose2::new(1.5, -3.0, 0.8), 0.5, 0.5),
    ]);
    let increment = std::f64::consts::TAU / BEAMS as f64;
    let lidar = Arc::new(Lidar {
        angle_min_rad: -std::f64::consts::PI,
        angle_increment_rad: increment,
        range_min_m: 0.05,
        range_max_m: 30.0,
        mount: Pose2::IDENTITY,
        range_sigma_m: RANGE_SIGMA_M,
        band: None,
    });
    let eye = map_from_lidar.translation();
    let ranges = (0..BEAMS).map(|beam| {
        let angle = map_from_lidar.theta - std::f64::consts::PI + beam as f64 * increment;
        let hit = world.cast(&eye, &Vector2::new(angle.cos(), angle.sin()))?;
        Some(hit.range_m)
    });
    LaserScan::new(Arc::clone(&lidar), ranges).unwrap()
}

fn local_match(old: &[SurfacePoint], new: &[SurfacePoint], guess: &Pose2) -> Pose2 {
    let cloud = ReferenceCloud::new([(Pose2::IDENTITY, old)]).unwrap();
    align(&cloud, new, guess, RANGE_SIGMA_M, None, &IcpParams::ROBUST).pose
}

fn wide_match(old: &[SurfacePoint], new: &[SurfacePoint]) -> Pose2 {
    let reference = old.iter().map(|point| point.position);
    let grid = LikelihoodGrid::new(reference, RESOLUTION_M, 1.5 * RESOLUTION_M, 5).unwrap();
    let sampled: Vec<_> = new.iter().step_by(4).map(|point| point.position).collect();
    let window = SearchWindow {
        centre: Pose2::IDENTITY,
        half_width_m: 1.0,
        half_turn_rad: std::f64::consts::FRAC_PI_6,
    };
    let found = search(&grid, &sampled, &window, &SEARCH);
    local_match(old, new, &found.unwrap().pose)
}

fn benches(criterion: &mut Criterion) {
    let (near, far) = (Pose2::new(0.08, -0.05, 0.06), Pose2::new(0.7, -0.4, 0.4));
    let old = scan(&Pose2::IDENTITY);
    for (name, place) in [("local", near), ("wide", far)] {
        let new = scan(&place);
        criterion.bench_function(&format!("match/{name}"), |bencher| {
            bencher.iter(|| {
                let (old, new) = (surface_points(&old), surface_points(&new));
                black_box(match name {
                    "local" => local_match(&old, &new, &Pose2::IDENTITY),
                    _ => wide_match(&old, &new),
                })
            });
        });
    }
}

criterion_group!(matching, benches);
criterion_main!(matching);
