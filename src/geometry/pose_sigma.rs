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

impl PoseSigma {
    /// The square roots of the diagonal of a covariance of (x, y, θ), in m and rad, to two
    /// significant digits: that is all that is known of them, and what a far-off closure changes of
    /// one is then no news. `None` if they are no finite numbers.
    pub fn from_covariance(covariance: &Matrix3<f64>) -> Option<Self> {
        let [x_m, y_m, theta_rad] = [0, 1, 2].map(|k| to_two_digits(covariance[(k, k)].sqrt()));
        let is_finite = [x_m, y_m, theta_rad].iter().all(|sigma| sigma.is_finite());
        is_finite.then_some(Self {
            x_m,
            y_m,
            theta_rad,
        })
    }
}

fn to_two_digits(sigma: f64) -> f64 {
    if sigma == 0.0 {
        return 0.0;
    }
    let per_unit = 10.0_f64.powi(1 - sigma.log10().floor() as i32);
    (sigma * per_unit).round() / per_unit
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
        let tenth = 0.01234_f64.powi(2);
        let digits = of([tenth, 100.0 * tenth, 1e-8 * tenth]).unwrap();
        assert_eq!(
            [digits.x_m, digits.y_m, digits.theta_rad],
            [0.012, 0.12, 1.2e-6]
        );
        assert_eq!(of([f64::INFINITY, 0.0, 1.0]), None);
        assert_eq!(of([0.04, -1e-30, 1.0]), None);
    }
}
