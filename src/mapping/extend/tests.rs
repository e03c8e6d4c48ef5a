//! How far a trip may be from where it is expected.

use super::*;
use crate::geometry::Information;

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
