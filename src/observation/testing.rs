//! A small world of straight sides, and scans of it, for tests. It knows no cells and no tolerances.

use std::f64::consts::TAU;
use std::sync::Arc;

use crate::geometry::{Pose2, Vector2};
use crate::scan::{LaserScan, Lidar};

type Point = Vector2<f64>;

/// The sides of all objects.
#[derive(Debug, Clone, Default)]
pub(crate) struct World {
    sides: Vec<(Point, Point)>,
}

impl World {
    /// One more side.
    pub(crate) fn with_side(mut self, from: [f64; 2], to: [f64; 2]) -> Self {
        self.sides.push((from.into(), to.into()));
        self
    }

    /// The four sides of a room or a box.
    pub(crate) fn with_rectangle(self, low: [f64; 2], high: [f64; 2]) -> Self {
        self.with_side(low, [high[0], low[1]])
            .with_side([high[0], low[1]], high)
            .with_side(high, [low[0], high[1]])
            .with_side([low[0], high[1]], low)
    }

    /// How far a ray runs, metres; `None` if it hits nothing.
    pub(crate) fn range_m(&self, eye: &Point, direction_rad: f64) -> Option<f64> {
        let direction = Point::new(direction_rad.cos(), direction_rad.sin());
        let ranges = self.sides.iter().filter_map(|(from, to)| {
            let (side, towards) = (to - from, from - eye);
            let across = direction.perp(&side);
            let range_m = towards.perp(&side) / across;
            let share = towards.perp(&direction) / across;
            (range_m > 0.0 && (0.0..=1.0).contains(&share)).then_some(range_m)
        });
        ranges.min_by(f64::total_cmp)
    }

    /// What a lidar sees, with an error of its own for each range.
    pub(crate) fn scan(
        &self,
        lidar: &Arc<Lidar>,
        beams: usize,
        map_from_base: &Pose2,
        mut error_m: impl FnMut() -> f64,
    ) -> LaserScan {
        let map_from_lidar = map_from_base.compose(&lidar.mount);
        let eye = map_from_lidar.translation();
        let ranges = (0..beams).map(|beam| {
            let direction_rad = map_from_lidar.theta + lidar.beam_angle_rad(beam);
            self.range_m(&eye, direction_rad).map(|r| r + error_m())
        });
        LaserScan::new(lidar.clone(), ranges).unwrap()
    }
}

/// A lidar at the base, the beams of which fill a field of view that is centred ahead.
pub(crate) fn lidar(field_rad: f64, beams: usize, range_max_m: f64, sigma_m: f64) -> Lidar {
    Lidar {
        angle_min_rad: -0.5 * field_rad,
        angle_increment_rad: field_rad / beams as f64,
        range_min_m: 0.05,
        range_max_m,
        mount: Pose2::IDENTITY,
        range_sigma_m: sigma_m,
        band: None,
    }
}

/// A lidar that sees all round, 20 m far, with noise of 1 cm.
pub(crate) fn all_round(beams: usize) -> Lidar {
    lidar(TAU, beams, 20.0, 0.01)
}
