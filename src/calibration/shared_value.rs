//! One value that many observations share.

use nalgebra::{Matrix1, Vector1};

use super::blocks::{Block, block_count, sigmas};
use super::motion_terms::median;
use super::{Estimate, Quantity};

/// What one observation says of a value, by itself.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Measured {
    /// The value.
    pub value: f64,
    /// Inverse of its variance, or what is proportional to it.
    pub information: f64,
}

/// Fewest observations.
const MEASURED_MIN: usize = 8;
const STEPS: usize = 10;
/// An observation so many standard deviations off counts half (Cauchy).
const CAUCHY_SCALE: f64 = 2.4;
/// A standard deviation from a median of absolute values.
const SIGMA_PER_MEDIAN: f64 = 1.4826;

/// Their robust weighted mean, its error by blocks of observations in the order of time. `None` if
/// there are fewer than eight, or if they say nothing.
pub(super) fn shared_value(quantity: Quantity, measured: &[Measured]) -> Option<Estimate> {
    if measured.len() < MEASURED_MIN {
        return None;
    }
    let mut value = median(measured.iter().map(|one| one.value).collect());
    let mut scale = 1.0;
    let length2 = |one: &Measured, value: f64, scale: f64| {
        one.information * (one.value - value).powi(2) / (scale * scale)
    };
    let weight = |one: &Measured, value: f64, scale: f64| {
        one.information
            / (1.0 + length2(one, value, scale) / CAUCHY_SCALE.powi(2))
            / (scale * scale)
    };
    for _ in 0..STEPS {
        let lengths = measured.iter().map(|one| length2(one, value, 1.0).sqrt());
        scale = (SIGMA_PER_MEDIAN * median(lengths.collect())).max(1e-6);
        let weights: f64 = measured.iter().map(|one| weight(one, value, scale)).sum();
        let sum: f64 = measured
            .iter()
            .map(|one| weight(one, value, scale) * one.value)
            .sum();
        value = sum / weights;
    }
    let block = |measured: &[Measured]| {
        let mut block = Block::<1>::EMPTY;
        for one in measured {
            let weight = weight(one, value, scale);
            let share = 1.0 / (1.0 + length2(one, value, scale) / CAUCHY_SCALE.powi(2));
            block.add(&Block {
                hessian: Matrix1::new(weight * (2.0 * share - 1.0).max(0.0)),
                gradient: Vector1::new(weight * (value - one.value)),
            });
        }
        block
    };
    let size = measured.len().div_ceil(block_count(measured.len())).max(1);
    let blocks: Vec<_> = measured.chunks(size).map(block).collect();
    Estimate::known(quantity, value, sigmas(&blocks, &Vector1::new(1e-9)).x)
}
