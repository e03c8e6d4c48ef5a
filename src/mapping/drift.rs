//! How far a trip may have drifted since it was last tied to the map, and what follows from it.

use super::closure::{CONTRADICTION_SHARE_MAX, CONTRADICTION_SHARE_MAX_FROM_AFAR, Slack};
use super::front_end::Motion;
use super::odometry::OdometrySigmas;

/// A trip that has drifted so far is lost, metres: neither its scans nor its odometry say how it
/// came from where it was to where it is.
pub const LOST_DRIFT_M: f64 = 1e6;

/// A trip that has driven no farther than this since it was tied to the map is where it is
/// expected, metres.
pub(super) const DRIFT_SMALL_M: f64 = 6.0;
/// Beyond this it comes from afar, and may be tied to what only looks like the place, metres.
pub(super) const DRIFT_FAR_M: f64 = 30.0;

/// A trip that was not found is searched for again when its drift has grown by this share …
const SEARCH_GROWTH: f64 = 0.05;
/// … or by this, metres, whichever comes first.
const SEARCH_STEP_MAX_M: f64 = 2.0;

/// How far from the expected place a closure may be measured, for a trip that was tied to the map
/// not long ago, and for one that was found again.
pub(super) fn slack_small(drift_m: f64) -> Slack {
    Slack {
        distance_m: 0.45,
        turn_rad: 0.16,
        well_known: drift_m <= DRIFT_SMALL_M,
        contradiction_share_max: match drift_m <= DRIFT_FAR_M {
            true => CONTRADICTION_SHARE_MAX,
            false => CONTRADICTION_SHARE_MAX_FROM_AFAR,
        },
    }
}

/// Where a trip may be after it has driven a way without being tied to the map: three hundredths
/// of the way, one degree a metre.
pub(super) fn slack_after(drift_m: f64) -> Slack {
    Slack {
        distance_m: (0.3 + 0.03 * drift_m).min(4.0),
        turn_rad: (0.1 + 0.02 * drift_m).min(0.7),
        well_known: false,
        contradiction_share_max: CONTRADICTION_SHARE_MAX_FROM_AFAR,
    }
}

/// A matched motion counts as its length, one by odometry alone as what it may be off.
pub(super) fn drift_of_motion(motion: &Motion, odometry: &OdometrySigmas) -> f64 {
    if motion.matched {
        return motion.measurement.translation().norm();
    }
    drift_of(odometry.xy_m, odometry.theta_rad)
}

/// The way after which [`slack_after`] is three such standard deviations.
pub(super) fn drift_of(sigma_xy_m: f64, sigma_theta_rad: f64) -> f64 {
    (100.0 * sigma_xy_m).max(150.0 * sigma_theta_rad)
}

/// Whether a trip that was not found with one drift is searched for with another: a search costs
/// much, and finds the same a step farther on.
pub(super) fn is_search_due(before_m: f64, drift_m: f64) -> bool {
    before_m <= DRIFT_SMALL_M || search_number(before_m) != search_number(drift_m)
}

/// Of the searches after a drift, which is the last one.
fn search_number(drift_m: f64) -> i64 {
    let step_from_m = SEARCH_STEP_MAX_M / SEARCH_GROWTH;
    let near = (drift_m.min(step_from_m) / DRIFT_SMALL_M).ln() / SEARCH_GROWTH;
    let far = (drift_m - step_from_m).max(0.0) / SEARCH_STEP_MAX_M;
    (near + far).floor() as i64
}

#[cfg(test)]
mod tests {
    use super::super::odometry::OdometryMotion;
    use super::*;
    use crate::geometry::{Information, Pose2};

    #[test]
    fn slack_grows_with_the_way_up_to_a_limit() {
        let (at_once, later) = (slack_after(0.0), slack_after(50.0));
        assert!((at_once.distance_m - 0.3).abs() < 1e-12 && (at_once.turn_rad - 0.1).abs() < 1e-12);
        assert!((later.distance_m - 1.8).abs() < 1e-12);
        let endless = slack_after(f64::MAX);
        assert_eq!((endless.distance_m, endless.turn_rad), (4.0, 0.7));
        for way_m in 0..300 {
            let (near, far) = (
                slack_after(f64::from(way_m)),
                slack_after(f64::from(way_m + 1)),
            );
            assert!(near.distance_m <= far.distance_m && near.turn_rad <= far.turn_rad);
        }
    }

    #[test]
    fn a_stated_uncertainty_gets_three_of_its_sigmas_of_slack() {
        for (xy_m, theta_rad) in [(0.01, 0.002), (0.3, 0.1), (1.0, 0.01), (0.05, 0.2)] {
            let slack = slack_after(drift_of(xy_m, theta_rad));
            assert!(slack.distance_m >= 3.0 * xy_m, "{slack:?}");
            assert!(slack.turn_rad >= (3.0 * theta_rad).min(0.7), "{slack:?}");
        }
    }

    #[test]
    fn a_matched_motion_drifts_by_its_length_and_a_blind_one_by_its_doubt() {
        let odometry = OdometryMotion::told(&Pose2::new(3.0, 4.0, 0.2));
        let motion = |matched| Motion {
            measurement: Pose2::new(3.0, 4.0, 0.2),
            information: Information::identity(),
            matched,
        };
        let by_match_m = drift_of_motion(&motion(true), &odometry.sigmas);
        assert!((by_match_m - 5.0).abs() < 1e-12);
        let blind_m = drift_of_motion(&motion(false), &odometry.sigmas);
        // 0.05 m + a tenth of 5 m is 0.55 m: a hundred of them.
        assert!((blind_m - 55.0).abs() < 1e-9, "{blind_m}");
    }

    #[test]
    fn searches_are_a_twentieth_of_the_way_apart_and_no_more_than_two_metres() {
        assert!(is_search_due(5.9, 6.2), "the first time");
        assert!(!is_search_due(20.0, 20.0), "on the spot");
        let mut last_m = 6.01;
        let mut drift_m = last_m;
        while drift_m < 300.0 {
            let next_m = drift_m + 0.05;
            if is_search_due(drift_m, next_m) {
                let step_m = next_m - last_m;
                assert!(step_m <= (0.06 * next_m).min(2.06), "{step_m} at {next_m}");
                last_m = next_m;
            }
            drift_m = next_m;
        }
        assert!(last_m > 297.0);
        assert!(!is_search_due(100.0, 101.0) || !is_search_due(101.0, 102.0));
    }
}
