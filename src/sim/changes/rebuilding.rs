//! Works in a building: walls that are put up and taken down, and a part that is filled anew.

use std::f64::consts::FRAC_PI_2;
use std::ops::Range;

use rand::RngExt;

use super::{Changes, GAP_M, NEAR_ROUTE_M, ROUTE_STEP_M, TRIES_MAX, is_visible};
use crate::geometry::{Pose2, Vector2};
use crate::sim::{Scene, Shape, World};

/// Partition walls are so long, metres.
const WALL_LENGTH_M: Range<f64> = 3.0..6.0;
const WALL_THICKNESS_M: f64 = 0.15;
/// Step along a wall at which its gaps are checked, metres.
const WALL_STEP_M: f64 = 0.1;
/// A thing is put down in a part of the world if one of so many places lies there.
const PLACES_MAX: usize = 200;

impl Changes<'_> {
    /// Puts up partition walls near the route, along it or across as there is room. What stands
    /// free in their way goes. Returns their indices in [`Scene::objects`]: fewer than `count`
    /// where there is no room for more.
    pub fn put_up_walls(&mut self, count: usize) -> Vec<usize> {
        let mut walls = Vec::new();
        for _ in 0..count {
            let objects = 0..self.scene.objects.len();
            // A wall keeps clear of what other laps have, too.
            let (gives_way, others): (Vec<_>, Vec<_>) = objects.partition(|&k| self.gives_way(k));
            let others = World::new(others.iter().map(|&k| self.scene.objects[k].shape.clone()));
            let Some(wall) = (0..TRIES_MAX).find_map(|_| self.try_wall(&others)) else {
                break;
            };
            for object in gives_way {
                if wall.touches(&self.scene.objects[object].shape) {
                    self.take(object);
                }
            }
            walls.push(self.push(wall.shape()));
        }
        walls
    }

    /// Takes down walls, by their indices in [`Scene::objects`].
    pub fn take_down_walls(&mut self, walls: &[usize]) {
        for &wall in walls {
            self.take(wall);
        }
    }

    /// Moves all that stands free in one third of the world, of three along x, to other places in
    /// that third. Returns the new indices in [`Scene::objects`]: fewer than have gone where there is
    /// no room.
    pub fn rebuild_third(&mut self, third: usize) -> Vec<usize> {
        let part_m = third_of(self.scene, third);
        let is_inside = |shape: &Shape| part_m.contains(&shape.bounding_circle().0.x);
        let goes: Vec<usize> = (0..self.scene.objects.len())
            .filter(|&k| self.gives_way(k) && is_inside(&self.scene.objects[k].shape))
            .collect();
        let mut came = Vec::new();
        for object in goes {
            self.take(object);
            let shape = self.scene.objects[object].shape.clone();
            let place = (0..PLACES_MAX).find_map(|_| self.find_place(&shape).filter(is_inside));
            came.extend(place.map(|shape| self.push(shape)));
        }
        came
    }

    /// A wall at a random place, visible from the route and clear of `others`.
    fn try_wall(&mut self, others: &World) -> Option<Wall> {
        let way_m = self.rng.random_range(0.0..self.scene.route.length_m());
        let length_m = self.rng.random_range(WALL_LENGTH_M);
        let near_m = self.clearance_m + self.rng.random_range(0.0..NEAR_ROUTE_M);
        let side = if self.rng.random() { 1.0 } else { -1.0 };
        let (aside_m, turn_rad) = match self.rng.random() {
            true => (near_m + 0.5 * length_m, FRAC_PI_2),
            false => (near_m + 0.5 * WALL_THICKNESS_M, 0.0),
        };
        let vehicle = self.scene.route.pose_at(way_m);
        let wall = Wall {
            map_from_middle: vehicle.compose(&Pose2::new(0.0, side * aside_m, turn_rad)),
            length_m,
        };
        let eye = vehicle.translation();
        let is_clear = wall.points().all(|point| is_visible(others, &eye, &point))
            && others.shapes().all(|shape| !wall.is_near(shape))
            && self.lets_pass(&wall.shape());
        is_clear.then_some(wall)
    }
}

/// A partition wall.
struct Wall {
    /// x along the wall.
    map_from_middle: Pose2,
    length_m: f64,
}

impl Wall {
    fn shape(&self) -> Shape {
        Shape::rectangle(&self.map_from_middle, self.length_m, WALL_THICKNESS_M)
    }

    /// Points along its middle, map frame.
    fn points(&self) -> impl Iterator<Item = Vector2<f64>> {
        let steps = (self.length_m / WALL_STEP_M).ceil() as usize;
        (0..=steps).map(move |k| {
            let along_m = (k as f64 / steps as f64 - 0.5) * self.length_m;
            self.map_from_middle.transform(&Vector2::new(along_m, 0.0))
        })
    }

    /// Whether an outline is nearer than the usual gap.
    fn is_near(&self, shape: &Shape) -> bool {
        let gap_m = GAP_M + 0.5 * WALL_THICKNESS_M;
        self.points().any(|point| shape.distance_to(&point) < gap_m)
    }

    /// Whether the wall and something solid could not both be there.
    fn touches(&self, shape: &Shape) -> bool {
        self.is_near(shape) || self.points().any(|point| shape.contains(&point))
    }
}

/// From where to where a third of a scene reaches along x, metres: the route's extent is cut in
/// three, and the outer ones reach beyond it.
fn third_of(scene: &Scene, third: usize) -> Range<f64> {
    let steps = (scene.route.length_m() / ROUTE_STEP_M).ceil() as usize;
    let x_m = |k: usize| scene.route.pose_at(k as f64 * ROUTE_STEP_M).translation().x;
    let (min_m, max_m) = (0..steps)
        .map(x_m)
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(min_m, max_m), x| {
            (min_m.min(x), max_m.max(x))
        });
    let cut_m = |cut: usize| match cut {
        0 => f64::NEG_INFINITY,
        3.. => f64::INFINITY,
        _ => min_m + (max_m - min_m) * cut as f64 / 3.0,
    };
    cut_m(third)..cut_m(third + 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::SceneObject;
    use crate::sim::tests::worlds;

    /// The smallest distance of a wall's middle line from any of the shapes.
    fn gap_m(wall: &Shape, shapes: impl Iterator<Item = Shape>) -> f64 {
        let Shape::Outline(corners) = wall else {
            panic!("a wall has corners")
        };
        let [a, b] = [
            (corners[0] + corners[3]) / 2.0,
            (corners[1] + corners[2]) / 2.0,
        ];
        let points: Vec<_> = (0..=60)
            .map(|k| a + (b - a) * f64::from(k) / 60.0)
            .collect();
        let gaps = shapes.flat_map(|s| {
            points
                .iter()
                .map(move |p| s.distance_to(p))
                .collect::<Vec<_>>()
        });
        gaps.fold(f64::INFINITY, f64::min)
    }

    #[test]
    fn walls_leave_room_to_pass_and_take_away_what_they_would_cut() {
        let mut taken = 0;
        for (name, original) in worlds(3) {
            let mut scene = original.clone();
            let first = Changes::new(&mut scene, 0, 0.5, 5).put_up_walls(3);
            let mut changes = Changes::new(&mut scene, 2, 0.5, 5);
            changes.take_down_walls(&first);
            let second = changes.put_up_walls(3);
            assert_eq!((first.len(), second.len()), (3, 3), "{name}");
            for (walls, lap) in [(&first, 0), (&second, 2)] {
                for &wall in walls {
                    let there = &scene.objects[wall];
                    assert!(there.is_there(lap) && !there.stands_free(), "{name}");
                    // No lap has anything where the wall stands in it.
                    let meets = |other: &&SceneObject| {
                        let both = |lap| there.is_there(lap) && other.is_there(lap);
                        !std::ptr::eq(*other, there) && (0..4).any(both)
                    };
                    let others = scene.objects.iter().filter(meets);
                    let others = others.map(|other| other.shape.clone());
                    assert!(gap_m(&there.shape, others) > 0.15, "{name}");
                    let steps = (scene.route.length_m() * 10.0) as usize;
                    let nearest = (0..steps).map(|k| {
                        let at = scene.route.pose_at(0.1 * k as f64);
                        there.shape.distance_to(&at.translation())
                    });
                    assert!(nearest.fold(f64::INFINITY, f64::min) > 0.9, "{name}");
                }
            }
            assert!(first.iter().all(|&k| scene.objects[k].until_lap == Some(2)));
            let went = |lap| {
                scene.objects[..original.objects.len()]
                    .iter()
                    .filter(|o| o.until_lap == Some(lap))
                    .count()
            };
            taken += went(0) + went(2);
        }
        assert!(taken > 0);
    }

    #[test]
    fn of_a_third_everything_is_somewhere_else_and_of_the_rest_nothing() {
        for (name, original) in worlds(4) {
            let free = original.objects.iter().filter(|o| o.stands_free()).count();
            let mut went_in_all = 0;
            for third in 0..3 {
                let mut scene = original.clone();
                let came = Changes::new(&mut scene, 2, 0.5, 6).rebuild_third(third);
                let part_m = third_of(&original, third);
                let is_inside = |shape: &Shape| part_m.contains(&shape.bounding_circle().0.x);
                for object in &scene.objects[..original.objects.len()] {
                    let goes = object.stands_free() && is_inside(&object.shape);
                    assert_eq!(object.until_lap, goes.then_some(2), "{name}");
                }
                let new = &scene.objects[original.objects.len()..];
                assert!(
                    new.iter().all(|o| o.from_lap == 2 && is_inside(&o.shape)),
                    "{name}"
                );
                assert_eq!(came.len(), new.len());
                let went = scene.objects.iter().filter(|o| o.until_lap == Some(2));
                let (went, came) = (went.count(), came.len());
                assert!(came <= went && 2 * came > went, "{name}: {came} of {went}");
                went_in_all += went;
            }
            assert_eq!(went_in_all, free, "{name}");
        }
    }

    #[test]
    fn works_are_a_function_of_their_seed() {
        let built = |seed| {
            let [(_, mut scene), ..] = worlds(5);
            let mut changes = Changes::new(&mut scene, 2, 0.5, seed);
            changes.put_up_walls(2);
            changes.rebuild_third(1);
            scene
        };
        assert_eq!(built(1), built(1));
        assert_ne!(built(1), built(2));
    }
}
