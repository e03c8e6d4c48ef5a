//! How far points and regions are from solid shapes.

use crate::geometry::Vector2;
use crate::sim::Shape;

/// Points along a region's sides are looked at this far apart, metres.
const STEP_M: f64 = 0.05;

/// How far a point is from a solid shape, metres: 0 within.
fn distance_m(shape: &Shape, point: &Vector2<f64>) -> f64 {
    if shape.contains(point) {
        0.0
    } else {
        shape.distance_to(point)
    }
}

/// How far a region (a simple polygon) is from a solid shape, metres, to the centimetre.
pub fn region_distance_m(shape: &Shape, region: &[Vector2<f64>]) -> f64 {
    let middle = shape.bounding_circle().0;
    if contains(region, &middle) {
        return 0.0;
    }
    let sides = region.iter().zip(region.iter().cycle().skip(1));
    let points = sides.flat_map(|(from, to)| {
        let steps = ((to - from).norm() / STEP_M).ceil().max(1.0) as usize;
        let at = move |k: usize| from + (to - from) * (k as f64 / steps as f64);
        (0..steps).map(at)
    });
    points
        .map(|point| distance_m(shape, &point))
        .fold(f64::INFINITY, f64::min)
}

/// Whether a ray to the right crosses the outline an odd number of times.
fn contains(corners: &[Vector2<f64>], point: &Vector2<f64>) -> bool {
    let sides = corners.iter().zip(corners.iter().cycle().skip(1));
    let crossings = sides.filter(|(a, b)| {
        let spans = (a.y > point.y) != (b.y > point.y);
        spans && point.x < a.x + (point.y - a.y) / (b.y - a.y) * (b.x - a.x)
    });
    crossings.count() % 2 == 1
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pose2;

    #[test]
    fn within_is_no_distance() {
        let rack = Shape::rectangle(&Pose2::new(2.0, 1.0, 0.7), 3.0, 0.5);
        assert_eq!(distance_m(&rack, &Vector2::new(2.0, 1.0)), 0.0);
        let column = Shape::Round {
            centre: Vector2::new(0.0, 0.0),
            radius_m: 0.5,
        };
        assert_eq!(distance_m(&column, &Vector2::new(0.1, 0.1)), 0.0);
        assert!((distance_m(&column, &Vector2::new(2.0, 0.0)) - 1.5).abs() < 1e-12);
    }

    #[test]
    fn regions_beside_over_and_within() {
        let square = Shape::rectangle(&Pose2::IDENTITY, 2.0, 2.0);
        let box_at = |x: f64, half: f64| {
            [(-half, -half), (half, -half), (half, half), (-half, half)]
                .map(|(a, b)| Vector2::new(x + a, b))
        };
        assert!((region_distance_m(&square, &box_at(3.0, 0.5)) - 1.5).abs() < 0.01);
        assert_eq!(region_distance_m(&square, &box_at(1.0, 0.5)), 0.0);
        assert_eq!(region_distance_m(&square, &box_at(0.3, 0.1)), 0.0);
        assert_eq!(region_distance_m(&square, &box_at(0.0, 5.0)), 0.0);
        assert!(region_distance_m(&square, &[]).is_infinite());
    }
}
