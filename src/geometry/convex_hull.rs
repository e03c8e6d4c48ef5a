//! The convex hull of some points, and the rectangle round it.

use super::Vector2;

/// The convex hull of some points, counter-clockwise, not closed: Andrew's monotone chain.
pub fn convex_hull(mut points: Vec<Vector2<f64>>) -> Vec<Vector2<f64>> {
    points.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    points.dedup();
    if points.len() < 3 {
        return points;
    }
    let mut hull = half_hull(points.iter());
    hull.pop();
    let mut upper = half_hull(points.iter().rev());
    upper.pop();
    hull.extend(upper);
    hull
}

fn half_hull<'a>(points: impl Iterator<Item = &'a Vector2<f64>>) -> Vec<Vector2<f64>> {
    let mut hull: Vec<Vector2<f64>> = Vec::new();
    for point in points {
        while let [.., before, last] = hull[..] {
            if (last - before).perp(&(point - last)) > 0.0 {
                break;
            }
            hull.pop();
        }
        hull.push(*point);
    }
    hull
}

/// Length and width of the smallest rectangle that holds some points, at whatever angle it lies; `None`
/// without a point. One of its sides lies on a side of the convex hull.
pub fn rectangle_round(points: &[Vector2<f64>]) -> Option<(f64, f64)> {
    let hull = convex_hull(points.to_vec());
    let next = hull.iter().cycle().skip(1);
    let sides = hull.iter().zip(next).map(|(a, b)| {
        let side = b - a;
        let along = side / side.norm().max(f64::MIN_POSITIVE);
        let across = Vector2::new(-along.y, along.x);
        (extent(&hull, &along), extent(&hull, &across))
    });
    let smallest = sides.min_by(|a, b| (a.0 * a.1).total_cmp(&(b.0 * b.1)))?;
    Some((smallest.0.max(smallest.1), smallest.0.min(smallest.1)))
}

/// How far points reach along a direction.
fn extent(points: &[Vector2<f64>], along: &Vector2<f64>) -> f64 {
    let places = || points.iter().map(|point| point.dot(along));
    places().fold(f64::NEG_INFINITY, f64::max) - places().fold(f64::INFINITY, f64::min)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pose2;
    use proptest::prelude::*;

    fn turned(points: &[Vector2<f64>], angle_rad: f64) -> Vec<Vector2<f64>> {
        let turn = Pose2::new(0.3, -2.0, angle_rad).to_transform();
        points.iter().map(|point| turn.apply(point)).collect()
    }

    #[test]
    fn a_rectangle_is_its_own() {
        let corners = [[0.0, 0.0], [0.9, 0.0], [0.9, 0.4], [0.0, 0.4], [0.5, 0.2]];
        let corners = corners.map(Vector2::from);
        for k in 0..20 {
            let (length, width) = rectangle_round(&turned(&corners, 0.37 * f64::from(k))).unwrap();
            assert!((length - 0.9).abs() < 1e-9 && (width - 0.4).abs() < 1e-9);
        }
    }

    #[test]
    fn points_and_segments_have_no_area() {
        assert_eq!(rectangle_round(&[]), None);
        let point = Vector2::new(1.0, 2.0);
        assert_eq!(rectangle_round(&[point]), Some((0.0, 0.0)));
        let (length, width) = rectangle_round(&[point, Vector2::new(4.0, 6.0)]).unwrap();
        assert!((length - 5.0).abs() < 1e-12 && width < 1e-12);
    }

    proptest! {
        /// Against rectangles at every angle of a fine grid.
        #[test]
        fn no_rectangle_is_smaller(
            points in prop::collection::vec((-3.0..3.0_f64, -3.0..3.0_f64), 3..20),
        ) {
            let points: Vec<_> = points.into_iter().map(|(x, y)| Vector2::new(x, y)).collect();
            let (length, width) = rectangle_round(&points).unwrap();
            prop_assert!(length >= width);
            let areas = (0..3_600).map(|k| {
                let (sin, cos) = (f64::from(k) * std::f64::consts::FRAC_PI_2 / 3_600.0).sin_cos();
                let (along, across) = (Vector2::new(cos, sin), Vector2::new(-sin, cos));
                extent(&points, &along) * extent(&points, &across)
            });
            let least = areas.fold(f64::INFINITY, f64::min);
            prop_assert!(length * width <= least + 1e-9, "{length} × {width} against {least}");
            prop_assert!(length * width >= least - 0.1, "{length} × {width} against {least}");
        }
    }
}
