//! The errors of a vehicle that its motions show, all at once.

use nalgebra::{SMatrix, SVector};

use super::blocks::{Block, block_count, sigmas};
use super::motion_model::{Jacobian, UNKNOWNS, change_of_speed, error_with_jacobian};
use super::motions::{Motions, OFFSET_MAX_S, ScanMotion};
use super::{Corrections, Estimate, Estimates, Quantity};
use crate::geometry::{Matrix3, Vector3, wrap_angle};

/// Fewest motions that say anything.
const MOTIONS_MIN: usize = 40;
/// The noise of wheels and scans is estimated and the motions weighed anew so many times.
const ROUNDS: usize = 4;
const STEPS_MAX: usize = 12;
/// A motion whose error is so many standard deviations long counts half (Cauchy).
const CAUCHY_SCALE: f64 = 3.0;
/// The noise of wheels is at least this: metres, metres, radians.
const NOISE_MIN: [f64; 3] = [0.002, 0.002, 0.001];
const NOISE_START: [f64; 3] = [0.02, 0.02, 0.02];
/// Steps of the first search for the clock offset, seconds.
const OFFSET_STEP_S: f64 = 0.025;
/// In that search a difference of two turns counts no more than this, radians.
const TURN_DIFFERENCE_MAX_RAD: f64 = 0.1;
/// A clock offset is a start if it leaves no more than this share of the differences.
const OFFSET_LEAVES_MAX: f64 = 0.9;
/// Turns from which on they tell where the lidar sits, and how turns are scaled, radians.
const TURN_SHOWN_RAD: f64 = 0.06;
/// Changes of speed from which on they tell a clock offset, metres a second …
const SPEED_SHOWN_MPS: f64 = 0.1;
/// … and radians a second.
const TURN_RATE_SHOWN_RADPS: f64 = 0.1;
/// So many motions must show a quantity.
const SHOWING_MIN: usize = 8;
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

/// What a trip's motions say.
#[derive(Debug, Clone, PartialEq)]
pub struct MotionFit {
    /// Of mount, wheels and clock. What the drive did not show is not in it: without turns there is
    /// no place of the mount, and without a change of speed or turn no clock offset.
    pub estimates: Estimates,
    /// The values of all unknowns together, known or not: the motions' best fit.
    pub corrections: Corrections,
    /// How many motions there were.
    pub motions: usize,
    /// What is left between wheels and scans for one motion, robust standard deviations: metres
    /// along x and y, radians.
    pub noise: [f64; 3],
    /// Typical length of what is left, as a multiple of what is usual for wheels and matches.
    pub excess: f64,
}

type Hessian = SMatrix<f64, UNKNOWNS, UNKNOWNS>;
type Unknowns = SVector<f64, UNKNOWNS>;

/// Fits mount, wheels and clock to a trip's motions; `None` if there are fewer than forty.
///
/// Nonlinear least squares, iteratively reweighted by Cauchy's weights; the noise of the wheels is
/// estimated along with it. Standard errors are by blocks of the drive.
pub fn fit_motions(motions: &Motions) -> Option<MotionFit> {
    if motions.by_scans().len() < MOTIONS_MIN {
        return None;
    }
    let start = offset_start_s(motions);
    let mut corrections = Corrections::default().with(Quantity::ClockOffset, start);
    let mut noise = NOISE_START;
    for _ in 0..ROUNDS {
        let weights = weights(motions, &noise, &corrections);
        for _ in 0..STEPS_MAX {
            let step = step(motions, &weights, &corrections)?;
            for (quantity, by) in Quantity::ALL.into_iter().zip(step.iter()) {
                corrections.set(
                    quantity,
                    within_reason(quantity, corrections.get(quantity) + by),
                );
            }
            if step.component_div(&prior_sigmas()).norm() < 1e-6 {
                break;
            }
        }
        noise = noise_left(motions, &corrections);
    }
    let sigmas = sigmas_of(
        motions,
        &weights(motions, &noise, &corrections),
        &corrections,
    );
    let known = |(quantity, sigma): (Quantity, &f64)| {
        let estimate = Estimate::known(quantity, corrections.get(quantity), *sigma)?;
        is_shown(motions, quantity, &corrections).then_some((quantity, estimate))
    };
    Some(MotionFit {
        estimates: Quantity::ALL
            .into_iter()
            .zip(sigmas.iter())
            .filter_map(known)
            .collect(),
        corrections,
        motions: motions.by_scans().len(),
        noise,
        excess: excess(motions, &corrections),
    })
}

/// Whether there are enough motions that tell a quantity by more than their noise: noise of the
/// wheels looks like small turns and small changes of speed, and would seem to show what turns and
/// changes of speed show.
fn is_shown(motions: &Motions, quantity: Quantity, corrections: &Corrections) -> bool {
    let offset_ns = corrections.clock_offset_ns();
    let shows = |motion: &&ScanMotion| match quantity {
        Quantity::MountX | Quantity::MountY | Quantity::TurnScale => {
            let by_wheels = motions.by_wheels(motion, offset_ns);
            let turn_rad = by_wheels.map_or(0.0, |m| m.theta * motion.motion.theta.signum());
            turn_rad.min(motion.motion.theta.abs()) >= TURN_SHOWN_RAD
        }
        Quantity::ClockOffset => {
            change_of_speed(motions, motion, offset_ns).is_some_and(|change| {
                change.xy().norm() >= SPEED_SHOWN_MPS || change.z.abs() >= TURN_RATE_SHOWN_RADPS
            })
        }
        _ => true,
    };
    motions.by_scans().iter().filter(shows).count() >= SHOWING_MIN
}

fn prior_sigmas() -> Unknowns {
    Unknowns::from_fn(|k, _| Quantity::ALL[k].prior())
}

fn prior_information() -> Unknowns {
    prior_sigmas().map(|sigma| 1.0 / (sigma * sigma))
}

/// No clock offset beyond what the odometry covers, and no factor near 0.
fn within_reason(quantity: Quantity, value: f64) -> f64 {
    let most = match quantity {
        Quantity::ClockOffset => OFFSET_MAX_S - 0.05,
        _ => 2.0 * quantity.prior(),
    };
    value.clamp(-most, most)
}

/// The clock offset with which the turns by wheels and by scans differ least; 0 if it is hardly
/// better.
fn offset_start_s(motions: &Motions) -> f64 {
    let steps = (OFFSET_MAX_S / OFFSET_STEP_S) as i64 - 2;
    let difference_with = |step: i64| -> f64 {
        let offset_ns = step * (1e9 * OFFSET_STEP_S) as i64;
        let of_motion = |m: &ScanMotion| {
            let by_wheels = motions.by_wheels(m, offset_ns)?;
            let difference_rad = wrap_angle(by_wheels.theta - m.motion.theta).abs();
            Some(difference_rad.min(TURN_DIFFERENCE_MAX_RAD))
        };
        motions.by_scans().iter().filter_map(of_motion).sum()
    };
    let differences = (-steps..=steps).map(|step| (step, difference_with(step)));
    match differences.min_by(|a, b| a.1.total_cmp(&b.1)) {
        Some((step, least)) if least < OFFSET_LEAVES_MAX * difference_with(0) => {
            step as f64 * OFFSET_STEP_S
        }
        _ => 0.0,
    }
}

/// (Ω⁻¹ + Q)⁻¹ for each motion, times a number that makes the errors as long as such weights want
/// them.
fn weights(motions: &Motions, noise: &[f64; 3], corrections: &Corrections) -> Vec<Matrix3<f64>> {
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
struct Term {
    error: Vector3<f64>,
    jacobian: Jacobian,
    weight: Matrix3<f64>,
    length2: f64,
}

fn terms<'a>(
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
    fn gradient(&self) -> Unknowns {
        self.jacobian.transpose() * (self.weight * self.error) / (1.0 + self.length2)
    }

    /// With a share of its weight.
    fn hessian(&self, share: f64) -> Hessian {
        self.jacobian.transpose() * self.weight * self.jacobian * (share / (1.0 + self.length2))
    }

    /// By how much the curvature of Cauchy's loss is less than its weight, over the directions of
    /// an error.
    fn curvature_share(&self) -> f64 {
        1.0 - 2.0 / 3.0 * self.length2 / (1.0 + self.length2)
    }
}

fn step(
    motions: &Motions,
    weights: &[Matrix3<f64>],
    corrections: &Corrections,
) -> Option<Unknowns> {
    let prior = prior_information();
    let mut hessian = Hessian::from_diagonal(&prior);
    let values = Unknowns::from_fn(|k, _| corrections.get(Quantity::ALL[k]));
    let mut gradient = prior.component_mul(&values);
    for term in terms(motions, weights, corrections) {
        hessian += term.hessian(1.0);
        gradient += term.gradient();
    }
    Some(-hessian.cholesky()?.solve(&gradient))
}

fn sigmas_of(motions: &Motions, weights: &[Matrix3<f64>], corrections: &Corrections) -> Unknowns {
    let terms: Vec<Term> = terms(motions, weights, corrections).collect();
    let size = terms.len().div_ceil(block_count(terms.len())).max(1);
    let block = |terms: &[Term]| {
        let mut block = Block::EMPTY;
        for term in terms {
            block.hessian += term.hessian(term.curvature_share());
            block.gradient += term.gradient();
        }
        block
    };
    let blocks: Vec<_> = terms.chunks(size).map(block).collect();
    sigmas(&blocks, &prior_information())
}

/// Robust standard deviations of what is left of the motions that scans fix, by component.
fn noise_left(motions: &Motions, corrections: &Corrections) -> [f64; 3] {
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
fn excess(motions: &Motions, corrections: &Corrections) -> f64 {
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
pub(super) fn median(mut values: Vec<f64>) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests;
