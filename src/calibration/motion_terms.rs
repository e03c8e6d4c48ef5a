//! The motions of a trip as terms of a robust sum of squares.

use nalgebra::{SMatrix, SVector};

use super::motion_model::{Jacobian, UNKNOWNS, error_with_jacobian};
use super::{Corrections, Motions, ScanMotion};
use crate::geometry::{Matrix3, Vector3};

/// A motion whose error is so many standard deviations long counts half (Cauchy).
const CAUCHY_SCALE: f64 = 3.0;
/// The noise of wheels is at least this: metres, metres, radians.
const NOISE_MIN: [f64; 3] = [0.002, 0.002, 0.001];
/// The median of χ² with three degrees of freedom.
const CHI_SQUARED_MEDIAN: f64 = 2.366;
/// Errors are hardly ever so much smaller than the weights say.
const DISPERSION_MIN: f64 = 0.05;
/// A standard deviation from a median of absolute values.
const SIGMA_PER_MEDIAN: f64 = 1.4826;
/// What is usual between wheels and scans, as standard deviations: metres, and a share of the way …
const USUAL_XY: (f64, f64) = (0.01, 0.02);
/// … and radians, a share of the turn and radians a metre.
const USUAL_THETA: (f64, f64, f64) = (0.006, 0.03, 0.005);

pub(super) type Hessian = SMatrix<f64, UNKNOWNS, UNKNOWNS>;
pub(super) type Unknowns = SVector<f64, UNKNOWNS>;

/// (Ω⁻¹ + Q)⁻¹ for each motion, times a number that makes the errors as long as such weights want
/// them.
pub(super) fn weights(
    motions: &Motions,
    noise: &[f64; 3],
    corrections: &Corrections,
) -> Vec<Matrix3<f64>> {
    let noise = Matrix3::from_diagonal(&Vector3::from(noise.map(|sigma| sigma * sigma)));
    let of_motion = |m: &ScanMotion| weight(m, &noise);
    let weights: Vec<_> = motions.by_scans().iter().map(of_motion).collect();
    let dispersion = dispersion(motions, &weights, corrections).max(DISPERSION_MIN);
    weights
        .into_iter()
        .map(|weight| weight / dispersion)
        .collect()
}

/// The median square of the errors' lengths by these weights, as a multiple of what it is where
/// they have the variances that the weights say.
fn dispersion(motions: &Motions, weights: &[Matrix3<f64>], corrections: &Corrections) -> f64 {
    let lengths2 = terms(motions, weights, corrections)
        .map(|term| term.error.dot(&(term.weight * term.error)))
        .collect();
    median(lengths2) / CHI_SQUARED_MEDIAN
}

/// Without inverting Ω, which may be singular.
fn weight(motion: &ScanMotion, noise: &Matrix3<f64>) -> Matrix3<f64> {
    let information = motion.information.matrix();
    let inverse = (Matrix3::identity() + noise * information).try_inverse();
    inverse.map_or(Matrix3::zeros(), |inverse| information * inverse)
}

/// A motion's error, its derivatives, its weight matrix and Cauchy's square u² of its length.
pub(super) struct Term {
    error: Vector3<f64>,
    jacobian: Jacobian,
    weight: Matrix3<f64>,
    length2: f64,
}

pub(super) fn terms<'a>(
    motions: &'a Motions,
    weights: &'a [Matrix3<f64>],
    corrections: &'a Corrections,
) -> impl Iterator<Item = Term> + 'a {
    motions
        .by_scans()
        .iter()
        .zip(weights)
        .filter_map(|(motion, weight)| {
            let (error, jacobian) = error_with_jacobian(motions, motion, corrections)?;
            Some(Term {
                error,
                jacobian,
                weight: *weight,
                length2: error.dot(&(weight * error)) / (CAUCHY_SCALE * CAUCHY_SCALE),
            })
        })
}

impl Term {
    pub fn gradient(&self) -> Unknowns {
        self.jacobian.transpose() * (self.weight * self.error) / (1.0 + self.length2)
    }

    /// With a share of its weight.
    pub fn hessian(&self, share: f64) -> Hessian {
        self.jacobian.transpose() * self.weight * self.jacobian * (share / (1.0 + self.length2))
    }

    /// By how much the curvature of Cauchy's loss is less than its weight, over the directions of
    /// an error.
    pub fn curvature_share(&self) -> f64 {
        1.0 - 2.0 / 3.0 * self.length2 / (1.0 + self.length2)
    }
}

/// Robust standard deviations of what is left of the motions that scans fix, by component.
pub(super) fn noise_left(motions: &Motions, corrections: &Corrections) -> [f64; 3] {
    let unit = vec![Matrix3::identity(); motions.by_scans().len()];
    let left: Vec<Vector3<f64>> = terms(motions, &unit, corrections)
        .map(|t| t.error)
        .collect();
    [0, 1, 2].map(|k| {
        let sizes = left.iter().map(|error| error[k].abs()).collect();
        (SIGMA_PER_MEDIAN * median(sizes)).max(NOISE_MIN[k])
    })
}

/// The median length of what is left, in units of its median for usual wheels and matches.
pub(super) fn excess(motions: &Motions, corrections: &Corrections) -> f64 {
    let usual = |motion: &ScanMotion| {
        let way_m = motion.motion.translation().norm();
        let xy_m = USUAL_XY.0 + USUAL_XY.1 * way_m;
        let turn_rad = motion.motion.theta.abs();
        let theta_rad = USUAL_THETA.0 + USUAL_THETA.1 * turn_rad + USUAL_THETA.2 * way_m;
        let variances = Vector3::new(xy_m * xy_m, xy_m * xy_m, theta_rad * theta_rad);
        weight(motion, &Matrix3::from_diagonal(&variances))
    };
    let weights: Vec<Matrix3<f64>> = motions.by_scans().iter().map(usual).collect();
    dispersion(motions, &weights, corrections).sqrt()
}

/// The upper median; 0 of nothing.
pub(crate) fn median(mut values: Vec<f64>) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}
