//! People who walk about near a route.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::random::{Purpose, in_disc, stream};
use super::{Route, Scene, Shape, World};
use crate::geometry::Vector2;

const SPEED_MPS: f64 = 1.2;
const BODY_RADIUS_M: f64 = 0.25;
const LEG_RADIUS_M: f64 = 0.08;
/// From a walker's middle to a leg's, sideways.
const HIP_M: f64 = 0.12;
/// How far a leg swings to the front and to the back.
const SWING_M: f64 = 0.25;
/// A walker's middle keeps this far from everything.
const CLEARANCE_M: f64 = 0.45;
/// A walker steps aside for the vehicle.
const MAKE_WAY_M: f64 = 0.8;
/// How far from the route a walker turns.
const ASTRAY_M: f64 = 2.5;
/// How far along the route a walker goes before turning.
const LEG_ALONG_M: f64 = 8.0;
/// A walker who turns on the spot more often would seem to stand.
const STRETCH_MIN_M: f64 = 1.5;
const TRIES_MAX: usize = 40;

/// The people of one lap.
pub(super) struct Walkers<'a> {
    walkers: Vec<Walker>,
    route: &'a Route,
    world: &'a World,
}

struct Walker {
    rng: ChaCha8Rng,
    /// At this sensor's height: two legs, or one body in a long coat.
    on_legs: bool,
    from: Vector2<f64>,
    to: Vector2<f64>,
    /// Where along the route `to` is.
    to_way_m: f64,
    walked_m: f64,
}

impl<'a> Walkers<'a> {
    /// People at random places of the route; `seed` is the drive's.
    pub(super) fn new(scene: &'a Scene, world: &'a World, lap: usize, seed: u64) -> Self {
        let route = &scene.route;
        // Each vehicle meets other people, in one and the same lap too.
        let seed = scene.seed ^ seed.rotate_left(32);
        let walkers = (0..scene.walkers).map(|walker| {
            let mut rng = stream(seed, Purpose::Walker { lap, walker });
            let way_m = rng.random_range(0.0..route.length_m());
            Walker {
                on_legs: rng.random_bool(0.5),
                from: route.pose_at(way_m - STRETCH_MIN_M).translation(),
                to: route.pose_at(way_m).translation(),
                to_way_m: way_m,
                walked_m: 0.0,
                rng,
            }
        });
        Self {
            walkers: walkers.collect(),
            route,
            world,
        }
    }

    /// Everybody walks on for a time.
    pub(super) fn walk(&mut self, time_s: f64) {
        for walker in &mut self.walkers {
            walker.walked_m += SPEED_MPS * time_s;
            // A bound, so that a route on one spot ends as well.
            for _ in 0..TRIES_MAX {
                let stretch_m = (walker.to - walker.from).norm();
                if walker.walked_m < stretch_m {
                    break;
                }
                walker.walked_m -= stretch_m;
                walker.turn(self.route, self.world);
            }
        }
    }

    /// The people as a lidar sees them from a vehicle at `vehicle`.
    pub(super) fn seen_from(&self, vehicle: &Vector2<f64>) -> World {
        World::new(self.walkers.iter().flat_map(|w| w.shapes(vehicle)))
    }
}

impl Walker {
    /// Chooses where to go next, or goes back.
    fn turn(&mut self, route: &Route, world: &World) {
        let here = self.to;
        for _ in 0..TRIES_MAX {
            let way_m = self.to_way_m + self.rng.random_range(-LEG_ALONG_M..LEG_ALONG_M);
            let there = route.pose_at(way_m).translation() + in_disc(&mut self.rng, ASTRAY_M);
            if (there - here).norm() >= STRETCH_MIN_M && is_free(world, &here, &there) {
                (self.from, self.to, self.to_way_m) = (here, there, way_m);
                return;
            }
        }
        (self.from, self.to) = (here, self.from);
    }

    fn shapes(&self, vehicle: &Vector2<f64>) -> Vec<Shape> {
        let along = (self.to - self.from).normalize();
        let mut middle = self.from + along * self.walked_m;
        let away = middle - vehicle;
        if away.norm() < MAKE_WAY_M && away.norm() > 0.0 {
            middle = vehicle + away.normalize() * MAKE_WAY_M;
        }
        let round = |centre, radius_m| Shape::Round { centre, radius_m };
        if !self.on_legs {
            return vec![round(middle, BODY_RADIUS_M)];
        }
        let aside = Vector2::new(-along.y, along.x) * HIP_M;
        let swing = along * (SWING_M * (std::f64::consts::TAU * self.walked_m / 1.5).sin());
        vec![
            round(middle + aside + swing, LEG_RADIUS_M),
            round(middle - aside - swing, LEG_RADIUS_M),
        ]
    }
}

fn is_free(world: &World, from: &Vector2<f64>, to: &Vector2<f64>) -> bool {
    let steps = ((to - from).norm() / 0.1).ceil();
    (0..=steps as usize).all(|k| {
        let point = from + (to - from) * (k as f64 / steps);
        world
            .shapes()
            .all(|shape| shape.distance_to(&point) >= CLEARANCE_M)
    })
}
