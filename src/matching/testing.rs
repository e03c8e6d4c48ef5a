//! Scans for the tests of this room.

use std::sync::Arc;

use crate::geometry::{Pose2, Vector2};
use crate::scan::{LaserScan, Lidar, SurfacePoint, surface_points};
use crate::sim::World;

/// What a lidar of 360 beams sees, with a little of fixed noise and, of a seed other than 0, a
/// millimetre besides.
pub(super) fn look(world: &World, pose: &Pose2, seed: u64) -> Vec<SurfacePoint> {
    let lidar = Arc::new(Lidar {
        angle_min_rad: -3.1,
        angle_increment_rad: 0.0172,
        range_min_m: 0.05,
        range_max_m: 20.0,
        mount: Pose2::new(0.3, 0.1, 0.4),
        range_sigma_m: 0.01,
        band: None,
    });
    let eye = pose.compose(&lidar.mount);
    let ranges = (0..360).map(|beam| {
        let (sin, cos) = (eye.theta + lidar.beam_angle_rad(beam)).sin_cos();
        let noise_m = 0.02 * ((beam * beam) as f64 * 0.7).sin();
        let seeded_m = match seed {
            0 => 0.0,
            _ => 0.0014 * (seed as f64 * 3.1 + beam as f64 * 5.7 + eye.x * 9.0).sin(),
        };
        let hit = world.cast(&eye.translation(), &Vector2::new(cos, sin));
        hit.map(|hit| hit.range_m + noise_m + seeded_m)
    });
    let ranges: Vec<_> = ranges.collect();
    surface_points(&LaserScan::new(lidar, ranges).unwrap())
}
