//! Thresholds on the increase ΔF, and the false-alarm rates that they imply.

use statrs::distribution::{ChiSquared, ContinuousCDF};

/// th / σ² = 1 + 3√2: three standard deviations above the mean of σ²χ²₁, which the paper assumes
/// to be Gaussian (equations 4 to 6).
pub const PAPER_FACTOR: f64 = 1.0 + 3.0 * std::f64::consts::SQRT_2;

/// The median of χ² with three degrees of freedom.
pub const CHI_SQUARED_3_MEDIAN: f64 = 2.365_973_884_375_338;

/// The paper's threshold on ΔF, th = σ²(1 + 3√2), for σ² = f(n*) (equation 6).
///
/// One term of F is χ² distributed, not Gaussian: were the error scalar, th would be crossed
/// without a change with probability 2.2 %; with three equal components whose mean sum is σ²,
/// with 0.13 %.
pub fn paper_threshold(sigma2: f64) -> f64 {
    sigma2 * PAPER_FACTOR
}

/// The probability that χ² with some degrees of freedom exceeds x. Relative error below 10⁻¹²,
/// far tail included; 1 for x ≤ 0, and for no degrees of freedom.
pub fn chi_squared_survival(x: f64, degrees_of_freedom: usize) -> f64 {
    if x.is_nan() || x <= 0.0 || degrees_of_freedom == 0 {
        return 1.0;
    }
    if x == f64::INFINITY {
        return 0.0;
    }
    // statrs halves x: the smallest numbers would become 0, which it rejects.
    ChiSquared::new(degrees_of_freedom as f64)
        .map_or(1.0, |chi_squared| chi_squared.sf(x.max(f64::MIN_POSITIVE)))
}

/// The x that χ² with some degrees of freedom exceeds with this probability: the threshold for a
/// false-alarm rate in (0, 1). 0 for a rate of 1 and above, infinity for 0 and below.
pub fn chi_squared_threshold(false_alarm_rate: f64, degrees_of_freedom: usize) -> f64 {
    if false_alarm_rate >= 1.0 || degrees_of_freedom == 0 {
        return 0.0;
    }
    if false_alarm_rate.is_nan() || false_alarm_rate <= 0.0 {
        return f64::INFINITY;
    }
    let (mut low, mut high) = (0.0, 1.0);
    while chi_squared_survival(high, degrees_of_freedom) > false_alarm_rate {
        low = high;
        high *= 2.0;
    }
    // Bisection ends at neighbouring floating-point numbers.
    loop {
        let middle = 0.5 * (low + high);
        if middle <= low || middle >= high {
            return high;
        }
        if chi_squared_survival(middle, degrees_of_freedom) > false_alarm_rate {
            low = middle;
        } else {
            high = middle;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn close(a: f64, b: f64) -> bool {
        (a - b).abs() <= 1e-11 * b.abs()
    }

    #[test]
    fn survival_agrees_with_tables() {
        // Two degrees of freedom: e^(-x/2).
        for x in [1e-6, 0.3, 2.0, 10.0, 100.0, 1000.0] {
            assert!(close(chi_squared_survival(x, 2), (-x / 2.0).exp()), "{x}");
            // Four: (1 + x/2) e^(-x/2).
            assert!(close(
                chi_squared_survival(x, 4),
                (1.0 + x / 2.0) * (-x / 2.0).exp()
            ));
        }
        // The usual tables.
        for (x, k, p) in [
            (3.841458820694124, 1, 0.05),
            (11.344866730144373, 3, 0.01),
            (7.814727903251179, 3, 0.05),
        ] {
            assert!((chi_squared_survival(x, k) - p).abs() < 1e-12, "{x}");
        }
        assert!(close(chi_squared_survival(CHI_SQUARED_3_MEDIAN, 3), 0.5));
        assert_eq!(chi_squared_survival(0.0, 3), 1.0);
        assert_eq!(chi_squared_survival(f64::NAN, 3), 1.0);
        assert_eq!(chi_squared_survival(f64::INFINITY, 3), 0.0);
        assert_eq!(chi_squared_survival(f64::from_bits(1), 3), 1.0);
    }

    #[test]
    fn the_paper_s_threshold_as_false_alarm_rates() {
        let scalar = chi_squared_survival(PAPER_FACTOR, 1);
        let three_equal = chi_squared_survival(3.0 * PAPER_FACTOR, 3);
        assert!((scalar - 0.022).abs() < 5e-4, "{scalar}");
        assert!((three_equal - 0.0013).abs() < 1e-4, "{three_equal}");
        assert!((paper_threshold(2.0) - 10.485_281_374_238_57).abs() < 1e-12);
    }

    proptest! {
        #[test]
        fn threshold_inverts_survival(exponent in -12.0..-0.01_f64, k in 1..7_usize) {
            let rate = 10f64.powf(exponent);
            let x = chi_squared_threshold(rate, k);
            prop_assert!((chi_squared_survival(x, k) / rate - 1.0).abs() < 1e-9);
        }

        #[test]
        fn survival_falls(x in 0.0..200.0_f64, step in 0.01..5.0_f64, k in 1..7_usize) {
            prop_assert!(chi_squared_survival(x + step, k) < chi_squared_survival(x, k));
        }
    }
}
