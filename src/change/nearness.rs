//! Distances to a set of points.

use crate::geometry::Vector2;

/// Points indexed for tests of whether a place is near to one of them.
pub struct Nearness {
    /// Ascending by x.
    points: Vec<Vector2<f64>>,
}

impl Nearness {
    /// To some points, map frame, metres.
    pub fn to(points: &[Vector2<f64>]) -> Self {
        let mut points = points.to_vec();
        points.sort_by(|a, b| a.x.total_cmp(&b.x));
        Self { points }
    }

    /// Whether a place is within a distance of one of the points.
    pub fn holds(&self, place: &Vector2<f64>, within_m: f64) -> bool {
        let first = self.points.partition_point(|p| p.x < place.x - within_m);
        let near = self.points[first..].iter();
        let mut near = near.take_while(|p| p.x <= place.x + within_m);
        near.any(|p| (p - place).norm_squared() <= within_m * within_m)
    }

    /// A circle that holds everything within a distance of the points: middle, radius in metres.
    pub fn circle(&self, within_m: f64) -> (Vector2<f64>, f64) {
        let (low, high) = self.bounds();
        let half = 0.5 * (high - low);
        (low + half, half.norm() + within_m)
    }

    /// The corners of the box round the points.
    pub fn bounds(&self) -> (Vector2<f64>, Vector2<f64>) {
        let unbounded = Vector2::repeat(f64::INFINITY);
        let low = self.points.iter().fold(unbounded, |low, p| low.inf(p));
        let high = self.points.iter().fold(-unbounded, |high, p| high.sup(p));
        (low, high)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn point() -> impl Strategy<Value = Vector2<f64>> {
        (-3.0..3.0_f64, -3.0..3.0_f64).prop_map(|(x, y)| Vector2::new(x, y))
    }

    proptest! {
        #[test]
        fn holds_what_is_near(
            points in proptest::collection::vec(point(), 1..40),
            place in point(),
            within_m in 0.1..4.0_f64,
        ) {
            let nearness = Nearness::to(&points);
            let least = points.iter().map(|p| (p - place).norm()).fold(f64::INFINITY, f64::min);
            if (least - within_m).abs() > 1e-9 {
                prop_assert_eq!(nearness.holds(&place, within_m), least < within_m);
            }
            let (middle, radius_m) = nearness.circle(0.5);
            prop_assert!(points.iter().all(|p| (p - middle).norm() + 0.5 <= radius_m + 1e-9));
        }
    }
}
