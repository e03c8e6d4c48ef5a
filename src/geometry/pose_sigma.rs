//! How uncertain a pose is, coordinate by coordinate.

use nalgebra::Matrix3;

/// Standard deviations of a pose's coordinates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseSigma {
    /// Along the x axis of the frame that the pose is in, metres.
    pub x_m: f64,
    /// Along its y axis, metres.
    pub y_m: f64,
    /// Of the heading, radians.
    pub theta_rad: f64,
}

/// Standard deviations are whole multiples of its inverse, metres and radians: what another order of
/// computation changes in the last bits is no news.
const STEPS_PER_UNIT: f64 = 1e6;

impl PoseSigma {
    /// The square roots of the diagonal of a covariance of (x, y, θ), in m and rad, to the nearest
    /// micrometre and microradian; `None` if they are no finite numbers.
    pub fn from_covariance(covariance: &Matrix3<f64>) -> Option<Self> {
        let rounded = |sigma: f64| (sigma * STEPS_PER_UNIT).round() / STEPS_PER_UNIT;
        let [x_m, y_m, theta_rad] = [0, 1, 2].map(|k| rounded(covariance[(k, k)].sqrt()));
        let is_finite = [x_m, y_m, theta_rad].iter().all(|sigma| sigma.is_finite());
        is_finite.then_some(Self {
            x_m,
            y_m,
            theta_rad,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_finite_numbers_are_standard_deviations() {
        let of = |diagonal: [f64; 3]| {
            PoseSigma::from_covariance(&Matrix3::from_diagonal(&diagonal.into()))
        };
        let sigma = PoseSigma {
            x_m: 0.2,
            y_m: 0.0,
            theta_rad: 3.0,
        };
        assert_eq!(of([0.04, 0.0, 9.0 + 1e-9]), Some(sigma));
        assert_eq!(of([f64::INFINITY, 0.0, 1.0]), None);
        assert_eq!(of([0.04, -1e-30, 1.0]), None);
    }
}
