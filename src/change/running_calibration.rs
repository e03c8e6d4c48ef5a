//! The calibrated test for closures as they arrive: flagged ones do not enter the spread, so that a change
//! cannot widen the spread by which it is judged.

use super::calibration::{Known, VehicleResidual};

/// The share of unchanged closures that the test of residuals may flag.
pub const RESIDUAL_FALSE_ALARM_RATE: f64 = 1e-4;

/// For each residual, in the order of insertion, the probability of one as large without a change.
///
/// The first `baseline` residuals are taken as those of an unchanged world. Each later one is judged by the
/// spread of those before it, of its own vehicle if there are enough, and is added to them unless its
/// probability is below `false_alarm_rate`. Spreads are estimated again whenever the number of residuals has
/// grown by a quarter: O(n log n) in all. `None` for all if the baseline is too small.
pub fn p_values_in_order<V: Ord + Copy>(
    residuals: &[VehicleResidual<V>],
    baseline: usize,
    false_alarm_rate: f64,
) -> Vec<Option<f64>> {
    let (before, after) = residuals.split_at(baseline.min(residuals.len()));
    let mut known = Known::of(before);
    let judged = before.iter().map(|residual| known.p_value(residual));
    let mut p_values: Vec<Option<f64>> = judged.collect();
    for residual in after {
        let p_value = known.p_value(residual);
        if p_value.is_some_and(|p| p >= false_alarm_rate) {
            known.join(residual);
        }
        p_values.push(p_value);
    }
    p_values
}

#[cfg(test)]
mod tests {
    use super::super::testing::{chi_squared, gaussian};
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    fn flagged(residuals: &[VehicleResidual<u8>], baseline: usize, rate: f64) -> Vec<bool> {
        let p_values = p_values_in_order(residuals, baseline, rate);
        p_values.iter().map(|p| p.unwrap() < rate).collect()
    }

    fn of(vehicle: u8, residual: f64) -> VehicleResidual<u8> {
        VehicleResidual { vehicle, residual }
    }

    #[test]
    fn a_change_of_half_of_the_closures_does_not_hide_itself() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let residuals: Vec<_> = (0..4_000)
            .map(|k| {
                let changed = if k > 400 && k % 2 == 0 { 300.0 } else { 1.0 };
                of((k % 3) as u8, changed * (0.5 + chi_squared(&mut rng, 3)))
            })
            .collect();
        let flagged = flagged(&residuals, 300, 1e-3);
        let count = |from: usize| (from..4_000).step_by(2).filter(|k| flagged[*k]).count();
        assert!(count(402) > 1_780, "{}", count(402));
        assert!(count(401) < 4, "{}", count(401));
    }

    #[test]
    fn the_stated_rate_is_kept_with_heavy_tails_and_with_light_ones() {
        for (seed, sigma) in [(2, 1.0), (3, 2.0), (4, 0.0)] {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let residuals: Vec<_> = (0..60_000)
                .map(|k| {
                    let heavy = (sigma * gaussian(&mut rng)).exp();
                    let light = chi_squared(&mut rng, 3);
                    of((k % 2) as u8, if sigma > 0.0 { heavy } else { light })
                })
                .collect();
            let flagged = flagged(&residuals, 2_000, 1e-3);
            let share = flagged.iter().filter(|t| **t).count() as f64 / 60_000.0;
            assert!(share < 1.4e-3, "{sigma}: {share}");
            assert!(share > 0.6e-3 || sigma == 0.0, "{sigma}: {share}");
        }
    }

    #[test]
    fn a_vehicle_that_comes_late_gets_a_spread_of_its_own() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        // Five times as bold about its information as the others are.
        let residuals: Vec<_> = (0..1_000)
            .map(|k| {
                let late = k >= 200 && k % 2 == 0;
                let scale = if late { 5.0 } else { 1.0 };
                of(u8::from(late), scale * chi_squared(&mut rng, 3))
            })
            .collect();
        let p_values = p_values_in_order(&residuals, 200, 1e-3);
        let medians = |late: bool| {
            let own = (600..1_000).filter(|k| (residuals[*k].vehicle == 1) == late);
            let mut own: Vec<f64> = own.map(|k| p_values[k].unwrap()).collect();
            own.sort_by(f64::total_cmp);
            own[own.len() / 2]
        };
        assert!((medians(true) - 0.5).abs() < 0.1 && (medians(false) - 0.5).abs() < 0.1);
    }

    #[test]
    fn a_small_baseline_tells_nothing() {
        let residuals: Vec<_> = (0..40).map(|k| of(0, 1.0 + f64::from(k % 5))).collect();
        let p_values = p_values_in_order(&residuals, 9, 1e-3);
        assert!(p_values.iter().all(Option::is_none));
        assert!(
            p_values_in_order(&residuals, 10, 1e-3)
                .iter()
                .all(Option::is_some)
        );
        assert!(p_values_in_order::<u8>(&[], 10, 1e-3).is_empty());
    }
}
