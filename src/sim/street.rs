//! Streets round a block: houses, poles and parked cars under an open sky.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::random::{Purpose, stream};
use super::{Route, RouteError, Scene, Shape};
use crate::geometry::{Pose2, Vector2};

/// The middle of the streets.
const CORNERS: [(f64, f64); 4] = [(0.0, 0.0), (46.0, 0.0), (46.0, 30.0), (0.0, 30.0)];
/// From the middle of a street to the middle of a parked car, to a pole, and to the houses.
const CARS_M: f64 = 2.9;
const POLES_M: f64 = 4.2;
const HOUSES_M: f64 = 6.0;
const HOUSE_DEPTH_M: f64 = 5.0;
/// Nothing is parked so near to a crossing of the middles.
const CROSSING_M: f64 = 6.5;
const PARKED_RATE: f64 = 0.45;

impl Scene {
    /// Four streets round a block of 46 m × 30 m. The map frame's origin is a crossing.
    ///
    /// # Errors
    /// [`RouteError`] if the streets made no route; they do.
    pub fn street(seed: u64) -> Result<Self, RouteError> {
        let corners = CORNERS.map(|(x, y)| Vector2::new(x, y));
        let route = Route::new(&corners, 3.0)?;
        let mut rng = stream(seed, Purpose::World);
        let mut shapes = Vec::new();
        for (k, from) in corners.iter().enumerate() {
            let along = corners[(k + 1) % corners.len()] - from;
            let start = Pose2::new(from.x, from.y, along.y.atan2(along.x));
            for side in [1.0, -1.0] {
                let street = Side {
                    start,
                    length_m: along.norm(),
                    side,
                };
                street.houses(&mut rng, &mut shapes);
                street.poles(&mut rng, &mut shapes);
                street.cars(&mut rng, &mut shapes);
            }
        }
        Ok(Self::lasting(route, shapes, seed))
    }
}

/// One side of a street.
struct Side {
    /// The crossing at which the street begins, looking along it.
    start: Pose2,
    length_m: f64,
    /// 1 on the left (inside), −1 on the right (outside).
    side: f64,
}

impl Side {
    fn at(&self, along_m: f64, aside_m: f64, turn_rad: f64) -> Pose2 {
        let in_street = Pose2::new(along_m, self.side * aside_m, turn_rad);
        self.start.compose(&in_street)
    }

    /// Whole houses only: one that is cut off at a crossing might be taken for a loose thing.
    fn houses(&self, rng: &mut ChaCha8Rng, shapes: &mut Vec<Shape>) {
        // On the outside the rows go on over the crossings and close the corners.
        let over_m = -self.side * HOUSES_M;
        let (mut along_m, end_m) = (-over_m, self.length_m + over_m);
        loop {
            let length_m = rng.random_range(6.0..11.0);
            let setback_m = rng.random_range(0.0..0.8);
            let gap_m = rng.random_range(0.0..2.5);
            if along_m + length_m > end_m {
                return;
            }
            let aside_m = HOUSES_M + setback_m + 0.5 * HOUSE_DEPTH_M;
            let house = self.at(along_m + 0.5 * length_m, aside_m, 0.0);
            shapes.push(Shape::rectangle(&house, length_m, HOUSE_DEPTH_M));
            along_m += length_m + gap_m;
        }
    }

    fn poles(&self, rng: &mut ChaCha8Rng, shapes: &mut Vec<Shape>) {
        let mut along_m = CROSSING_M + rng.random_range(0.0..4.0);
        while along_m < self.length_m - CROSSING_M {
            let centre = self.at(along_m, POLES_M, 0.0).translation();
            let radius_m = rng.random_range(0.05..0.16);
            shapes.push(Shape::Round { centre, radius_m });
            along_m += rng.random_range(6.0..11.0);
        }
    }

    fn cars(&self, rng: &mut ChaCha8Rng, shapes: &mut Vec<Shape>) {
        let mut along_m = CROSSING_M + 2.5;
        while along_m < self.length_m - CROSSING_M - 2.5 {
            let aside_m = CARS_M + rng.random_range(-0.15..0.15);
            let place = self.at(along_m, aside_m, rng.random_range(-0.05..0.05));
            let length_m = rng.random_range(3.8..4.7);
            if rng.random_bool(PARKED_RATE) {
                shapes.push(Shape::rectangle(&place, length_m, 1.8));
            }
            along_m += 5.6;
        }
    }
}
