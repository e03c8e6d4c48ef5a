//! Scans taken anywhere in simulated worlds.

use std::f64::consts::TAU;
use std::sync::Arc;

use mapshift::geometry::{Pose2, Vector2};
use mapshift::scan::{LaserScan, Lidar};
use mapshift::sim::World;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Seeded random numbers.
pub struct Noise(ChaCha8Rng);

impl Noise {
    pub fn new(seed: u64) -> Self {
        Self(ChaCha8Rng::seed_from_u64(seed))
    }

    /// Evenly spread.
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.0.random::<f64>()
    }

    /// Normal, by the sum of twelve even numbers.
    pub fn normal(&mut self, sigma: f64) -> f64 {
        let sum: f64 = (0..12).map(|_| self.0.random::<f64>()).sum();
        sigma * (sum - 6.0)
    }

    /// A pose somewhere on the rim of a disc, turned up to `turn_rad` either way.
    pub fn on_rim(&mut self, radius_m: f64, turn_rad: f64) -> Pose2 {
        let (sin, cos) = self.between(0.0, TAU).sin_cos();
        let turn_rad = self.between(-turn_rad, turn_rad);
        Pose2::new(radius_m * cos, radius_m * sin, turn_rad)
    }
}

/// A lidar of this many degrees that looks ahead from its mount; all round if 360.
pub fn lidar(field_of_view_deg: u32, beams: usize, mount: Pose2, range_sigma_m: f64) -> Arc<Lidar> {
    let field_rad = f64::from(field_of_view_deg).to_radians();
    let gaps = if field_of_view_deg == 360 {
        beams
    } else {
        beams - 1
    };
    let lidar = Lidar {
        angle_min_rad: -0.5 * field_rad,
        angle_increment_rad: field_rad / gaps as f64,
        range_min_m: 0.05,
        range_max_m: 20.0,
        mount,
        range_sigma_m,
        band: None,
    };
    Arc::new(lidar.validated().unwrap())
}

/// One scan with the lidar's own range noise; `map_from_base` is where the base is.
pub fn look(
    world: &World,
    lidar: &Arc<Lidar>,
    beams: usize,
    map_from_base: &Pose2,
    noise: &mut Noise,
) -> LaserScan {
    let map_from_lidar = map_from_base.compose(&lidar.mount);
    let ranges = (0..beams).map(|beam| {
        let (sin, cos) = (map_from_lidar.theta + lidar.beam_angle_rad(beam)).sin_cos();
        let hit = world.cast(&map_from_lidar.translation(), &Vector2::new(cos, sin));
        let error_m = noise.normal(lidar.range_sigma_m);
        hit.map(|hit| hit.range_m + error_m)
    });
    LaserScan::new(lidar.clone(), ranges.collect::<Vec<_>>()).unwrap()
}

/// Distance in metres and turn in radians between two poses.
pub fn apart(a: &Pose2, b: &Pose2) -> (f64, f64) {
    let motion = a.between(b);
    (motion.translation().norm(), motion.theta.abs())
}

/// The value that a share of the others does not exceed.
pub fn quantile(values: &[f64], share: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted[((sorted.len() - 1) as f64 * share).round() as usize]
}
