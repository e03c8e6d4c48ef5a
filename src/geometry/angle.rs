//! Angles in radians.

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI, TAU};

use nalgebra::Vector2;

/// The same direction in (−π, π].
///
/// An angle that is there already is returned to the bit.
pub fn wrap_angle(angle_rad: f64) -> f64 {
    if angle_rad > -PI && angle_rad <= PI {
        return angle_rad;
    }
    let wrapped = angle_rad - TAU * (angle_rad / TAU).round();
    if wrapped <= -PI {
        wrapped + TAU
    } else {
        wrapped
    }
}

/// The direction of a vector, radians in [−π, π], to within 10⁻¹³; 0 of no vector.
///
/// A third of what an arc tangent to the last bit takes.
pub fn direction_rad(vector: &Vector2<f64>) -> f64 {
    let (x, y) = (vector.x.abs(), vector.y.abs());
    let (small, large) = (x.min(y), x.max(y).max(f64::MIN_POSITIVE));
    // Beyond π/8, the angle from the diagonal is the smaller one.
    let (over, under, from_rad) = if small > TAN_EIGHTH * large {
        (small - large, small + large, FRAC_PI_4)
    } else {
        (small, large, 0.0)
    };
    let tangent = over / under;
    let square = tangent * tangent;
    let octant_rad = from_rad + tangent * arc_tangent_series(square);
    let quadrant_rad = if y > x {
        FRAC_PI_2 - octant_rad
    } else {
        octant_rad
    };
    let half_rad = if vector.x < 0.0 {
        PI - quadrant_rad
    } else {
        quadrant_rad
    };
    half_rad.copysign(vector.y)
}

/// The series at t², by pairs of terms and pairs of those: none waits for all before it.
fn arc_tangent_series(x: f64) -> f64 {
    let c = &ARC_TANGENT;
    let (x2, x4) = (x * x, (x * x) * (x * x));
    let low = (c[0] + c[1] * x) + (c[2] + c[3] * x) * x2;
    let high = (c[4] + c[5] * x) + (c[6] + c[7] * x) * x2;
    low + high * x4 + c[8] * (x4 * x4)
}

/// tan(π/8).
const TAN_EIGHTH: f64 = std::f64::consts::SQRT_2 - 1.0;
/// atan(t)/t in powers of t², for |t| ≤ tan(π/8): a fit at Chebyshev's points.
const ARC_TANGENT: [f64; 9] = [
    0.999_999_999_999_974_4,
    -0.333_333_333_308_730_1,
    0.199_999_996_134_269_8,
    -0.142_856_908_214_090_22,
    0.111_103_941_377_846_74,
    -0.090_785_050_163_950_54,
    0.075_644_812_028_853_63,
    -0.058_772_949_636_897_644,
    0.030_703_101_596_719_504,
];

/// The size of the turn between two directions, in [0, π].
pub fn angle_difference_rad(a_rad: f64, b_rad: f64) -> f64 {
    wrap_angle(a_rad - b_rad).abs()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn borders() {
        assert_eq!(wrap_angle(PI), PI);
        assert_eq!(wrap_angle(-PI), PI);
        assert_eq!(wrap_angle(3.0 * PI), PI);
        assert_eq!(wrap_angle(-1e-9), -1e-9);
        assert!((angle_difference_rad(PI - 0.1, -PI + 0.1) - 0.2).abs() < 1e-12);
    }

    #[test]
    fn directions_of_axes_diagonals_and_nothing() {
        let direction = |x: f64, y: f64| direction_rad(&Vector2::new(x, y));
        for (x, y) in [
            (1.0, 0.0),
            (0.0, 2.0),
            (-1.0, 0.0),
            (0.0, -3.0),
            (-1.0, -0.0),
        ] {
            assert_eq!(direction(x, y), y.atan2(x), "{x} {y}");
        }
        for (x, y) in [(2.0, 2.0), (-1.0, 1.0), (-5.0, -5.0), (0.1, -0.1)] {
            assert!((direction(x, y) - y.atan2(x)).abs() < 1e-13, "{x} {y}");
        }
        assert_eq!(direction(0.0, 0.0), 0.0);
    }

    proptest! {
        #[test]
        fn a_direction_is_the_arc_tangent(x in -50.0..50.0_f64, y in -50.0..50.0_f64, flat in 0.0..1.0_f64) {
            for (x, y) in [(x, y), (x, y * flat * 1e-3), (x * flat * 1e-9, y)] {
                let direction = direction_rad(&Vector2::new(x, y));
                prop_assert!((direction - y.atan2(x)).abs() < 1e-13, "{x} {y}");
            }
        }

        #[test]
        fn stays_in_range_and_keeps_the_direction(angle in -1e4..1e4_f64) {
            let wrapped = wrap_angle(angle);
            prop_assert!(wrapped > -PI && wrapped <= PI);
            prop_assert!((wrapped.sin() - angle.sin()).abs() < 1e-9);
            prop_assert!((wrapped.cos() - angle.cos()).abs() < 1e-9);
        }
    }
}
