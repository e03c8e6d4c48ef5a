//! Rooms on both sides of a corridor, with doors that open and close.

use std::f64::consts::{FRAC_PI_2, PI};

use rand::RngExt;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

use super::random::{Purpose, normal, stream};
use super::{Changes, Route, RouteError, Scene, SceneObject, Shape};
use crate::geometry::{Pose2, Vector2};

/// Depth of the outer rooms, metres.
const ROOM_DEPTH_M: f64 = 4.5;
const WALL_M: f64 = 0.12;
const DOOR_M: f64 = 1.0;
const DOOR_THICKNESS_M: f64 = 0.05;
/// A closed door overlaps its frame by this on either side: nothing is seen past it.
const DOOR_STOP_M: f64 = 0.01;
/// Rooms are so long, or a little more.
const ROOM_LENGTH_M: f64 = 4.5;
const OPEN_RATE: f64 = 0.5;
/// Of so much corridor there is one thing in it, metres.
const CORRIDOR_PER_THING_M: f64 = 7.3;

/// How large a floor is: a corridor runs round the inner rooms, the outer rooms lie round it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FloorPlan {
    /// Along x, metres.
    pub length_m: f64,
    /// Along y, metres.
    pub width_m: f64,
    /// How wide the corridor is, metres.
    pub corridor_m: f64,
    /// Whether the floor looks the same turned by half: walls, doors and all that stands there.
    pub is_symmetric: bool,
}

impl FloorPlan {
    /// 32 m × 24 m with a wide corridor.
    const OFFICE: Self = Self {
        length_m: 32.0,
        width_m: 24.0,
        corridor_m: 4.4,
        is_symmetric: false,
    };

    /// A floor of the proportions 4 to 3 whose corridor is `way_m` long, along its middle.
    pub fn round(way_m: f64, corridor_m: f64) -> Self {
        let outside_m = 2.0 * ROOM_DEPTH_M + corridor_m;
        Self {
            length_m: way_m * 2.0 / 7.0 + outside_m,
            width_m: way_m * 1.5 / 7.0 + outside_m,
            corridor_m,
            is_symmetric: false,
        }
    }

    /// From the outer walls to the middle of the corridor, metres.
    fn middle_m(&self) -> f64 {
        ROOM_DEPTH_M + 0.5 * self.corridor_m
    }

    /// Length of the corridor along its middle, metres.
    fn way_m(&self) -> f64 {
        2.0 * (self.length_m + self.width_m) - 8.0 * self.middle_m()
    }

    /// The corners of the floor, so far inside of its walls.
    fn corners(&self, inside_m: f64) -> [Vector2<f64>; 4] {
        let (right, top) = (self.length_m - inside_m, self.width_m - inside_m);
        [
            Vector2::new(inside_m, inside_m),
            Vector2::new(right, inside_m),
            Vector2::new(right, top),
            Vector2::new(inside_m, top),
        ]
    }
}

/// A floor; the map frame's origin is its lower left corner.
#[derive(Debug, Clone, PartialEq)]
pub struct Rooms {
    /// Walls, doors and furniture, and the way along the corridor.
    pub scene: Scene,
    doors: Vec<Door>,
}

#[derive(Debug, Clone, PartialEq)]
struct Door {
    /// `map_from_hinge`: x to the latch, y into the room.
    hinge: Pose2,
    /// What it is now, by its place in [`Scene::objects`].
    object: usize,
    open: bool,
}

impl Rooms {
    /// The floor of a seed, 32 m × 24 m.
    ///
    /// # Errors
    /// [`RouteError`] if the corridor made no route; it does.
    pub fn generate(seed: u64) -> Result<Self, RouteError> {
        Self::of_plan(&FloorPlan::OFFICE, seed)
    }

    /// The floor of a plan and a seed. The doors of a symmetric one do not swing.
    ///
    /// # Errors
    /// [`RouteError`] if the plan has no room for a corridor with rooms on both sides.
    pub fn of_plan(plan: &FloorPlan, seed: u64) -> Result<Self, RouteError> {
        let mut rng = stream(seed, Purpose::World);
        let route = Route::new(&plan.corners(plan.middle_m()), 1.5)?;
        let walls = Shape::Outline(plan.corners(0.0).into());
        let scene = Scene::lasting(route, [walls], seed);
        let doors = Vec::new();
        let mut rooms = Self { scene, doors };
        let outer = plan.corners(ROOM_DEPTH_M);
        rooms.build(&mut rng, &outer, ROOM_DEPTH_M, -1.0);
        let inner = plan.corners(ROOM_DEPTH_M + plan.corridor_m);
        rooms.build(&mut rng, &inner, 0.35 * ROOM_DEPTH_M, 1.0);
        rooms.furnish(&mut rng, plan);
        if plan.is_symmetric {
            rooms.make_symmetric(plan);
        }
        Ok(rooms)
    }

    /// Opens closed doors and closes open ones before lap `lap`. Answers where in
    /// [`Scene::objects`] each door was and is: fewer than `count` where there are no more.
    pub fn swing_doors(&mut self, count: usize, lap: usize, seed: u64) -> Vec<(usize, usize)> {
        let mut rng = stream(seed, Purpose::Changes { lap });
        let mut order: Vec<usize> = (0..self.doors.len()).collect();
        order.shuffle(&mut rng);
        let mut swung = Vec::new();
        for &k in order.iter().take(count) {
            let door = &mut self.doors[k];
            let was = door.object;
            door.open = !door.open;
            door.object = self.scene.objects.len();
            self.scene.objects[was].until_lap = Some(lap);
            self.scene.objects.push(SceneObject {
                from_lap: lap,
                ..SceneObject::lasting(door.shape())
            });
            swung.push((was, door.object));
        }
        swung
    }

    /// Lets doors stand ajar, or less open than they do, for single laps: in each of them one door
    /// of `1 / every`, by an angle of the stated standard deviation. Doors that swing in some lap
    /// stay as they are. Answers the places in [`Scene::objects`] of the doors that do so, in all
    /// their positions.
    pub fn leave_ajar(
        &mut self,
        laps: std::ops::Range<usize>,
        every: u32,
        sigma_rad: f64,
        seed: u64,
    ) -> Vec<usize> {
        let mut passing = Vec::new();
        for lap in laps {
            let mut rng = stream(seed, Purpose::Doors { lap });
            for door in &mut self.doors {
                let is_ajar = rng.random_ratio(1, every.max(1));
                let turn_rad = normal(&mut rng, sigma_rad).abs();
                let object = &self.scene.objects[door.object];
                let swings = object.from_lap > 0 && !passing.contains(&door.object);
                if !is_ajar || swings {
                    continue;
                }
                let shape = object.shape.clone();
                let until_lap = self.scene.objects[door.object].until_lap;
                self.scene.objects[door.object].until_lap = Some(lap);
                passing.push(door.object);
                let pieces = [
                    (door.shape_ajar(turn_rad), lap, Some(lap + 1)),
                    (shape, lap + 1, until_lap),
                ];
                for (shape, from_lap, until_lap) in pieces {
                    passing.push(self.scene.objects.len());
                    self.scene.objects.push(SceneObject {
                        from_lap,
                        until_lap,
                        ..SceneObject::lasting(shape)
                    });
                }
                door.object = self.scene.objects.len() - 1;
            }
        }
        passing
    }

    /// Rooms along the sides of a rectangle of corridor walls: `inwards` is 1 if they lie on the
    /// left of its sides. Partitions reach `depth_m` into them.
    fn build(
        &mut self,
        rng: &mut ChaCha8Rng,
        corners: &[Vector2<f64>; 4],
        depth_m: f64,
        inwards: f64,
    ) {
        for (k, from) in corners.iter().enumerate() {
            let side = corners[(k + 1) % 4] - from;
            let start = Pose2::new(from.x, from.y, side.y.atan2(side.x));
            let count = (side.norm() / ROOM_LENGTH_M).floor().max(1.0);
            let length_m = side.norm() / count;
            for room in 0..count as usize {
                let map_from_room = start.compose(&Pose2::new(room as f64 * length_m, 0.0, 0.0));
                self.room(rng, &map_from_room, length_m, inwards * depth_m);
            }
        }
    }

    /// A wall with a door in it, and a partition to the next room; `depth_m` is negative for a
    /// room on the right.
    fn room(&mut self, rng: &mut ChaCha8Rng, map_from_room: &Pose2, length_m: f64, depth_m: f64) {
        let door_m = rng.random_range(0.6..length_m - DOOR_M - 0.6);
        let at = |x: f64, y: f64, theta: f64| map_from_room.compose(&Pose2::new(x, y, theta));
        let after_m = door_m + DOOR_M;
        let partition = at(0.0, 0.5 * depth_m, FRAC_PI_2);
        let walls = [
            (at(0.5 * door_m, 0.0, 0.0), door_m),
            (at(0.5 * (after_m + length_m), 0.0, 0.0), length_m - after_m),
            (partition, depth_m.abs()),
        ];
        for (middle, length_m) in walls {
            let wall = Shape::rectangle(&middle, length_m, WALL_M);
            self.scene.objects.push(SceneObject::lasting(wall));
        }
        // Seen from the hinge, the room lies on the left.
        let hinge = if depth_m > 0.0 {
            at(door_m, 0.0, 0.0)
        } else {
            at(after_m, 0.0, PI)
        };
        let door = Door {
            hinge,
            object: self.scene.objects.len(),
            open: rng.random_bool(OPEN_RATE),
        };
        let shape = door.shape();
        self.scene.objects.push(SceneObject::lasting(shape));
        self.doors.push(door);
    }

    /// A cupboard in every room, in sight of its door, and a few things in the corridor.
    fn furnish(&mut self, rng: &mut ChaCha8Rng, plan: &FloorPlan) {
        for door in &self.doors {
            let (x, y) = (0.5 * DOOR_M + rng.random_range(-0.3..0.3), 1.9);
            let middle = door.hinge.compose(&Pose2::new(x, y, 0.0));
            let (length_m, width_m) = (rng.random_range(0.5..1.2), rng.random_range(0.4..0.6));
            let cupboard = Shape::rectangle(&middle, length_m, width_m);
            self.scene.objects.push(SceneObject::lasting(cupboard));
        }
        let seed = rng.random();
        let things = (plan.way_m() / CORRIDOR_PER_THING_M).round() as usize;
        Changes::new(&mut self.scene, 0, 0.25 * plan.corridor_m, seed).add(things, 0.3);
    }

    /// What stands in the lower half stands in the upper one too, turned by half about the middle;
    /// what was there goes.
    fn make_symmetric(&mut self, plan: &FloorPlan) {
        self.doors.clear();
        let outside = self.scene.objects.remove(0);
        let middle_y_m = 0.5 * plan.width_m;
        let is_below = |object: &SceneObject| object.shape.bounding_circle().0.y < middle_y_m;
        self.scene.objects.retain(is_below);
        let turned_by_half = Pose2::new(plan.length_m, plan.width_m, PI);
        let above: Vec<SceneObject> = (self.scene.objects.iter())
            .map(|object| SceneObject::lasting(object.shape.moved(&turned_by_half)))
            .collect();
        self.scene.objects.extend(above);
        self.scene.objects.insert(0, outside);
    }
}

impl Door {
    fn shape(&self) -> Shape {
        self.shape_ajar(0.0)
    }

    /// Turned from where it stands towards its other place.
    fn shape_ajar(&self, by_rad: f64) -> Shape {
        let turn_rad = if self.open {
            FRAC_PI_2 - by_rad
        } else {
            by_rad
        };
        let middle = Pose2::new(0.5 * DOOR_M, 0.0, 0.0);
        let map_from_leaf = self.hinge.compose(&Pose2::new(0.0, 0.0, turn_rad));
        Shape::rectangle(
            &map_from_leaf.compose(&middle),
            DOOR_M + 2.0 * DOOR_STOP_M,
            DOOR_THICKNESS_M,
        )
    }
}
