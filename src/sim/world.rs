//! A world of shapes, and the rays through it.

use super::Shape;
use crate::geometry::Vector2;

/// Everything that a lidar can see.
#[derive(Debug, Clone, PartialEq)]
pub struct World {
    shapes: Vec<Bounded>,
}

#[derive(Debug, Clone, PartialEq)]
struct Bounded {
    shape: Shape,
    centre: Vector2<f64>,
    reach_m: f64,
}

/// Where a ray ended.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hit {
    /// Its range, metres.
    pub range_m: f64,
    /// The shape that it hit, by its index in [`World::shapes`].
    pub shape: usize,
}

impl World {
    /// A world of these shapes.
    pub fn new(shapes: impl IntoIterator<Item = Shape>) -> Self {
        let bounded = shapes.into_iter().map(|shape| {
            let (centre, reach_m) = shape.bounding_circle();
            Bounded {
                shape,
                centre,
                reach_m,
            }
        });
        Self {
            shapes: bounded.collect(),
        }
    }

    /// The shapes, in the order in which they were given.
    pub fn shapes(&self) -> impl ExactSizeIterator<Item = &Shape> {
        self.shapes.iter().map(|b| &b.shape)
    }

    /// The first hit of a ray; `direction` is a unit vector. Cost: shapes.
    pub fn cast(&self, origin: &Vector2<f64>, direction: &Vector2<f64>) -> Option<Hit> {
        let mut nearest: Option<Hit> = None;
        for (k, bounded) in self.shapes.iter().enumerate() {
            let limit_m = nearest.map_or(f64::INFINITY, |hit| hit.range_m);
            if !bounded.may_be_met(origin, direction, limit_m) {
                continue;
            }
            if let Some(range_m) = bounded.shape.distance_along(origin, direction)
                && range_m < limit_m
            {
                nearest = Some(Hit { range_m, shape: k });
            }
        }
        nearest
    }
}

impl Bounded {
    fn may_be_met(&self, origin: &Vector2<f64>, direction: &Vector2<f64>, limit_m: f64) -> bool {
        // A little more than the circle: a corner may lie on it.
        let reach_m = self.reach_m * (1.0 + 1e-9);
        let to_centre = self.centre - origin;
        let along = to_centre.dot(direction);
        let across = direction.x * to_centre.y - direction.y * to_centre.x;
        across.abs() <= reach_m && along >= -reach_m && along - reach_m <= limit_m
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pose2;
    use proptest::prelude::*;
    use std::f64::consts::{PI, TAU};

    fn shape() -> impl Strategy<Value = Shape> {
        let place = (-8.0..8.0_f64, -8.0..8.0_f64, -PI..PI);
        prop_oneof![
            (place.clone(), 0.1..3.0_f64, 0.1..3.0_f64)
                .prop_map(|((x, y, t), l, w)| Shape::rectangle(&Pose2::new(x, y, t), l, w)),
            (place, 0.1..1.0_f64).prop_map(|((x, y, _), radius_m)| Shape::Round {
                centre: Vector2::new(x, y),
                radius_m
            }),
        ]
    }

    proptest! {
        #[test]
        fn bounds_change_nothing(
            shapes in prop::collection::vec(shape(), 0..12),
            x in -9.0..9.0_f64, y in -9.0..9.0_f64, angle in 0.0..TAU,
        ) {
            let world = World::new(shapes.clone());
            let (origin, direction) = (Vector2::new(x, y), Vector2::new(angle.cos(), angle.sin()));
            let all = shapes.iter().map(|s| s.distance_along(&origin, &direction));
            let nearest = all.flatten().min_by(f64::total_cmp);
            let hit = world.cast(&origin, &direction);
            prop_assert_eq!(hit.map(|h| h.range_m), nearest);
            if let Some(hit) = hit {
                let own = shapes[hit.shape].distance_along(&origin, &direction);
                prop_assert_eq!(own, Some(hit.range_m));
            }
        }
    }
}
