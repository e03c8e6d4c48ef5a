//! Obstacles as a horizontal cut shows them: outlines and round columns.

use std::f64::consts::PI;

use crate::geometry::{Pose2, Vector2};

/// Neighbouring sides overlap by this share of their length, so that no ray slips between them.
const SIDE_OVERLAP: f64 = 1e-12;

/// An obstacle, metres, map frame.
#[derive(Debug, Clone, PartialEq)]
pub enum Shape {
    /// A closed line through the corners: walls of a room, or a solid box.
    Outline(Vec<Vector2<f64>>),
    /// A circle.
    Round {
        /// Its middle.
        centre: Vector2<f64>,
        /// Its radius.
        radius_m: f64,
    },
}

impl Shape {
    /// A rectangle whose middle lies at `map_from_box`.
    pub fn rectangle(map_from_box: &Pose2, length_m: f64, width_m: f64) -> Self {
        let (x, y) = (0.5 * length_m, 0.5 * width_m);
        let corners = [(x, y), (-x, y), (-x, -y), (x, -y)];
        let corners = corners.map(|(x, y)| map_from_box.transform(&Vector2::new(x, y)));
        Self::Outline(corners.into())
    }

    /// The range at which a ray hits the shape, metres; `direction` is a unit vector.
    pub fn distance_along(&self, origin: &Vector2<f64>, direction: &Vector2<f64>) -> Option<f64> {
        match self {
            Self::Outline(corners) => sides(corners)
                .filter_map(|(a, b)| along_to_side(origin, direction, a, b))
                .min_by(f64::total_cmp),
            Self::Round { centre, radius_m } => {
                along_to_circle(origin, direction, centre, *radius_m)
            }
        }
    }

    /// Every distance at which a ray crosses the shape's line, metres, ascending; `direction` is a
    /// unit vector. Odd in number if it begins inside.
    pub(super) fn crossings(&self, origin: &Vector2<f64>, direction: &Vector2<f64>) -> Vec<f64> {
        let mut crossings: Vec<f64> = match self {
            Self::Outline(corners) => sides(corners)
                .filter_map(|(a, b)| along_to_side(origin, direction, a, b))
                .collect(),
            Self::Round { centre, radius_m } => {
                let first = along_to_circle(origin, direction, centre, *radius_m);
                let ahead = (centre - origin).dot(direction);
                let last = first.map(|first| 2.0 * ahead - first);
                let beyond = last.filter(|last| first.is_some_and(|first| *last > first));
                first.into_iter().chain(beyond).collect()
            }
        };
        crossings.sort_by(f64::total_cmp);
        crossings
    }

    /// The distance of a point from the shape's outline, metres.
    pub fn distance_to(&self, point: &Vector2<f64>) -> f64 {
        match self {
            Self::Outline(corners) => sides(corners)
                .map(|(a, b)| point_to_side(point, a, b))
                .fold(f64::INFINITY, f64::min),
            Self::Round { centre, radius_m } => ((point - centre).norm() - radius_m).abs(),
        }
    }

    /// Whether a point is within the shape's outline.
    pub fn contains(&self, point: &Vector2<f64>) -> bool {
        match self {
            Self::Outline(corners) => {
                // Even-odd rule: how many sides a ray to the right crosses.
                let crossed = sides(corners).filter(|(a, b)| {
                    let share = (point.y - a.y) / (b.y - a.y);
                    (a.y > point.y) != (b.y > point.y) && point.x < a.x + share * (b.x - a.x)
                });
                crossed.count() % 2 == 1
            }
            Self::Round { centre, radius_m } => (point - centre).norm() < *radius_m,
        }
    }

    /// Its area, square metres; for an outline that does not cross itself.
    pub fn area_m2(&self) -> f64 {
        match self {
            Self::Outline(corners) => {
                let twice: f64 = sides(corners).map(|(a, b)| cross(a, b)).sum();
                0.5 * twice.abs()
            }
            Self::Round { radius_m, .. } => PI * radius_m * radius_m,
        }
    }

    /// The same shape elsewhere: every point p becomes `motion` · p.
    pub fn moved(&self, motion: &Pose2) -> Self {
        match self {
            Self::Outline(corners) => {
                Self::Outline(corners.iter().map(|c| motion.transform(c)).collect())
            }
            Self::Round { centre, radius_m } => Self::Round {
                centre: motion.transform(centre),
                radius_m: *radius_m,
            },
        }
    }

    /// A circle that holds the shape: its middle and radius.
    pub fn bounding_circle(&self) -> (Vector2<f64>, f64) {
        match self {
            Self::Outline(corners) => {
                let middle = corners.iter().sum::<Vector2<f64>>() / corners.len().max(1) as f64;
                let reach = corners.iter().map(|c| (c - middle).norm());
                (middle, reach.fold(0.0, f64::max))
            }
            Self::Round { centre, radius_m } => (*centre, *radius_m),
        }
    }
}

fn sides(corners: &[Vector2<f64>]) -> impl Iterator<Item = (&Vector2<f64>, &Vector2<f64>)> {
    corners.iter().zip(corners.iter().cycle().skip(1))
}

fn cross(a: &Vector2<f64>, b: &Vector2<f64>) -> f64 {
    a.x * b.y - a.y * b.x
}

fn along_to_side(
    origin: &Vector2<f64>,
    direction: &Vector2<f64>,
    a: &Vector2<f64>,
    b: &Vector2<f64>,
) -> Option<f64> {
    let side = b - a;
    let determinant = cross(direction, &side);
    if determinant == 0.0 {
        return None;
    }
    let to_a = a - origin;
    let distance = cross(&to_a, &side) / determinant;
    let share = cross(&to_a, direction) / determinant;
    let met = distance > 0.0 && (-SIDE_OVERLAP..=1.0 + SIDE_OVERLAP).contains(&share);
    met.then_some(distance)
}

fn along_to_circle(
    origin: &Vector2<f64>,
    direction: &Vector2<f64>,
    centre: &Vector2<f64>,
    radius_m: f64,
) -> Option<f64> {
    let to_centre = centre - origin;
    let nearest = to_centre.dot(direction);
    let offset = cross(direction, &to_centre);
    let half_chord_squared = radius_m * radius_m - offset * offset;
    if half_chord_squared < 0.0 {
        return None;
    }
    let half_chord = half_chord_squared.sqrt();
    let entry = nearest - half_chord;
    let exit = nearest + half_chord;
    if entry > 0.0 {
        Some(entry)
    } else {
        (exit > 0.0).then_some(exit)
    }
}

fn point_to_side(point: &Vector2<f64>, a: &Vector2<f64>, b: &Vector2<f64>) -> f64 {
    let side = b - a;
    let length_squared = side.norm_squared();
    let share = if length_squared > 0.0 {
        ((point - a).dot(&side) / length_squared).clamp(0.0, 1.0)
    } else {
        0.0
    };
    (point - (a + side * share)).norm()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::f64::consts::TAU;

    fn unit(angle_rad: f64) -> Vector2<f64> {
        Vector2::new(angle_rad.cos(), angle_rad.sin())
    }

    /// The first crossing found by walking along the ray and bisecting where a point changes
    /// sides.
    fn by_walking(
        inside: impl Fn(&Vector2<f64>) -> bool,
        origin: &Vector2<f64>,
        direction: &Vector2<f64>,
    ) -> Option<f64> {
        let at = |t: f64| inside(&(origin + direction * t));
        let step = 1e-3;
        let first =
            (0..40_000).find(|&k| at(f64::from(k) * step) != at(f64::from(k + 1) * step))?;
        let (mut low, mut high) = (f64::from(first) * step, f64::from(first + 1) * step);
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if at(middle) == at(low) {
                low = middle;
            } else {
                high = middle;
            }
        }
        Some(low)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn rays_meet_boxes_and_columns_where_walking_finds_them(
            x in -6.0..6.0_f64, y in -6.0..6.0_f64, angle in 0.0..TAU, yaw in -PI..PI,
            length in 0.2..4.0_f64, width in 0.2..4.0_f64,
        ) {
            let (origin, direction) = (Vector2::new(x, y), unit(angle));
            let pose = Pose2::new(0.5, -0.25, yaw);
            let in_box = |p: &Vector2<f64>| {
                let local = pose.inverse().transform(p);
                local.x.abs() < 0.5 * length && local.y.abs() < 0.5 * width
            };
            let in_column = |p: &Vector2<f64>| (p - pose.translation()).norm() < length;
            let shapes = [
                (Shape::rectangle(&pose, length, width), by_walking(in_box, &origin, &direction)),
                (
                    Shape::Round { centre: pose.translation(), radius_m: length },
                    by_walking(in_column, &origin, &direction),
                ),
            ];
            for (shape, expected) in shapes {
                match (shape.distance_along(&origin, &direction), expected) {
                    (Some(distance), Some(expected)) => {
                        prop_assert!((distance - expected).abs() < 1e-6, "{distance} {expected}");
                    }
                    // Walking may step over a corner or a rim.
                    (Some(distance), None) => {
                        let (before, after) = (distance - 2e-3, distance + 2e-3);
                        let near = |t: f64| shape.distance_to(&(origin + direction * t)) < 2e-3;
                        prop_assert!(near(before) && near(after), "missed at {distance}");
                    }
                    (None, expected) => prop_assert_eq!(expected, None),
                }
            }
        }

        #[test]
        fn no_ray_leaves_a_closed_room(
            x in -3.9..3.9_f64, y in -2.9..2.9_f64, angle in 0.0..TAU, corner in 0..4_usize,
        ) {
            let room = Shape::rectangle(&Pose2::IDENTITY, 8.0, 6.0);
            let origin = Vector2::new(x, y);
            let (cx, cy) = [(4.0, 3.0), (-4.0, 3.0), (-4.0, -3.0), (4.0, -3.0)][corner];
            let into_corner = (Vector2::new(cx, cy) - origin).normalize();
            for direction in [unit(angle), into_corner] {
                let distance = room.distance_along(&origin, &direction).unwrap();
                let end = origin + direction * distance;
                let on_wall = (end.x.abs() - 4.0).abs() < 1e-9 || (end.y.abs() - 3.0).abs() < 1e-9;
                prop_assert!(on_wall && end.x.abs() < 4.0 + 1e-9 && end.y.abs() < 3.0 + 1e-9);
            }
        }
    }

    proptest! {
        #[test]
        fn a_moved_shape_has_its_points_moved(
            x in -2.0..2.0_f64, y in -2.0..2.0_f64, dx in -5.0..5.0_f64, yaw in -PI..PI,
            length in 0.2..3.0_f64, width in 0.2..3.0_f64,
        ) {
            let motion = Pose2::new(dx, 1.0, yaw);
            let point = Vector2::new(x, y);
            let inside = x.abs() < 0.5 * length && y.abs() < 0.5 * width;
            let round = Shape::Round { centre: Vector2::zeros(), radius_m: 0.5 * length };
            let shapes = [
                (Shape::rectangle(&Pose2::IDENTITY, length, width), inside, length * width),
                (round, point.norm() < 0.5 * length, 0.25 * PI * length * length),
            ];
            for (shape, inside, area) in shapes {
                prop_assert_eq!(shape.contains(&point), inside);
                let moved = shape.moved(&motion);
                prop_assert_eq!(moved.contains(&motion.transform(&point)), inside);
                let gap = moved.distance_to(&motion.transform(&point));
                prop_assert!((gap - shape.distance_to(&point)).abs() < 1e-9);
                prop_assert!((moved.area_m2() - area).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn distances_of_points() {
        let square = Shape::rectangle(&Pose2::IDENTITY, 2.0, 2.0);
        assert!((square.distance_to(&Vector2::new(3.0, 0.0)) - 2.0).abs() < 1e-12);
        assert!((square.distance_to(&Vector2::new(4.0, 5.0)) - 5.0).abs() < 1e-12);
        assert!((square.distance_to(&Vector2::new(0.25, 0.0)) - 0.75).abs() < 1e-12);
        let (middle, reach) = square.bounding_circle();
        assert!(middle.norm() < 1e-12 && (reach - 2.0_f64.sqrt()).abs() < 1e-12);
    }
}
