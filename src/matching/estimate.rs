//! What a match says.

use nalgebra::SymmetricEigen;

use crate::geometry::{Information, Matrix3, Pose2, Vector3};
use crate::scan::SurfacePoint;

/// Why an alignment ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Termination {
    /// The last step was below the tolerance.
    Converged,
    /// The iterations ran out.
    IterationLimit,
    /// Too few points had a counterpart.
    TooFewPoints,
}

/// The result of an alignment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate {
    /// `reference_from_base`.
    pub pose: Pose2,
    /// Of the pose, for errors in the base frame (the error of an edge reference → base); zero
    /// along directions that the points do not fix.
    pub information: Information,
    /// How many of the three directions of motion the points fix.
    pub observable_directions: usize,
    /// Share of the scan's points with a counterpart within [`super::IcpParams::overlap_gate_m`].
    pub overlap: f64,
    /// Share of those whose distance to the counterpart's line is within
    /// [`super::IcpParams::inlier_gate_m`].
    pub inlier_share: f64,
    /// Root mean square distance of the inliers, metres.
    pub rmse_m: f64,
    /// Why it ended.
    pub termination: Termination,
}

impl Estimate {
    /// The score of the match: the share of the scan's points that it explains.
    pub fn explained_share(&self) -> f64 {
        self.overlap * self.inlier_share
    }
}

/// Smallest eigenvalue, as a share of the number of points, of a direction that counts as fixed.
const OBSERVABLE_SHARE_MIN: f64 = 0.02;
/// Longest and shortest lever arm, metres.
const LEVER_ARM_MAX_M: f64 = 3.0;
const LEVER_ARM_MIN_M: f64 = 0.1;
/// Neighbouring points share the noise of their line; so many count as one.
pub(super) const CORRELATED_POINTS: f64 = 4.0;
/// Errors that more points do not reduce (calibration, motion during the sweep), metres …
const FLOOR_SIGMA_XY_M: f64 = 0.004;
/// … and radians.
const FLOOR_SIGMA_THETA_RAD: f64 = 0.0015;

/// The lever arm that makes a turn comparable with a shift: the root mean square distance of the
/// points from the base, metres.
///
/// With a longer one, the turns that a short-sighted lidar measures well count as not fixed.
pub(super) fn lever_arm_m(points: &[SurfacePoint]) -> f64 {
    let squares_m2: f64 = points.iter().map(|p| p.position.norm_squared()).sum();
    let mean_m2 = squares_m2 / points.len().max(1) as f64;
    mean_m2.sqrt().clamp(LEVER_ARM_MIN_M, LEVER_ARM_MAX_M)
}

/// The directions in which a Hessian holds the pose.
pub(super) struct Observability {
    scaled_eigen: SymmetricEigen<f64, nalgebra::U3>,
    fixed: [bool; 3],
    lever_arm_m: f64,
}

impl Observability {
    /// Of H = Σ w JᵀJ over so many (weighted) points; `lever_arm_m` as from [`lever_arm_m`].
    pub(super) fn new(hessian: &Matrix3<f64>, weight_sum: f64, lever_arm_m: f64) -> Self {
        let d = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, 1.0 / lever_arm_m));
        let scaled_eigen = (d * hessian * d).symmetric_eigen();
        let least = OBSERVABLE_SHARE_MIN * weight_sum;
        let fixed = [0, 1, 2].map(|k| scaled_eigen.eigenvalues[k] > least.max(1e-12));
        Self {
            scaled_eigen,
            fixed,
            lever_arm_m,
        }
    }

    fn scale(&self) -> Vector3<f64> {
        Vector3::new(1.0, 1.0, 1.0 / self.lever_arm_m)
    }

    fn inverse_scale(&self) -> Vector3<f64> {
        Vector3::new(1.0, 1.0, self.lever_arm_m)
    }

    pub(super) fn count(&self) -> usize {
        self.fixed.iter().filter(|&&f| f).count()
    }

    /// The step H⁻¹g within the fixed directions.
    pub(super) fn solve(&self, gradient: &Vector3<f64>) -> Vector3<f64> {
        let d = Matrix3::from_diagonal(&self.scale());
        self.map_eigenvalues(|value| 1.0 / value, &d) * gradient
    }

    /// H within the fixed directions.
    pub(super) fn hessian(&self) -> Matrix3<f64> {
        self.map_eigenvalues(
            |value| value,
            &Matrix3::from_diagonal(&self.inverse_scale()),
        )
    }

    /// The gradient within the fixed directions.
    pub(super) fn fixed_part(&self, gradient: &Vector3<f64>) -> Vector3<f64> {
        let projection = self.map_eigenvalues(|_| 1.0, &Matrix3::identity());
        (projection * gradient.component_mul(&self.scale())).component_mul(&self.inverse_scale())
    }

    /// The information within the fixed directions for a noise of the given variance, m².
    pub(super) fn information(&self, variance_m2: f64) -> Information {
        let inverse_scale = Matrix3::from_diagonal(&self.inverse_scale());
        let floor_theta_m = FLOOR_SIGMA_THETA_RAD * self.lever_arm_m;
        let floor = FLOOR_SIGMA_XY_M.powi(2).max(floor_theta_m.powi(2));
        let to_information = |value: f64| 1.0 / (variance_m2 * CORRELATED_POINTS / value + floor);
        Information::from_matrix(&self.map_eigenvalues(to_information, &inverse_scale))
    }

    fn map_eigenvalues(&self, map: impl Fn(f64) -> f64, outer: &Matrix3<f64>) -> Matrix3<f64> {
        let mut sum = Matrix3::zeros();
        for k in 0..3 {
            if self.fixed[k] {
                let axis = outer * self.scaled_eigen.eigenvectors.column(k);
                sum += axis * axis.transpose() * map(self.scaled_eigen.eigenvalues[k]);
            }
        }
        sum
    }
}
