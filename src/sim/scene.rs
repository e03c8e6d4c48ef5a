//! A world that changes from lap to lap.

use super::lidar::PLANE_M;
use super::{Hall, Hit, Route, Shape, World};
use crate::geometry::Vector2;

/// Larger shapes are parts of buildings, metres from their centre.
const LOOSE_REACH_MAX_M: f64 = 2.5;
/// Thinner shapes are parts of others (a wall, a door, the leg of a rack), metres from centre to outline.
const LOOSE_DEPTH_MIN_M: f64 = 0.1;

/// An object of a scene during some laps.
#[derive(Debug, Clone, PartialEq)]
pub struct SceneObject {
    /// Its outline, map frame.
    pub shape: Shape,
    /// The first lap that has it.
    pub from_lap: usize,
    /// The first lap without it; `None` if it stays.
    pub until_lap: Option<usize>,
    /// Its heights above the floor, from and to, metres.
    pub heights_m: (f64, f64),
}

/// As high as a building is: from the floor upwards, metres.
const FROM_FLOOR_UP_M: (f64, f64) = (0.0, f64::INFINITY);

/// A route through a world whose objects come and go between laps, and people who walk there.
#[derive(Debug, Clone, PartialEq)]
pub struct Scene {
    /// The route of a lap.
    pub route: Route,
    /// Walls and objects.
    pub objects: Vec<SceneObject>,
    /// People near the route in every lap.
    pub walkers: usize,
    /// Seed of their paths, together with the trip's.
    pub seed: u64,
}

/// A scene in one lap, without people.
#[derive(Debug, Clone, PartialEq)]
pub struct LapWorld {
    /// The objects of the lap.
    pub world: World,
    /// The index in [`Scene::objects`] of each of the world's shapes.
    pub objects: Vec<usize>,
}

impl SceneObject {
    /// An object that is always there.
    pub fn lasting(shape: Shape) -> Self {
        Self {
            shape,
            from_lap: 0,
            until_lap: None,
            heights_m: FROM_FLOOR_UP_M,
        }
    }

    /// Whether it is cut by a level plane at a height above the floor, metres.
    pub fn is_cut_at(&self, height_m: f64) -> bool {
        self.heights_m.0 <= height_m && height_m <= self.heights_m.1
    }

    /// Whether it is there in a lap.
    pub fn is_there(&self, lap: usize) -> bool {
        self.from_lap <= lap && self.until_lap.is_none_or(|until| lap < until)
    }

    /// Whether it can be removed by itself: not a part of a building or a rack.
    pub fn stands_free(&self) -> bool {
        let (middle, reach_m) = self.shape.bounding_circle();
        reach_m <= LOOSE_REACH_MAX_M && self.shape.distance_to(&middle) >= LOOSE_DEPTH_MIN_M
    }
}

impl Scene {
    /// A scene with these shapes in all laps, without people.
    pub fn lasting(route: Route, shapes: impl IntoIterator<Item = Shape>, seed: u64) -> Self {
        Self {
            route,
            objects: shapes.into_iter().map(SceneObject::lasting).collect(),
            walkers: 0,
            seed,
        }
    }

    /// A hall as a scene; object 0 is its walls.
    pub fn of_hall(hall: &Hall, seed: u64) -> Self {
        Self::lasting(hall.route.clone(), hall.world.shapes().cloned(), seed)
    }

    /// The mean area of the free-standing objects of the first lap, square metres; 0 without any.
    pub fn mean_object_area_m2(&self) -> f64 {
        let original = self.objects.iter().filter(|o| o.is_there(0));
        let areas: Vec<f64> = original
            .filter(|o| o.stands_free())
            .map(|o| o.shape.area_m2())
            .collect();
        areas.iter().sum::<f64>() / areas.len().max(1) as f64
    }

    /// The objects of a lap at the usual height of lidars.
    pub fn world(&self, lap: usize) -> LapWorld {
        self.world_at(lap, PLANE_M)
    }

    /// The objects of a lap, cut by a level plane at a height above the floor, metres.
    pub fn world_at(&self, lap: usize, height_m: f64) -> LapWorld {
        let there = |k: &usize| {
            let object = &self.objects[*k];
            object.is_there(lap) && object.is_cut_at(height_m)
        };
        let objects: Vec<usize> = (0..self.objects.len()).filter(there).collect();
        let world = World::new(objects.iter().map(|&k| self.objects[k].shape.clone()));
        LapWorld { world, objects }
    }
}

impl LapWorld {
    /// The range of a ray among the objects and `people`, metres, and the scene's object that it hits: `None`
    /// for a person.
    pub(super) fn cast(
        &self,
        people: &World,
        origin: &Vector2<f64>,
        direction: &Vector2<f64>,
    ) -> Option<(f64, Option<usize>)> {
        let thing = self.world.cast(origin, direction);
        let thing = thing.map(|Hit { range_m, shape }| (range_m, Some(self.objects[shape])));
        let person = people
            .cast(origin, direction)
            .map(|hit| (hit.range_m, None));
        let both = [thing, person].into_iter().flatten();
        both.min_by(|a, b| a.0.total_cmp(&b.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pose2;

    #[test]
    fn objects_stand_only_in_their_laps() {
        let hall = Hall::generate(1).unwrap();
        let mut scene = Scene::of_hall(&hall, 1);
        let count = scene.objects.len();
        scene.objects[3].until_lap = Some(2);
        scene.objects.push(SceneObject {
            from_lap: 1,
            until_lap: Some(3),
            ..SceneObject::lasting(Shape::rectangle(&Pose2::IDENTITY, 1.0, 1.0))
        });
        for lap in 0..5 {
            let lap_world = scene.world(lap);
            let expected: Vec<usize> = (0..=count)
                .filter(|&k| match k {
                    3 => lap < 2,
                    k if k == count => (1..3).contains(&lap),
                    _ => true,
                })
                .collect();
            assert_eq!(lap_world.objects, expected);
            for (shape, &k) in lap_world.world.shapes().zip(&lap_world.objects) {
                assert_eq!(shape, &scene.objects[k].shape);
            }
        }
    }
}
