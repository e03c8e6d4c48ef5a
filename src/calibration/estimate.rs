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
    /// Σ((value − mean)/sigma)².
    pub chi_squared: f64,
    /// How many there were.
    pub count: usize,
}

/// χ² beyond which estimates contradict each other: with a probability of about 0.001, by Wilson and
/// Hilferty's approximation.
const CONTRADICTION_NORMAL: f64 = 3.09;

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
        let larger = (chi_squared / freedoms).sqrt().max(1.0);
        Some(Self {
            estimate: Estimate {
                value,
                sigma: larger / weights.sqrt(),
            },
            chi_squared,
            count: estimates.len(),
        })
    }

    /// The same with an error not below the quantity's floor, which the estimates share.
    pub fn floored(mut self, quantity: Quantity) -> Self {
        self.estimate.sigma = self.estimate.sigma.max(quantity.floor());
        self
    }

    /// The same of estimates whose errors are so many times what they say.
    pub(super) fn scattered(mut self, times: f64) -> Self {
        self.estimate.sigma *= times;
        self.chi_squared /= times * times;
        self
    }

    /// Whether there are at least two and they agree within their errors.
    pub fn agrees(&self) -> bool {
        let freedoms = self.count.saturating_sub(1) as f64;
        let ninth = 2.0 / (9.0 * freedoms.max(1.0));
        let root = 1.0 - ninth + CONTRADICTION_NORMAL * ninth.sqrt();
        self.count >= 2 && self.chi_squared <= freedoms * root.powi(3)
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
    fn what_agrees_and_what_does_not() {
        assert_eq!(Combined::of(&[]), None);
        let one = Combined::of(&[estimate(1.0, 0.1)]).unwrap();
        assert_eq!(one.estimate, estimate(1.0, 0.1));
        assert!(!one.agrees());
        let two = Combined::of(&[estimate(1.0, 0.1), estimate(1.2, 0.1)]).unwrap();
        assert!((two.estimate.value - 1.1).abs() < 1e-12);
        assert!(two.agrees());
        let apart = Combined::of(&[estimate(1.0, 0.1), estimate(1.6, 0.1)]).unwrap();
        assert!(!apart.agrees());
        assert!(apart.estimate.sigma > 0.2, "{apart:?}");
        // χ² of 0.999 with 1 and with 9 degrees of freedom: 10.8 and 27.9.
        let of = |chi_squared, count| Combined {
            chi_squared,
            count,
            ..two
        };
        assert!(of(10.2, 2).agrees() && !of(11.6, 2).agrees());
        assert!(of(27.4, 10).agrees() && !of(28.4, 10).agrees());
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
