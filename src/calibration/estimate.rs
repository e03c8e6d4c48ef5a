//! Values with their errors.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::Quantity;

/// A value with its standard error, both in the unit of the quantity.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Estimate {
    /// The value.
    pub value: f64,
    /// Its standard error.
    pub sigma: f64,
}

/// What is known of a vehicle; what is not in it is unknown.
pub type Estimates = BTreeMap<Quantity, Estimate>;

/// Several estimates of one value as one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Combined {
    /// Weighted by the inverse variances. If they scatter more than their errors say, its error is
    /// the larger for it.
    pub estimate: Estimate,
    /// The standard error of the value by the scatter of the estimates alone; 0 for one.
    pub scatter: f64,
    /// How many there were.
    pub count: usize,
}

impl Estimate {
    /// How far two estimates are apart, in standard deviations of their difference.
    pub fn distance(&self, other: &Self) -> f64 {
        (self.value - other.value).abs() / self.sigma.hypot(other.sigma)
    }

    /// |value| in standard errors.
    pub fn significance(&self) -> f64 {
        self.value.abs() / self.sigma
    }

    /// The estimate of a quantity if it says anything: its error with the quantity's floor, and
    /// `None` beyond [`Quantity::known_sigma_max`].
    pub(super) fn known(quantity: Quantity, value: f64, sigma: f64) -> Option<Self> {
        let sigma = sigma.hypot(quantity.floor());
        let is_known = value.is_finite() && sigma <= quantity.known_sigma_max();
        is_known.then_some(Self { value, sigma })
    }
}

impl Combined {
    /// Of independent estimates; `None` without any.
    pub fn of(estimates: &[Estimate]) -> Option<Self> {
        let weight = |e: &Estimate| 1.0 / (e.sigma * e.sigma);
        let weights: f64 = estimates.iter().map(weight).sum();
        if estimates.is_empty() || !weights.is_finite() {
            return None;
        }
        let value = estimates.iter().map(|e| weight(e) * e.value).sum::<f64>() / weights;
        let deviation = |e: &Estimate| weight(e) * (e.value - value).powi(2);
        let chi_squared: f64 = estimates.iter().map(deviation).sum();
        let freedoms = (estimates.len() - 1).max(1) as f64;
        let larger = (chi_squared / freedoms).sqrt();
        Some(Self {
            estimate: Estimate {
                value,
                sigma: larger.max(1.0) / weights.sqrt(),
            },
            scatter: larger / weights.sqrt(),
            count: estimates.len(),
        })
    }

    /// The same with an error not below the quantity's floor, which the estimates share.
    pub fn floored(mut self, quantity: Quantity) -> Self {
        self.estimate.sigma = self.estimate.sigma.max(quantity.floor());
        self
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn estimate(value: f64, sigma: f64) -> Estimate {
        Estimate { value, sigma }
    }

    #[test]
    fn estimates_that_scatter_are_worth_less() {
        assert_eq!(Combined::of(&[]), None);
        let one = Combined::of(&[estimate(1.0, 0.1)]).unwrap();
        assert_eq!((one.estimate, one.scatter), (estimate(1.0, 0.1), 0.0));
        let near = Combined::of(&[estimate(1.0, 0.1), estimate(1.1, 0.1)]).unwrap();
        assert!((near.estimate.value - 1.05).abs() < 1e-12);
        assert!((near.estimate.sigma - 0.1 / 2.0_f64.sqrt()).abs() < 1e-12);
        assert!((near.scatter - 0.05).abs() < 1e-12);
        let apart = Combined::of(&[estimate(1.0, 0.1), estimate(1.6, 0.1)]).unwrap();
        assert!((apart.scatter - 0.3).abs() < 1e-12);
        assert_eq!(apart.estimate.sigma, apart.scatter);
    }

    #[test]
    fn a_wide_estimate_is_none() {
        let yaw = |sigma| Estimate::known(Quantity::MountYaw, 0.01, sigma);
        assert!(yaw(0.001).is_some_and(|e| e.sigma > 0.001));
        assert_eq!(yaw(0.1), None);
        assert_eq!(yaw(f64::NAN), None);
    }

    proptest! {
        #[test]
        fn more_estimates_know_more(
            values in prop::collection::vec(-1.0..1.0_f64, 1..8), sigma in 1.0..2.0_f64,
        ) {
            let estimates: Vec<_> = values.iter().map(|v| estimate(*v, sigma)).collect();
            let combined = Combined::of(&estimates).unwrap();
            let mean = values.iter().sum::<f64>() / values.len() as f64;
            prop_assert!((combined.estimate.value - mean).abs() < 1e-9);
            prop_assert!(combined.estimate.sigma <= sigma * (1.0 + 1e-9));
        }
    }
}
