//! The errors of a vehicle that its motions show, all at once.

use super::blocks::{Block, block_count, sigmas};
use super::motion_model::change_of_speed;
use super::motion_terms::{Hessian, Term, Unknowns, excess, noise_left, terms, weights};
use super::motions::{Motions, OFFSET_MAX_S, ScanMotion};
use super::{Corrections, Estimate, Estimates, Quantity};
use crate::geometry::{Matrix3, wrap_angle};

/// Fewest motions that say anything.
const MOTIONS_MIN: usize = 40;
/// The noise of wheels and scans is estimated and the motions weighed anew so many times.
const ROUNDS: usize = 4;
const STEPS_MAX: usize = 12;
/// A step so short, in standard deviations of what is known beforehand, is the last.
const STEP_TOLERANCE: f64 = 1e-6;
/// An offset is none from here on, seconds.
const CLOCK_OFFSET_MAX_S: f64 = OFFSET_MAX_S - 0.05;
/// In units of the quantity: it stays where it is.
const HELD_SIGMA: f64 = 1e-9;
const NOISE_START: [f64; 3] = [0.02, 0.02, 0.02];
/// Steps of the first search for the clock offset, seconds.
const OFFSET_STEP_S: f64 = 0.025;
/// In that search a difference of two turns counts no more than this, radians.
const TURN_DIFFERENCE_MAX_RAD: f64 = 0.1;
/// A clock offset is a start if it leaves no more than this share of the differences.
const OFFSET_LEAVES_MAX: f64 = 0.9;
/// Turns from which on they show where the lidar sits, and how turns are scaled, radians.
const TURN_SHOWN_RAD: f64 = 0.06;
/// Changes of speed from which on they show a clock offset, metres a second …
const SPEED_SHOWN_MPS: f64 = 0.1;
/// … and radians a second.
const TURN_RATE_SHOWN_RADPS: f64 = 0.1;
/// So many motions must show a quantity.
const SHOWING_MIN: usize = 8;

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

/// Fits mount, wheels and clock to a trip's motions; `None` if there are fewer than forty.
///
/// Nonlinear least squares, iteratively reweighted by Cauchy's weights; the noise of the wheels is
/// estimated along with it. Standard errors are by blocks of the drive.
pub fn fit_motions(motions: &Motions) -> Option<MotionFit> {
    if motions.by_scans().len() < MOTIONS_MIN {
        return None;
    }
    let free = prior_sigmas();
    let start = Corrections::default().with(Quantity::ClockOffset, offset_start_s(motions));
    let fitted = Fitted::to(motions, start, &free)?;
    let has_offset = fitted.corrections.get(Quantity::ClockOffset).abs() < CLOCK_OFFSET_MAX_S;
    let fitted = if has_offset {
        fitted
    } else {
        // Beyond what is searched: no clock, then, explains the motions.
        let mut held = free;
        held[Quantity::ClockOffset as usize] = HELD_SIGMA;
        Fitted::to(motions, Corrections::default(), &held)?
    };
    let Fitted {
        corrections,
        noise,
        sigmas,
    } = fitted;
    let known = |(quantity, sigma): (Quantity, &f64)| {
        let estimate = Estimate::known(quantity, corrections.get(quantity), *sigma)?;
        let is_known = (quantity != Quantity::ClockOffset || has_offset)
            && is_shown(motions, quantity, &corrections);
        is_known.then_some((quantity, estimate))
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

/// Where the iterations have ended.
struct Fitted {
    corrections: Corrections,
    noise: [f64; 3],
    sigmas: Unknowns,
}

impl Fitted {
    /// From a start; `prior` are the standard deviations of what is known without the motions.
    fn to(motions: &Motions, start: Corrections, prior: &Unknowns) -> Option<Self> {
        let (mut corrections, mut noise) = (start, NOISE_START);
        let prior_information = prior.map(|sigma| 1.0 / (sigma * sigma));
        for _ in 0..ROUNDS {
            let weights = weights(motions, &noise, &corrections);
            for _ in 0..STEPS_MAX {
                let step = step(motions, &weights, &corrections, &prior_information)?;
                for (quantity, by) in Quantity::ALL.into_iter().zip(step.iter()) {
                    let value = corrections.get(quantity) + by;
                    corrections.set(quantity, within_reason(quantity, value));
                }
                if step.component_div(prior).norm() < STEP_TOLERANCE {
                    break;
                }
            }
            noise = noise_left(motions, &corrections);
        }
        let weights = weights(motions, &noise, &corrections);
        Some(Self {
            sigmas: sigmas_of(motions, &weights, &corrections, &prior_information),
            corrections,
            noise,
        })
    }
}

/// Whether there are enough motions that show a quantity by more than their noise: noise of the
/// wheels resembles small turns and small changes of speed, and would seem to show what turns and
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

/// No clock offset beyond what the odometry covers, and no factor near 0.
fn within_reason(quantity: Quantity, value: f64) -> f64 {
    let most = match quantity {
        Quantity::ClockOffset => CLOCK_OFFSET_MAX_S,
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

fn step(
    motions: &Motions,
    weights: &[Matrix3<f64>],
    corrections: &Corrections,
    prior_information: &Unknowns,
) -> Option<Unknowns> {
    let mut hessian = Hessian::from_diagonal(prior_information);
    let values = Unknowns::from_fn(|k, _| corrections.get(Quantity::ALL[k]));
    let mut gradient = prior_information.component_mul(&values);
    for term in terms(motions, weights, corrections) {
        hessian += term.hessian(1.0);
        gradient += term.gradient();
    }
    Some(-hessian.cholesky()?.solve(&gradient))
}

fn sigmas_of(
    motions: &Motions,
    weights: &[Matrix3<f64>],
    corrections: &Corrections,
    prior_information: &Unknowns,
) -> Unknowns {
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
    sigmas(&blocks, prior_information)
}

#[cfg(test)]
mod tests;
