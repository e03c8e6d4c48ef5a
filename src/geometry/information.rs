//! Information matrices of planar motions.

use nalgebra::{Matrix3, Vector3};

/// A symmetric, positive semi-definite 3 × 3 matrix in the order (x, y, θ): the inverse of a
/// covariance. Units: m⁻², m⁻¹rad⁻¹, rad⁻².
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Information(Matrix3<f64>);

impl Information {
    /// Ω = I, as in the paper's statistics (section 4.1).
    pub fn identity() -> Self {
        Self(Matrix3::identity())
    }

    /// Independent coordinates with the given standard deviations (metres, radians).
    pub fn from_sigmas(sigma_xy_m: f64, sigma_theta_rad: f64) -> Self {
        let xy = 1.0 / (sigma_xy_m * sigma_xy_m);
        let theta = 1.0 / (sigma_theta_rad * sigma_theta_rad);
        Self(Matrix3::from_diagonal(&Vector3::new(xy, xy, theta)))
    }

    /// The symmetric part of a matrix.
    pub fn from_matrix(matrix: &Matrix3<f64>) -> Self {
        Self((matrix + matrix.transpose()) * 0.5)
    }

    /// Row by row, upper triangle: (xx, xy, xθ, yy, yθ, θθ), as g2o writes it.
    pub fn from_upper(upper: [f64; 6]) -> Self {
        let [xx, xy, xt, yy, yt, tt] = upper;
        Self(Matrix3::new(xx, xy, xt, xy, yy, yt, xt, yt, tt))
    }

    /// Row by row, upper triangle: (xx, xy, xθ, yy, yθ, θθ).
    pub fn upper(&self) -> [f64; 6] {
        let m = &self.0;
        [
            m[(0, 0)],
            m[(0, 1)],
            m[(0, 2)],
            m[(1, 1)],
            m[(1, 2)],
            m[(2, 2)],
        ]
    }

    /// The full matrix.
    pub fn matrix(&self) -> &Matrix3<f64> {
        &self.0
    }

    /// The same but along a direction, of which only a share in [0, 1] of the standard deviation's
    /// inverse is left.
    pub fn with_share_along(&self, direction: &Vector3<f64>, share: f64) -> Self {
        let across = self.0 * direction;
        let along = direction.dot(&across);
        if along <= 0.0 {
            return *self;
        }
        let taken = across * across.transpose() * ((1.0 - share * share) / along);
        Self::from_matrix(&(self.0 - taken))
    }

    /// What it says along the direction of the plane that it says least of, m⁻².
    pub fn least_xy(&self) -> f64 {
        let xy = self.0.fixed_view::<2, 2>(0, 0).into_owned();
        xy.symmetric_eigenvalues().min()
    }

    /// The same, taken down where it says more: along x and y together to `xy_max` (m⁻²), of the
    /// heading to `theta_max` (rad⁻²).
    pub fn bounded(&self, xy_max: f64, theta_max: f64) -> Self {
        let xy = self.0.fixed_view::<2, 2>(0, 0).into_owned();
        let share = |most: f64, max: f64| (max / most).sqrt().min(1.0);
        let along = share(xy.symmetric_eigenvalues().max(), xy_max);
        let turn = share(self.0[(2, 2)], theta_max);
        let scale = Matrix3::from_diagonal(&Vector3::new(along, along, turn));
        Self::from_matrix(&(scale * self.0 * scale))
    }

    /// eᵀΩe.
    pub fn squared_norm(&self, error: &Vector3<f64>) -> f64 {
        error.dot(&(self.0 * error))
    }

    /// Whether all entries are finite and the smallest eigenvalue is more than `condition_min` of
    /// the largest.
    pub fn is_positive_definite(&self, condition_min: f64) -> bool {
        if !self.0.iter().all(|v| v.is_finite()) {
            return false;
        }
        let eigenvalues = self.0.symmetric_eigenvalues();
        eigenvalues.min() > condition_min * eigenvalues.max().abs()
    }

    /// Whether all entries are finite and no eigenvalue is below −10⁻⁹ of the largest.
    pub fn is_positive_semidefinite(&self) -> bool {
        if !self.0.iter().all(|v| v.is_finite()) {
            return false;
        }
        let eigenvalues = self.0.symmetric_eigenvalues();
        eigenvalues.min() >= -1e-9 * eigenvalues.max().abs().max(f64::MIN_POSITIVE)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn upper_triangle_round_trip() {
        let upper = [4.0, 0.5, -0.25, 3.0, 0.125, 9.0];
        assert_eq!(Information::from_upper(upper).upper(), upper);
    }

    #[test]
    fn semidefinite_is_distinguished_from_indefinite() {
        assert!(Information::from_sigmas(0.1, 0.01).is_positive_semidefinite());
        assert!(Information::from_upper([1.0, 0.0, 0.0, 0.0, 0.0, 1.0]).is_positive_semidefinite());
        assert!(
            !Information::from_upper([1.0, 2.0, 0.0, 1.0, 0.0, 1.0]).is_positive_semidefinite()
        );
        assert!(!Information::from_upper([f64::NAN; 6]).is_positive_semidefinite());
    }

    #[test]
    fn definite_is_distinguished_from_semidefinite() {
        let definite = |upper| Information::from_upper(upper).is_positive_definite(1e-12);
        assert!(definite([4.0, 0.5, -0.25, 3.0, 0.125, 9.0]));
        assert!(definite([1e-6, 0.0, 0.0, 1e-6, 0.0, 1e-6]));
        for flat in [
            [0.0; 6],
            [1.0, 0.0, 0.0, 0.0, 0.0, 1.0],
            [1.0, 1.0, 0.0, 1.0, 0.0, 1.0],
            [-1.0, 0.0, 0.0, -1.0, 0.0, -1.0],
            [f64::INFINITY, 0.0, 0.0, 1.0, 0.0, 1.0],
        ] {
            assert!(!definite(flat), "{flat:?}");
        }
    }

    #[test]
    fn least_of_the_plane_is_along_the_direction_it_says_least_of() {
        assert_eq!(
            Information::from_sigmas(0.1, 1e-3).least_xy().round(),
            100.0
        );
        let direction = nalgebra::Vector3::new(0.6, 0.8, 0.0);
        let loose = Information::from_sigmas(0.1, 1e-3).with_share_along(&direction, 0.1);
        assert!((loose.least_xy() - 1.0).abs() < 1e-9, "{loose:?}");
    }

    #[test]
    fn what_says_too_much_is_taken_down_and_the_rest_stays() {
        let modest = Information::from_upper([400.0, 30.0, 5.0, 900.0, -20.0, 1e4]);
        assert_eq!(modest.bounded(1e6, 1e8), modest);
        let boastful = Information::from_upper([1e12, 3e11, 1e9, 5e11, -2e9, 1e12]);
        let bounded = boastful.bounded(1e6, 1e8);
        let [xx, xy, _, yy, _, tt] = bounded.upper();
        assert!((tt - 1e8).abs() < 1e-3);
        let most = nalgebra::Matrix2::new(xx, xy, xy, yy).symmetric_eigenvalues();
        assert!((most.max() - 1e6).abs() < 1e-3, "{most}");
        assert!(bounded.is_positive_definite(1e-9));
        assert!((xy / xx - 0.3).abs() < 1e-12, "the shape stays");
        let turn_alone = Information::from_upper([400.0, 0.0, 0.0, 400.0, 0.0, 1e10]);
        let [xx, _, _, yy, _, tt] = turn_alone.bounded(1e6, 1e8).upper();
        assert_eq!([xx, yy], [400.0, 400.0]);
        assert!((tt - 1e8).abs() < 1e-3);
    }

    #[test]
    fn a_share_along_a_direction_leaves_the_rest() {
        let information = Information::from_upper([400.0, 30.0, 5.0, 900.0, -20.0, 1e4]);
        let direction = Vector3::new(0.8, -0.6, 0.0);
        let covariance = |information: &Information| information.matrix().try_inverse().unwrap();
        assert_eq!(
            information.with_share_along(&direction, 1.0),
            Information::from_matrix(information.matrix())
        );
        let half = information.with_share_along(&direction, 0.5);
        let along = |information: &Information| information.squared_norm(&direction);
        assert!((along(&half) - 0.25 * along(&information)).abs() < 1e-9);
        assert!(half.is_positive_definite(1e-9));
        // The covariance grows along the direction alone.
        let grown = covariance(&half) - covariance(&information);
        let along_alone = direction * direction.transpose() * grown.trace();
        assert!((grown - along_alone).norm() < 1e-9 * grown.norm());
        let none = information.with_share_along(&direction, 0.0);
        assert!(none.squared_norm(&direction).abs() < 1e-9);
        assert!(none.is_positive_semidefinite());
    }
}
