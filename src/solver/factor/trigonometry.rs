//! Sines and cosines without branches and calls, so that loops over them become vector
//! instructions, and with the same bits on every processor.

use std::f64::consts::{FRAC_2_PI, FRAC_PI_2, PI, TAU};

/// What π/2 has beyond its nearest number.
const FRAC_PI_2_REST: f64 = 6.123_233_995_736_766e-17;
/// Numbers of this size have no digits after the point.
const SHIFT: f64 = 1.5 * (1_u64 << 52) as f64;
/// This many terms of the series are beyond rounding at π/4.
const TERMS: u32 = 8;

/// Sines and cosines of angles, to within 3 · 10⁻¹⁶ for those of at most half a turn.
#[inline(always)]
pub(super) fn sines_and_cosines<const N: usize>(angles_rad: [f64; N]) -> ([f64; N], [f64; N]) {
    let (mut rest, mut square, mut bits) = ([0.0; N], [0.0; N], [0; N]);
    for k in 0..N {
        let shifted = angles_rad[k] * FRAC_2_PI + SHIFT;
        let quarters = shifted - SHIFT;
        bits[k] = shifted.to_bits();
        rest[k] = (angles_rad[k] - quarters * FRAC_PI_2) - quarters * FRAC_PI_2_REST;
        square[k] = rest[k] * rest[k];
    }
    // Taylor's series from their ends, less their first terms.
    let (mut sin, mut cos) = ([0.0; N], [0.0; N]);
    for term in (1..=TERMS).rev() {
        let n = f64::from(2 * term);
        let (of_sin, of_cos) = (-1.0 / (n * (n + 1.0)), -1.0 / (n * (n - 1.0)));
        for k in 0..N {
            sin[k] = (1.0 + sin[k]) * (square[k] * of_sin);
            cos[k] = (1.0 + cos[k]) * (square[k] * of_cos);
        }
    }
    for k in 0..N {
        let (s, c) = (rest[k] + rest[k] * sin[k], 1.0 + cos[k]);
        let is_odd = bits[k] & 1 != 0;
        (sin[k], cos[k]) = if is_odd { (c, -s) } else { (s, c) };
        // The second bit becomes the sign.
        let sign = (bits[k] & 2) << 62;
        sin[k] = f64::from_bits(sin[k].to_bits() ^ sign);
        cos[k] = f64::from_bits(cos[k].to_bits() ^ sign);
    }
    (sin, cos)
}

/// Sine and cosine of one angle.
#[inline(always)]
pub(super) fn sin_cos(angle_rad: f64) -> (f64, f64) {
    let ([sin], [cos]) = sines_and_cosines([angle_rad]);
    (sin, cos)
}

/// As [`crate::geometry::wrap_angle`], for angles of at most a few turns.
#[inline(always)]
pub(super) fn wrap(angle_rad: f64) -> f64 {
    let turns = (angle_rad * (1.0 / TAU) + SHIFT) - SHIFT;
    let wrapped = angle_rad - TAU * turns;
    if wrapped <= -PI {
        wrapped + TAU
    } else {
        wrapped
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::geometry::wrap_angle;

    #[test]
    fn whole_quarters() {
        for quarters in -8..=8 {
            let angle = f64::from(quarters) * FRAC_PI_2;
            let (sin, cos) = sin_cos(angle);
            assert!((sin - angle.sin()).abs() < 1e-15 && (cos - angle.cos()).abs() < 1e-15);
        }
        assert_eq!(sin_cos(0.0), (0.0, 1.0));
        assert_eq!((wrap(PI), wrap(-PI), wrap(-1e-9)), (PI, PI, -1e-9));
        assert!(sin_cos(f64::NAN).0.is_nan() && wrap(f64::INFINITY).is_nan());
    }

    proptest! {
        #[test]
        fn as_the_standard_library_has_it(angle in -PI..PI, turns in -3..=3_i32) {
            let ((sin, cos), expected) = (sin_cos(angle), angle.sin_cos());
            prop_assert!((sin - expected.0).abs() < 3e-16, "{} {}", sin, expected.0);
            prop_assert!((cos - expected.1).abs() < 3e-16, "{} {}", cos, expected.1);
            let angle = angle + f64::from(turns) * TAU;
            let ((sin, cos), expected) = (sin_cos(angle), angle.sin_cos());
            prop_assert!((sin - expected.0).abs() < 1e-14 && (cos - expected.1).abs() < 1e-14);
            let gap = (wrap(angle) - wrap_angle(angle)).abs();
            prop_assert!(gap < 1e-14 || (gap - TAU).abs() < 1e-14);
        }
    }
}
