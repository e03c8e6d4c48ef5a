//! The line through points that come and go.

use crate::geometry::Vector2;

/// A line needs this many points.
const POINTS_MIN: usize = 3;
/// Largest ratio of the scatter across a line to the scatter along it.
const FLATNESS_MAX: f64 = 0.15;

/// The sums that a line is fitted with.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct LineWindow {
    points: usize,
    sum: Vector2<f64>,
    xx: f64,
    xy: f64,
    yy: f64,
}

impl LineWindow {
    /// Takes in a point; points should lie near the origin.
    pub(super) fn add(&mut self, point: &Vector2<f64>) {
        self.points += 1;
        self.sum += point;
        self.xx += point.x * point.x;
        self.xy += point.x * point.y;
        self.yy += point.y * point.y;
    }

    /// Lets go of a point that was taken in.
    pub(super) fn remove(&mut self, point: &Vector2<f64>) {
        self.points -= 1;
        self.sum -= point;
        self.xx -= point.x * point.x;
        self.xy -= point.x * point.y;
        self.yy -= point.y * point.y;
    }

    /// The line's unit normal, of either sign; `None` if there are too few points or no line.
    pub(super) fn normal(&self) -> Option<Vector2<f64>> {
        if self.points < POINTS_MIN {
            return None;
        }
        let per_point = 1.0 / self.points as f64;
        let xx = self.xx - self.sum.x * self.sum.x * per_point;
        let xy = self.xy - self.sum.x * self.sum.y * per_point;
        let yy = self.yy - self.sum.y * self.sum.y * per_point;
        let (half_sum, half_difference) = (0.5 * (xx + yy), 0.5 * (xx - yy));
        let radius = (half_difference * half_difference + xy * xy).sqrt();
        let (across, along) = (half_sum - radius, half_sum + radius);
        if radius <= 0.0 || across > FLATNESS_MAX * FLATNESS_MAX * along {
            return None;
        }
        // The axis of largest scatter lies at half the angle of (half_difference, xy); the larger
        // of its two coordinates is the one to take a root for.
        let per_radius = 1.0 / radius;
        let larger = (0.5 + 0.5 * half_difference.abs() * per_radius).sqrt();
        let smaller = 0.5 * xy * per_radius / larger;
        Some(if half_difference >= 0.0 {
            Vector2::new(-smaller, larger)
        } else {
            Vector2::new(-larger, smaller)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Matrix2;
    use proptest::prelude::*;

    fn points() -> impl Strategy<Value = Vec<Vector2<f64>>> {
        let point = (-3.0..3.0_f64, -0.2..0.2_f64);
        proptest::collection::vec(point.prop_map(|(x, y)| Vector2::new(x, y)), 3..40)
    }

    fn scatter(points: &[Vector2<f64>]) -> Matrix2<f64> {
        let mean = points.iter().sum::<Vector2<f64>>() / points.len() as f64;
        let about_mean = points.iter().map(|p| (p - mean) * (p - mean).transpose());
        about_mean.sum()
    }

    proptest! {
        #[test]
        fn the_normal_is_the_eigenvector_of_the_least_scatter(points in points(), turn in -4.0..4.0_f64) {
            let turn = nalgebra::Rotation2::new(turn);
            let points: Vec<_> = points.iter().map(|p| turn * p).collect();
            let mut window = LineWindow::default();
            for point in &points {
                window.add(point);
            }
            let scatter = scatter(&points);
            let eigen = scatter.symmetric_eigen();
            let flat = eigen.eigenvalues.min() <= FLATNESS_MAX.powi(2) * eigen.eigenvalues.max();
            prop_assert_eq!(window.normal().is_some(), flat);
            if let Some(normal) = window.normal() {
                prop_assert!((normal.norm() - 1.0).abs() < 1e-12);
                let least = eigen.eigenvectors.column(eigen.eigenvalues.imin());
                prop_assert!(normal.perp(&least.into_owned()).abs() < 1e-9);
            }
        }

        #[test]
        fn what_left_counts_no_more(points in points(), others in points()) {
            let mut window = LineWindow::default();
            for point in others.iter().chain(&points) {
                window.add(point);
            }
            for other in &others {
                window.remove(other);
            }
            let mut alone = LineWindow::default();
            for point in &points {
                alone.add(point);
            }
            match (window.normal(), alone.normal()) {
                (Some(a), Some(b)) => prop_assert!((a - b).norm() < 1e-9),
                (a, b) => prop_assert_eq!(a.is_some(), b.is_some()),
            }
        }
    }

    #[test]
    fn one_spot_is_no_line() {
        let mut window = LineWindow::default();
        for _ in 0..5 {
            window.add(&Vector2::new(1.0, 2.0));
        }
        assert_eq!(window.normal(), None);
    }
}
