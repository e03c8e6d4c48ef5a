//! People who walk about near a route.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::random::{Purpose, in_disc, stream};
use super::{Route, Scene, Shape, World};
use crate::geometry::Vector2;

const SPEED_MPS: f64 = 1.2;
const BODY_RADIUS_M: f64 = 0.25;
const LEG_RADIUS_M: f64 = 0.08;
/// Lateral distance of a leg from a walker's centre, metres.
const HIP_M: f64 = 0.12;
/// Amplitude of a leg, metres.
const SWING_M: f64 = 0.25;
/// Distance of a walker's centre from all objects, metres.
const CLEARANCE_M: f64 = 0.45;
/// Distance at which a walker steps aside for the vehicle, metres.
const MAKE_WAY_M: f64 = 0.8;
/// Farthest that a walker goes from the route, metres.
const ASTRAY_M: f64 = 2.5;
/// Farthest that a walker goes along the route before turning, metres.
const LEG_ALONG_M: f64 = 8.0;
/// Shortest leg of a walk, metres: with shorter ones a walker would seem to stand still.
const WALK_MIN_M: f64 = 1.5;
const TRIES_MAX: usize = 40;

/// The people of one lap.
pub(super) struct Walkers<'a> {
    walkers: Vec<Walker>,
    route: &'a Route,
    world: &'a World,
}

struct Walker {
    rng: ChaCha8Rng,
    /// Whether the sensor sees two legs, or one body in a long coat.
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
        // Each vehicle meets other people, even in the same lap.
        let seed = scene.seed ^ seed.rotate_left(32);
        let walkers = (0..scene.walkers).map(|walker| {
            let mut rng = stream(seed, Purpose::Walker { lap, walker });
            let way_m = rng.random_range(0.0..route.length_m());
            Walker {
                on_legs: rng.random_bool(0.5),
                from: route.pose_at(way_m - WALK_MIN_M).translation(),
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

    /// Moves everybody on.
    pub(super) fn walk(&mut self, time_s: f64) {
        for walker in &mut self.walkers {
            walker.walked_m += SPEED_MPS * time_s;
            // Bounded: a degenerate route must end too.
            for _ in 0..TRIES_MAX {
                let walk_m = (walker.to - walker.from).norm();
                if walker.walked_m < walk_m {
                    break;
                }
                walker.walked_m -= walk_m;
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
            if (there - here).norm() >= WALK_MIN_M && is_free(world, &here, &there) {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::SimScan;
    use crate::sim::tests::{vehicle, worlds};

    /// Where the walkers of a lap are, every half second.
    fn ways(scene: &Scene, lap: usize, seed: u64) -> Vec<Vec<Vector2<f64>>> {
        let world = scene.world(lap).world;
        let mut walkers = Walkers::new(scene, &world, lap, seed);
        let far_away = Vector2::new(1e3, 1e3);
        (0..240)
            .map(|_| {
                walkers.walk(0.5);
                let middle = |w: &Walker| {
                    let shapes = w.shapes(&far_away);
                    let middles = shapes.iter().map(|s| s.bounding_circle().0);
                    middles.sum::<Vector2<f64>>() / shapes.len() as f64
                };
                walkers.walkers.iter().map(middle).collect()
            })
            .collect()
    }

    #[test]
    fn walkers_walk_free_of_everything_and_never_stay() {
        for (name, mut scene) in worlds(6) {
            scene.walkers = 4;
            let world = scene.world(1).world;
            let places = ways(&scene, 1, 3);
            for pair in places.windows(2) {
                for (before, after) in pair[0].iter().zip(&pair[1]) {
                    assert!((after - before).norm() < SPEED_MPS * 0.5 + 1e-9, "{name}");
                    let gap = world.shapes().map(|s| s.distance_to(after));
                    assert!(gap.fold(f64::INFINITY, f64::min) > 0.4, "{name}");
                    assert!(!world.shapes().skip(1).any(|s| s.contains(after)), "{name}");
                }
            }
            // After three seconds nobody stands where they stood, but for those who turn.
            let moved = |k: usize, w: usize| (places[k + 6][w] - places[k][w]).norm();
            let all = (0..places.len() - 6).flat_map(|k| (0..4).map(move |w| (k, w)));
            let (stood, looks) = all.fold((0, 0), |(stood, looks), (k, w)| {
                (stood + usize::from(moved(k, w) < 0.5), looks + 1)
            });
            assert!(stood * 5 < looks, "{name}: {stood} of {looks}");
        }
    }

    #[test]
    fn every_lap_and_every_drive_has_other_walkers() {
        let [(_, mut scene), ..] = worlds(6);
        scene.walkers = 3;
        let mut elsewhere = scene.clone();
        elsewhere.seed += 1;
        let here = ways(&scene, 1, 3);
        assert_eq!(here, ways(&scene, 1, 3));
        for other in [
            ways(&scene, 2, 3),
            ways(&scene, 1, 4),
            ways(&elsewhere, 1, 3),
        ] {
            for (a, b) in here[0].iter().zip(&other[0]) {
                assert!((a - b).norm() > 1e-3);
            }
        }
    }

    #[test]
    fn walkers_are_seen_and_leave_no_trace() {
        for (name, mut scene) in worlds(7) {
            let empty = scene.drive(&vehicle(0.3), 0..2, 5);
            scene.walkers = 5;
            let peopled = scene.drive(&vehicle(0.3), 0..2, 5);
            let mut nearer = [0, 0];
            for (a, b) in empty.iter().zip(&peopled) {
                let poses = |s: &SimScan| (s.map_from_base, s.odom_from_base, s.time_s, s.lap);
                assert_eq!(poses(a), poses(b), "{name}");
                for (k, (x, y)) in a.ranges_m.iter().zip(&b.ranges_m).enumerate() {
                    if x != y {
                        assert!(y.is_none_or(|y| x.is_none_or(|x| y < x)), "{name}");
                        assert_eq!(b.hit_objects[k], None, "{name}: a person is no object");
                        nearer[b.lap] += 1;
                    } else {
                        assert_eq!(a.hit_objects[k], b.hit_objects[k], "{name}");
                    }
                }
            }
            assert!(
                nearer.iter().all(|&beams| beams > 100),
                "{name}: {nearer:?}"
            );
        }
    }

    #[test]
    fn walkers_make_way() {
        let [(_, mut scene), ..] = worlds(8);
        scene.walkers = 8;
        let mut vehicle = vehicle(0.0);
        vehicle.lidar.geometry.range_sigma_m = 1e-9;
        for scan in scene.drive(&vehicle, 0..1, 1) {
            let nearest = scan.ranges_m.iter().flatten().copied();
            assert!(nearest.fold(f64::INFINITY, f64::min) > 0.1);
        }
    }
}
