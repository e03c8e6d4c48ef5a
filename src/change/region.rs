//! The outline of a set of points.

use crate::geometry::{Vector2, convex_hull};

/// Corners of the octagon that is put round each point.
const CORNERS: usize = 8;

/// The convex hull of discs (octagons) round some points, counter-clockwise; empty without points.
pub fn region_round(points: &[Vector2<f64>], margin_m: f64) -> Vec<Vector2<f64>> {
    let turn = std::f64::consts::TAU / CORNERS as f64;
    let corners = (0..CORNERS).map(|k| {
        let (sin, cos) = ((k as f64 + 0.5) * turn).sin_cos();
        Vector2::new(cos, sin) * margin_m
    });
    let corners: Vec<Vector2<f64>> = corners.collect();
    let widened = convex_hull(points.to_vec())
        .into_iter()
        .flat_map(|point| corners.iter().map(move |corner| point + corner));
    convex_hull(widened.collect())
}

/// The centre of a simple polygon's area; the mean of its corners where it has none.
pub fn centroid(polygon: &[Vector2<f64>]) -> Vector2<f64> {
    let origin = polygon.first().copied().unwrap_or_default();
    let (mut area, mut moment) = (0.0, Vector2::zeros());
    for (k, corner) in polygon.iter().enumerate() {
        let a = corner - origin;
        let b = polygon[(k + 1) % polygon.len()] - origin;
        let cross = a.perp(&b);
        area += cross;
        moment += (a + b) * cross;
    }
    if area.abs() < 1e-12 {
        let sum: Vector2<f64> = polygon.iter().sum();
        return sum / polygon.len().max(1) as f64;
    }
    origin + moment / (3.0 * area)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::distance_to_polygon;
    use proptest::prelude::*;

    fn points() -> impl Strategy<Value = Vec<Vector2<f64>>> {
        let point = (-5.0..5.0_f64, -5.0..5.0_f64).prop_map(|(x, y)| Vector2::new(x, y));
        prop::collection::vec(point, 1..40)
    }

    proptest! {
        #[test]
        fn a_region_is_convex_and_holds_its_points(points in points(), margin_m in 0.01..0.5_f64) {
            let region = region_round(&points, margin_m);
            let count = region.len();
            prop_assert!(count >= 3);
            for k in 0..count {
                let (a, b, c) = (region[k], region[(k + 1) % count], region[(k + 2) % count]);
                prop_assert!((b - a).perp(&(c - b)) > 0.0, "not convex and counter-clockwise");
            }
            for point in &points {
                prop_assert!(distance_to_polygon(point, &region) == 0.0);
            }
            let farthest = |corner: &Vector2<f64>| {
                let gaps = points.iter().map(|point| (point - corner).norm());
                gaps.fold(f64::INFINITY, f64::min)
            };
            prop_assert!(region.iter().all(|corner| farthest(corner) <= margin_m + 1e-9));
            prop_assert!(distance_to_polygon(&centroid(&region), &region) == 0.0);
        }

        #[test]
        fn the_order_of_the_points_does_not_matter(points in points()) {
            let backwards: Vec<_> = points.iter().rev().copied().collect();
            prop_assert_eq!(region_round(&points, 0.1), region_round(&backwards, 0.1));
        }
    }

    #[test]
    fn the_centroid_is_the_area_s() {
        let l_shape = [
            (0.0, 0.0),
            (2.0, 0.0),
            (2.0, 1.0),
            (1.0, 1.0),
            (1.0, 2.0),
            (0.0, 2.0),
        ];
        let l_shape = l_shape.map(|(x, y)| Vector2::new(x + 10.0, y - 3.0));
        let centre = centroid(&l_shape);
        let expected = Vector2::new(10.0 + 2.5 / 3.0, -3.0 + 2.5 / 3.0);
        assert!((centre - expected).norm() < 1e-12, "{centre}");
    }

    #[test]
    fn nothing_has_no_region() {
        assert!(region_round(&[], 0.1).is_empty());
    }
}
