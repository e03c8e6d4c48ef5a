//! A production hall full of racks, boxes and columns.

use std::f64::consts::{FRAC_PI_2, PI};

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::random::{Purpose, stream};
use super::{Route, RouteError, Shape, World};
use crate::geometry::{Pose2, Vector2};

/// Along x, metres.
const LENGTH_M: f64 = 40.0;
/// Along y, metres.
const WIDTH_M: f64 = 25.0;
/// Nothing stands nearer to the route, metres: laps may stray by 1 m.
const ROUTE_CLEARANCE_M: f64 = 1.6;
/// Gap between the circles round two objects, metres.
const OBJECT_GAP_M: f64 = 0.2;
/// Spots that are tried for one object.
const TRIES_MAX: usize = 2_000;
const CORNER_RADIUS_M: f64 = 1.5;

/// The route's corners, metres: once round the hall and into its middle.
const CORNERS: [(f64, f64); 8] = [
    (3.5, 3.5),
    (36.5, 3.5),
    (36.5, 21.5),
    (26.0, 21.5),
    (26.0, 12.0),
    (15.0, 12.0),
    (15.0, 21.5),
    (3.5, 21.5),
];

/// A generated hall of 40 m × 25 m with 35 to 40 objects, and a route through it. The map frame's
/// origin is the hall's lower left corner.
#[derive(Debug, Clone, PartialEq)]
pub struct Hall {
    /// The walls, then the objects.
    pub world: World,
    /// A way that stays clear of all objects.
    pub route: Route,
}

impl Hall {
    /// The hall of a seed.
    ///
    /// # Errors
    /// [`RouteError`] if the hall's corners made no route; they do.
    pub fn generate(seed: u64) -> Result<Self, RouteError> {
        let corners = CORNERS.map(|(x, y)| Vector2::new(x, y));
        let route = Route::new(&corners, CORNER_RADIUS_M)?;
        let mut rng = stream(seed, Purpose::World);
        let count = rng.random_range(35..=40);
        let mut shapes = vec![walls()];
        while shapes.len() <= count {
            match place_object(&mut rng, &route, &shapes[1..]) {
                Some(object) => shapes.push(object),
                None => break,
            }
        }
        let world = World::new(shapes);
        Ok(Self { world, route })
    }
}

fn walls() -> Shape {
    Shape::rectangle(
        &Pose2::new(0.5 * LENGTH_M, 0.5 * WIDTH_M, 0.0),
        LENGTH_M,
        WIDTH_M,
    )
}

fn place_object(rng: &mut ChaCha8Rng, route: &Route, others: &[Shape]) -> Option<Shape> {
    (0..TRIES_MAX)
        .map(|_| random_object(rng))
        .find(|object| fits(object, route, others))
}

fn random_object(rng: &mut ChaCha8Rng) -> Shape {
    let centre = Vector2::new(
        rng.random_range(0.0..LENGTH_M),
        rng.random_range(0.0..WIDTH_M),
    );
    match rng.random_range(0..10) {
        0..5 => {
            let along_y = rng.random_bool(0.5);
            let theta = if along_y { FRAC_PI_2 } else { 0.0 };
            let pose = Pose2::new(centre.x, centre.y, theta);
            Shape::rectangle(
                &pose,
                rng.random_range(1.2..3.6),
                rng.random_range(0.5..1.1),
            )
        }
        5..8 => {
            let pose = Pose2::new(centre.x, centre.y, rng.random_range(-PI..PI));
            Shape::rectangle(
                &pose,
                rng.random_range(0.4..1.2),
                rng.random_range(0.4..1.2),
            )
        }
        _ => Shape::Round {
            centre,
            radius_m: rng.random_range(0.15..0.4),
        },
    }
}

fn fits(object: &Shape, route: &Route, others: &[Shape]) -> bool {
    let (centre, reach_m) = object.bounding_circle();
    let to_walls = [centre.x, centre.y, LENGTH_M - centre.x, WIDTH_M - centre.y];
    let inside = to_walls.iter().all(|&gap| gap >= reach_m);
    let apart = others.iter().all(|other| {
        let (other_centre, other_reach_m) = other.bounding_circle();
        (centre - other_centre).norm() >= reach_m + other_reach_m + OBJECT_GAP_M
    });
    let steps = (route.length_m() / 0.2).ceil() as usize;
    let clear = || {
        (0..steps).all(|k| {
            let point = route.pose_at(k as f64 * 0.2).translation();
            object.distance_to(&point) >= ROUTE_CLEARANCE_M
        })
    };
    inside && apart && clear()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn halls_are_full_and_clear_to_drive_in() {
        for seed in 0..12 {
            let hall = Hall::generate(seed).unwrap();
            let objects = hall.world.shapes().len() - 1;
            assert!(
                (35..=40).contains(&objects),
                "seed {seed}: {objects} objects"
            );
            let steps = (hall.route.length_m() * 10.0) as usize;
            for k in 0..steps {
                let pose = hall.route.pose_at(0.1 * k as f64);
                let nearest = hall
                    .world
                    .shapes()
                    .map(|s| s.distance_to(&pose.translation()));
                let nearest = nearest.fold(f64::INFINITY, f64::min);
                assert!(nearest > 1.4, "seed {seed}: {nearest} m at {pose:?}");
            }
        }
    }

    #[test]
    fn a_hall_is_a_function_of_its_seed() {
        assert_eq!(Hall::generate(3), Hall::generate(3));
        assert_ne!(Hall::generate(3), Hall::generate(4));
    }

    #[test]
    fn every_ray_ends_at_a_wall_or_before() {
        let hall = Hall::generate(5).unwrap();
        let eye = hall.route.pose_at(20.0).translation();
        for k in 0..3600 {
            let (sin, cos) = (f64::from(k) * PI / 1800.0).sin_cos();
            let hit = hall.world.cast(&eye, &Vector2::new(cos, sin)).unwrap();
            let end = eye + Vector2::new(cos, sin) * hit.range_m;
            let inside = |v: f64, size: f64| (-1e-6..=size + 1e-6).contains(&v);
            assert!(inside(end.x, LENGTH_M) && inside(end.y, WIDTH_M), "{end:?}");
        }
    }
}
