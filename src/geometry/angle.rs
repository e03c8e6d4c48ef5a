//! Angles in radians.

use std::f64::consts::{PI, TAU};

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

    proptest! {
        #[test]
        fn stays_in_range_and_keeps_the_direction(angle in -1e4..1e4_f64) {
            let wrapped = wrap_angle(angle);
            prop_assert!(wrapped > -PI && wrapped <= PI);
            prop_assert!((wrapped.sin() - angle.sin()).abs() < 1e-9);
            prop_assert!((wrapped.cos() - angle.cos()).abs() < 1e-9);
        }
    }
}
