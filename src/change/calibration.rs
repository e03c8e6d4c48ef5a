//! A test of closures' residuals at a stated false-alarm rate.
//!
//! Residuals of real closures are not χ² distributed: views differ, information matrices are too small or
//! too large, and each vehicle has its own noise. The spread is therefore estimated from the residuals
//! themselves, by vehicle, with medians, which a change of less than half of them hardly moves. Their
//! logarithm is assumed to be Gaussian; its tail is heavier than that of a scaled χ², so that the stated rate
//! also holds for residuals that are χ² distributed.

use std::collections::BTreeMap;

use super::median::median;
use super::threshold::chi_squared_survival;

/// With fewer residuals of a vehicle the spread of all vehicles is used.
const OWN_MIN: usize = 30;
/// With fewer residuals in all there are no p-values.
const RESIDUALS_MIN: usize = 10;
/// A Gaussian's standard deviation over its median absolute deviation.
const SIGMA_OVER_MAD: f64 = 1.482_602_218_505_602;
/// The spread of the logarithm of χ²₃ by the same estimator: a lower bound.
const SPREAD_MIN: f64 = 0.84;
/// Smaller residuals are rounding.
const RESIDUAL_MIN: f64 = 1e-12;

/// A closure's residual eᵀΩe with its vehicle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VehicleResidual<V> {
    /// The vehicle of the newer of the closure's two scans.
    pub vehicle: V,
    /// Non-negative, dimensionless.
    pub residual: f64,
}

/// For each residual the probability of one as large without a change; `None` for all if there
/// are too few to tell.
pub fn calibrated_p_values<V: Ord + Copy>(residuals: &[VehicleResidual<V>]) -> Vec<Option<f64>> {
    let known = Known::of(residuals);
    let p_values = residuals.iter().map(|residual| known.p_value(residual));
    p_values.collect()
}

/// The residuals of an unchanged world.
pub(super) struct Known<V> {
    all: Pool,
    own: BTreeMap<V, Pool>,
}

/// Logarithms of residuals with their spread as last estimated.
#[derive(Default)]
struct Pool {
    logs: Vec<f64>,
    spread: Option<Spread>,
    learnt_from: usize,
}

impl Pool {
    fn learn(&mut self, count_min: usize) {
        self.learnt_from = self.logs.len();
        self.spread = Spread::of(self.logs.clone(), count_min);
    }

    fn join(&mut self, log: f64, count_min: usize) {
        self.logs.push(log);
        if self.logs.len() >= (self.learnt_from + self.learnt_from / 4).max(count_min) {
            self.learn(count_min);
        }
    }
}

impl<V: Ord + Copy> Known<V> {
    pub(super) fn of(baseline: &[VehicleResidual<V>]) -> Self {
        let mut known = Self {
            all: Pool::default(),
            own: BTreeMap::new(),
        };
        for residual in baseline {
            let log = log_residual(residual);
            known.all.logs.push(log);
            known
                .own
                .entry(residual.vehicle)
                .or_default()
                .logs
                .push(log);
        }
        known.all.learn(RESIDUALS_MIN);
        known.own.values_mut().for_each(|own| own.learn(OWN_MIN));
        known
    }

    /// The probability of such a residual: by its vehicle's own spread where there are enough; `None`
    /// if there are too few to tell.
    pub(super) fn p_value(&self, residual: &VehicleResidual<V>) -> Option<f64> {
        let own = self.own.get(&residual.vehicle).and_then(|own| own.spread);
        let spread = own.or(self.all.spread)?;
        Some(spread.p_value(log_residual(residual)))
    }

    /// Adds a residual; spreads are estimated again once their number has grown by a quarter.
    pub(super) fn join(&mut self, residual: &VehicleResidual<V>) {
        let log = log_residual(residual);
        self.all.join(log, RESIDUALS_MIN);
        self.own
            .entry(residual.vehicle)
            .or_default()
            .join(log, OWN_MIN);
    }
}

/// The logarithm that is tested.
fn log_residual<V>(residual: &VehicleResidual<V>) -> f64 {
    residual.residual.max(RESIDUAL_MIN).ln()
}

/// Middle and spread of residuals' logarithms.
#[derive(Debug, Clone, Copy)]
struct Spread {
    median: f64,
    sigma: f64,
}

impl Spread {
    /// `None` of fewer than `count_min`.
    fn of(mut logs: Vec<f64>, count_min: usize) -> Option<Self> {
        if logs.len() < count_min {
            return None;
        }
        let middle = median(&mut logs);
        let mut deviations: Vec<f64> = logs.iter().map(|log| (log - middle).abs()).collect();
        let sigma = SIGMA_OVER_MAD * median(&mut deviations);
        Some(Self {
            median: middle,
            sigma: sigma.max(SPREAD_MIN),
        })
    }

    /// The upper tail of a Gaussian, by that of χ² with one degree of freedom.
    fn p_value(self, log: f64) -> f64 {
        let z = (log - self.median) / self.sigma;
        let beyond = 0.5 * chi_squared_survival(z * z, 1);
        if z > 0.0 { beyond } else { 1.0 - beyond }
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{chi_squared, gaussian};
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    fn of_vehicles(
        count: usize,
        mut draw: impl FnMut(usize) -> (u8, f64),
    ) -> Vec<VehicleResidual<u8>> {
        let residual = |(vehicle, residual)| VehicleResidual { vehicle, residual };
        (0..count).map(|k| residual(draw(k))).collect()
    }

    fn share_below(p_values: &[Option<f64>], rate: f64) -> f64 {
        let below = p_values.iter().filter(|p| p.unwrap() < rate).count();
        below as f64 / p_values.len() as f64
    }

    #[test]
    fn the_stated_rate_is_kept_whatever_each_vehicle_s_scale() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let benign = of_vehicles(40_000, |k| {
            let scale = [1.0, 250.0][k % 2];
            ((k % 2) as u8, scale * chi_squared(&mut rng, 3))
        });
        let heavy = of_vehicles(40_000, |k| {
            let sigma = [1.0, 2.0][k % 2];
            ((k % 2) as u8, (sigma * gaussian(&mut rng)).exp())
        });
        for rate in [0.05, 0.01, 0.001] {
            let of_benign = share_below(&calibrated_p_values(&benign), rate);
            let of_heavy = share_below(&calibrated_p_values(&heavy), rate);
            assert!(of_benign <= rate, "{rate}: {of_benign}");
            assert!((of_heavy / rate - 1.0).abs() < 0.35, "{rate}: {of_heavy}");
        }
    }

    #[test]
    fn a_change_does_not_hide_itself() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let residuals = of_vehicles(1_000, |k| {
            let changed = if k % 5 == 0 { 3_000.0 } else { 1.0 };
            (0, changed * (0.5 + chi_squared(&mut rng, 3)))
        });
        let p_values = calibrated_p_values(&residuals);
        let flagged = |k: &usize| p_values[*k].unwrap() < 1e-3;
        assert!((0..1_000).step_by(5).filter(flagged).count() > 190);
        assert!((0..1_000).filter(|k| k % 5 > 0).filter(flagged).count() < 3);
    }

    #[test]
    fn a_vehicle_of_few_closures_is_judged_by_all_and_few_closures_by_none() {
        let residuals = of_vehicles(100, |k| (u8::from(k == 99), 1.0 + (k % 7) as f64));
        let p_values = calibrated_p_values(&residuals);
        assert!(p_values.iter().all(Option::is_some));
        assert_eq!(
            p_values[99],
            p_values[99 - 98],
            "as its like of the other vehicle"
        );
        let few = calibrated_p_values(&residuals[..9]);
        assert!(few.iter().all(Option::is_none));
    }

    #[test]
    fn p_values_fall_with_the_residual() {
        let residuals = of_vehicles(200, |k| (0, 1.1_f64.powi(k as i32)));
        let p_values = calibrated_p_values(&residuals);
        assert!(p_values.windows(2).all(|pair| pair[1] < pair[0]));
    }
}
