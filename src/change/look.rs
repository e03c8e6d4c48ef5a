//! One scan at its place in the map, asked about a spot.

use std::f64::consts::TAU;

use crate::geometry::{Pose2, Transform2, Vector2, wrap_angle};
use crate::ids::{NodeId, StampNs};
use crate::scan::LaserScan;

/// How near to a spot a beam must end to have struck it, metres: half a cell and the noise.
const RADIUS_M: f64 = 0.12;
/// What a metre of range adds to it: the turn error of a pose (3 σ).
const RADIUS_PER_RANGE: f64 = 0.006;
/// A spot whose radius would be larger is too far away to be told, metres.
const RADIUS_MAX_M: f64 = 0.26;
/// Ranges' standard deviations in the radius.
const RADIUS_SIGMAS: f64 = 3.0;

/// What one scan says about a spot.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sight {
    /// A beam ended there.
    Struck,
    /// The beams passed through it and went on.
    Passed,
    /// Out of reach, hidden behind something, or without a return: no evidence.
    Hidden,
}

/// A scan of a node, where the graph has it.
pub struct Look<'a> {
    /// The node.
    pub node: NodeId,
    /// Number of its trip; the same for all looks of a trip.
    pub trip: usize,
    /// Its place among the looks of its trip.
    pub order: usize,
    /// When it was taken.
    pub stamp: StampNs,
    /// Where the lidar was, map frame.
    eye: Vector2<f64>,
    scan: &'a LaserScan,
    lidar_from_map: Transform2,
    reach_m: f64,
    pose_error_m: f64,
}

impl<'a> Look<'a> {
    /// Of a scan taken at `map_from_base`.
    pub fn new(
        node: NodeId,
        (trip, order): (usize, usize),
        stamp: StampNs,
        map_from_base: &Pose2,
        scan: &'a LaserScan,
    ) -> Self {
        let map_from_lidar = map_from_base.compose(&scan.lidar().mount);
        Self {
            node,
            trip,
            order,
            stamp,
            eye: map_from_lidar.translation(),
            scan,
            lidar_from_map: map_from_lidar.inverse().to_transform(),
            reach_m: 0.0,
            pose_error_m: 0.0,
        }
        .with_pose_error(0.0)
    }

    /// The same look from a pose that is known to be off by so much, metres.
    pub fn with_pose_error(mut self, pose_error_m: f64) -> Self {
        let lidar = self.scan.lidar();
        self.pose_error_m = pose_error_m;
        let told_m = (RADIUS_MAX_M - self.radius_m(0.0)).max(0.0) / RADIUS_PER_RANGE;
        self.reach_m = lidar.range_max_m.min(told_m);
        self
    }

    fn radius_m(&self, range_m: f64) -> f64 {
        let noise_m = RADIUS_SIGMAS * self.scan.lidar().range_sigma_m;
        RADIUS_M + RADIUS_PER_RANGE * range_m + noise_m + self.pose_error_m
    }

    /// Whether a spot of the map is near enough to be told.
    pub fn reaches(&self, spot: &Vector2<f64>) -> bool {
        (spot - self.eye).norm_squared() < self.reach_m * self.reach_m
    }

    /// What the scan says about a spot of the map. Cost: the beams across it.
    pub fn sight(&self, spot: &Vector2<f64>) -> Sight {
        let lidar = self.scan.lidar();
        let local = self.lidar_from_map.apply(spot);
        let range_m = local.norm();
        let radius_m = self.radius_m(range_m);
        if range_m >= self.reach_m || range_m <= radius_m + lidar.range_min_m {
            return Sight::Hidden;
        }
        let step_rad = lidar.angle_increment_rad;
        let direction = wrap_angle(local.y.atan2(local.x) - lidar.angle_min_rad).rem_euclid(TAU);
        let middle = (direction / step_rad).round() as i64;
        let beside = ((radius_m / range_m).min(1.0).asin() / step_rad).ceil() as i64;
        let (mut passed, mut missing) = (0u32, 0u32);
        for beam in middle - beside..=middle + beside {
            let Some(index) = self.index_of(beam) else {
                missing += 1;
                continue;
            };
            let Some(measured_m) = self.scan.range_m(index) else {
                missing += 1;
                continue;
            };
            let off_rad = beam as f64 * step_rad - direction;
            let (sin, cos) = off_rad.sin_cos();
            let across_m = range_m * sin;
            let along_m = measured_m - range_m * cos;
            if across_m * across_m + along_m * along_m <= radius_m * radius_m {
                return Sight::Struck;
            }
            if along_m < 0.0 && across_m.abs() <= radius_m {
                return Sight::Hidden;
            }
            passed += u32::from(along_m > 0.0);
        }
        if passed > missing {
            Sight::Passed
        } else {
            Sight::Hidden
        }
    }

    fn index_of(&self, beam: i64) -> Option<usize> {
        let count = self.scan.beam_count() as i64;
        let full_turn = (TAU / self.scan.lidar().angle_increment_rad).round() as i64;
        let index = if count >= full_turn {
            beam.rem_euclid(full_turn)
        } else {
            beam
        };
        (0..count).contains(&index).then_some(index as usize)
    }
}

#[cfg(test)]
mod tests;
