//! Random changes of a scene.

use std::f64::consts::PI;

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::random::{Purpose, stream};
use super::{Furniture, Scene, SceneObject, Shape, World};
use crate::geometry::{Pose2, Vector2};

/// Clearance of a vehicle on either side of its path, metres.
const PASSING_M: f64 = 0.5;
/// New objects are at most this much farther from the route than they must be, metres.
const NEAR_ROUTE_M: f64 = 2.0;
/// Gap between an object and the circle round a new one, metres.
const GAP_M: f64 = 0.2;
/// Step along the route at which the clearance is checked, metres.
const ROUTE_STEP_M: f64 = 0.2;
/// Radius of a person who stands still, metres.
const BYSTANDER_RADIUS_M: f64 = 0.25;
/// Places that are tried for one object.
const TRIES_MAX: usize = 2_000;

/// Makes changes before one lap.
///
/// New objects stand near the route and visible from it, and leave room for vehicles whose laps stray by the stated
/// path noise. They stand free and do not overlap any object of any lap; walls take away what stands free in
/// their way.
#[derive(Debug)]
pub struct Changes<'a> {
    scene: &'a mut Scene,
    lap: usize,
    clearance_m: f64,
    rng: ChaCha8Rng,
}

impl<'a> Changes<'a> {
    /// Changes before lap `lap`, for laps that stray by `path_noise_m`.
    pub fn new(scene: &'a mut Scene, lap: usize, path_noise_m: f64, seed: u64) -> Self {
        Self {
            scene,
            lap,
            clearance_m: path_noise_m + PASSING_M,
            rng: stream(seed, Purpose::Changes { lap }),
        }
    }

    /// Adds objects whose area is `area_share` of the mean area of the scene's original
    /// free-standing objects. Returns their indices in [`Scene::objects`]: fewer than `count` where
    /// there is no room for more.
    pub fn add(&mut self, count: usize, area_share: f64) -> Vec<usize> {
        let area_m2 = area_share * self.scene.mean_object_area_m2();
        let mut added = Vec::new();
        for _ in 0..count {
            let shape = random_shape(&mut self.rng, area_m2);
            added.extend(self.find_place(&shape).map(|shape| self.push(shape)));
        }
        added
    }

    /// Takes away free-standing objects that were there before. Returns their indices in
    /// [`Scene::objects`]: fewer than `count` where there are no more.
    pub fn remove(&mut self, count: usize) -> Vec<usize> {
        let mut removed = Vec::new();
        for _ in 0..count {
            removed.extend(self.choose().inspect(|&object| self.take(object)));
        }
        removed
    }

    /// Moves free-standing objects that were there before to other places. Returns the old and the new index in
    /// [`Scene::objects`] of each: fewer than `count` where there is no room.
    pub fn displace(&mut self, count: usize) -> Vec<(usize, usize)> {
        let mut moved = Vec::new();
        for _ in 0..count {
            let Some(object) = self.choose() else { break };
            let shape = self.scene.objects[object].shape.clone();
            if let Some(shape) = self.find_place(&shape) {
                self.take(object);
                moved.push((object, self.push(shape)));
            }
        }
        moved
    }

    /// Adds people who stand still during this one lap. Returns their indices in
    /// [`Scene::objects`]: fewer than `count` where there is no room for more.
    pub fn bystanders(&mut self, count: usize) -> Vec<usize> {
        let body = Shape::Round {
            centre: Vector2::zeros(),
            radius_m: BYSTANDER_RADIUS_M,
        };
        let mut bystanders = Vec::new();
        for _ in 0..count {
            if let Some(body) = self.find_place(&body) {
                let object = self.push(body);
                self.scene.objects[object].until_lap = Some(self.lap + 1);
                bystanders.push(object);
            }
        }
        bystanders
    }

    /// Puts furniture no farther than `beside_m` from where vehicles may drive. Answers the places of
    /// its parts in [`Scene::objects`]; `None` where there is no room.
    pub fn furnish(&mut self, furniture: Furniture, beside_m: f64) -> Option<Vec<usize>> {
        let near = (0..TRIES_MAX).find_map(|_| {
            let outline = self.find_place(&furniture.outline(&Pose2::IDENTITY))?;
            let steps = (self.scene.route.length_m() / ROUTE_STEP_M).ceil() as usize;
            let way_m = |k: usize| {
                let at = self.scene.route.pose_at(k as f64 * ROUTE_STEP_M);
                outline.distance_to(&at.translation())
            };
            let nearest_m = (0..steps).map(way_m).fold(f64::INFINITY, f64::min);
            (nearest_m <= self.clearance_m + beside_m).then_some(outline)
        })?;
        let parts = furniture.parts(&near)?.into_iter();
        let parts = parts.map(|(shape, heights_m)| {
            let part = self.push(shape);
            self.scene.objects[part].heights_m = heights_m;
            part
        });
        Some(parts.collect())
    }

    fn choose(&mut self) -> Option<usize> {
        self.lap.checked_sub(1)?;
        let candidates: Vec<usize> = (0..self.scene.objects.len())
            .filter(|&k| self.gives_way(k))
            .collect();
        let place = self.rng.random_range(0..candidates.len().max(1));
        candidates.get(place).copied()
    }

    /// Whether an object can go: it stands free, and was there until now.
    fn gives_way(&self, object: usize) -> bool {
        let object = &self.scene.objects[object];
        let was_there = object.is_there(self.lap.saturating_sub(1));
        object.stands_free() && was_there && object.is_there(self.lap)
    }

    fn take(&mut self, object: usize) {
        self.scene.objects[object].until_lap = Some(self.lap);
    }

    fn push(&mut self, shape: Shape) -> usize {
        self.scene.objects.push(SceneObject {
            from_lap: self.lap,
            ..SceneObject::lasting(shape)
        });
        self.scene.objects.len() - 1
    }

    /// The shape at a random place where it may stand.
    fn find_place(&mut self, shape: &Shape) -> Option<Shape> {
        let all = World::new(self.scene.objects.iter().map(|o| o.shape.clone()));
        (0..TRIES_MAX).find_map(|_| self.try_place(&all, shape))
    }

    fn try_place(&mut self, all: &World, shape: &Shape) -> Option<Shape> {
        let (middle, reach_m) = shape.bounding_circle();
        let way_m = self.rng.random_range(0.0..self.scene.route.length_m());
        let vehicle = self.scene.route.pose_at(way_m);
        let side = if self.rng.random() { 1.0 } else { -1.0 };
        let farther_m = self.rng.random_range(0.0..reach_m + NEAR_ROUTE_M);
        let aside = Vector2::new(0.0, side * (self.clearance_m + farther_m));
        let place = vehicle.transform(&aside);
        let map_from_place = Pose2::new(place.x, place.y, self.rng.random_range(-PI..PI));
        let is_free = is_visible(all, &vehicle.translation(), &place)
            && all
                .shapes()
                .all(|s| s.distance_to(&place) >= reach_m + GAP_M);
        let placed = shape.moved(&map_from_place.compose(&Pose2::new(-middle.x, -middle.y, 0.0)));
        (is_free && self.lets_pass(&placed)).then_some(placed)
    }

    fn lets_pass(&self, shape: &Shape) -> bool {
        let steps = (self.scene.route.length_m() / ROUTE_STEP_M).ceil() as usize;
        (0..steps).all(|k| {
            let pose = self.scene.route.pose_at(k as f64 * ROUTE_STEP_M);
            let point = pose.translation();
            !shape.contains(&point) && shape.distance_to(&point) >= self.clearance_m
        })
    }
}

/// Whether a place is visible from the route: not inside an object, nor behind a wall.
fn is_visible(world: &World, eye: &Vector2<f64>, place: &Vector2<f64>) -> bool {
    let way = place - eye;
    let hit = world.cast(eye, &way.normalize());
    hit.is_none_or(|hit| hit.range_m > way.norm())
}

fn random_shape(rng: &mut ChaCha8Rng, area_m2: f64) -> Shape {
    if rng.random_bool(0.25) {
        let radius_m = (area_m2 / PI).sqrt();
        let centre = Vector2::zeros();
        return Shape::Round { centre, radius_m };
    }
    let aspect: f64 = rng.random_range(1.0..2.0);
    let width_m = (area_m2 / aspect).sqrt();
    Shape::rectangle(&Pose2::IDENTITY, aspect * width_m, width_m)
}

mod rebuilding;
#[cfg(test)]
mod tests;
