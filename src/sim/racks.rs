//! A store of pallet racks: a lidar near the floor sees their legs and what stands between them.

use rand::RngExt;

use super::random::{Purpose, stream};
use super::{Changes, Route, RouteError, Scene, Shape};
use crate::geometry::{Pose2, Vector2};

const LENGTH_M: f64 = 30.0;
const WIDTH_M: f64 = 19.0;
const LEG_M: f64 = 0.08;
/// From leg to leg along a row and across it, metres.
const BAY_M: f64 = 2.7;
const DEPTH_M: f64 = 1.0;
/// The rows: where they begin, the y of their middle, and how many bays they have.
const ROWS: [(f64, f64, usize); 3] = [(6.0, 5.15, 6), (9.5, 9.45, 6), (6.0, 13.75, 6)];
/// Up and down the aisles between the rows.
const CORNERS: [(f64, f64); 8] = [
    (3.0, 3.0),
    (27.5, 3.0),
    (27.5, 7.3),
    (6.8, 7.3),
    (6.8, 11.6),
    (27.5, 11.6),
    (27.5, 15.9),
    (3.0, 15.9),
];
const PALLET_RATE: f64 = 0.6;
/// Loose things along the walls, as shares of a pallet's area.
const LOOSE: [(usize, f64); 2] = [(4, 0.3), (4, 0.8)];

impl Scene {
    /// A store of 30 m × 19 m with three rows of pallet racks on legs of 8 cm, filled in part. The
    /// map frame's origin is its lower left corner.
    ///
    /// # Errors
    /// [`RouteError`] if the aisles made no route; they do.
    pub fn racks(seed: u64) -> Result<Self, RouteError> {
        let corners = CORNERS.map(|(x, y)| Vector2::new(x, y));
        let route = Route::new(&corners, 1.2)?;
        let mut rng = stream(seed, Purpose::World);
        let middle = Pose2::new(0.5 * LENGTH_M, 0.5 * WIDTH_M, 0.0);
        let mut shapes = vec![Shape::rectangle(&middle, LENGTH_M, WIDTH_M)];
        for (from_x, y, bays) in ROWS {
            for post in 0..=bays {
                let x = from_x + post as f64 * BAY_M;
                for side in [-0.5, 0.5] {
                    let leg = Pose2::new(x, y + side * DEPTH_M, 0.0);
                    shapes.push(Shape::rectangle(&leg, LEG_M, LEG_M));
                }
            }
            for place in 0..2 * bays {
                let x = from_x + (place as f64 + 0.5) * 0.5 * BAY_M;
                let mut about = |size: f64| rng.random_range(-size..size);
                let pallet = Pose2::new(x + about(0.03), y + about(0.05), about(0.03));
                if rng.random_bool(PALLET_RATE) {
                    shapes.push(Shape::rectangle(&pallet, 1.0, 0.8));
                }
            }
        }
        let mut scene = Self::lasting(route, shapes, seed);
        let mut loose = Changes::new(&mut scene, 0, 1.1, seed);
        for (count, area_share) in LOOSE {
            loose.add(count, area_share);
        }
        Ok(scene)
    }
}
