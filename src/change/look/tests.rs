use std::f64::consts::PI;
use std::sync::Arc;

use proptest::prelude::*;

use super::*;
use crate::scan::Lidar;

/// A round room of a given radius about the lidar, in which one beam in a range may be shorter.
fn scan(beams: usize, range_m: impl Fn(usize) -> Option<f64>) -> LaserScan {
    let lidar = Lidar {
        angle_min_rad: -PI,
        angle_increment_rad: TAU / beams as f64,
        range_min_m: 0.05,
        range_max_m: 20.0,
        mount: Pose2::new(0.2, -0.1, 0.4),
        range_sigma_m: 0.01,
    };
    let lidar = Arc::new(lidar.validated().unwrap());
    LaserScan::new(lidar, (0..beams).map(range_m)).unwrap()
}

fn look<'a>(scan: &'a LaserScan, map_from_base: &Pose2) -> Look<'a> {
    Look::new(NodeId(1), (0, 0), StampNs(0), map_from_base, scan)
}

/// Where a point at a beam's angle and range lies in the map.
fn along(scan: &LaserScan, map_from_base: &Pose2, beam: usize, range_m: f64) -> Vector2<f64> {
    let lidar = scan.lidar();
    let (sin, cos) = lidar.beam_angle_rad(beam).sin_cos();
    let map_from_lidar = map_from_base.compose(&lidar.mount);
    map_from_lidar.transform(&(Vector2::new(cos, sin) * range_m))
}

proptest! {
    #[test]
    fn beams_end_pass_and_are_stopped(
        beam in 0..360_usize,
        (x, y, theta) in (-20.0..20.0_f64, -20.0..20.0_f64, -PI..PI),
        wall_m in 2.0..9.0_f64,
    ) {
        let pose = Pose2::new(x, y, theta);
        let scan = scan(360, |_| Some(wall_m));
        let look = look(&scan, &pose);
        let at = |range_m| look.sight(&along(&scan, &pose, beam, range_m));
        prop_assert_eq!(at(wall_m), Sight::Struck);
        prop_assert_eq!(at(wall_m - 0.5), Sight::Passed);
        prop_assert_eq!(at(wall_m + 0.5), Sight::Hidden);
    }

    /// Among thin things: struck if any beam ends near, whatever the others do.
    #[test]
    fn one_beam_that_ends_there_is_enough(beam in 0..360_usize, near in -1..2_i64) {
        let pose = Pose2::IDENTITY;
        let struck = (beam as i64 + near).rem_euclid(360) as usize;
        let scan = scan(360, |k| Some(if k == struck { 5.0 } else { 9.0 }));
        let spot = along(&scan, &pose, beam, 5.0);
        prop_assert_eq!(look(&scan, &pose).sight(&spot), Sight::Struck);
    }
}

#[test]
fn no_return_is_no_evidence() {
    let pose = Pose2::IDENTITY;
    let scan = scan(360, |_| None);
    let spot = along(&scan, &pose, 100, 5.0);
    assert_eq!(look(&scan, &pose).sight(&spot), Sight::Hidden);
}

#[test]
fn what_is_too_far_to_be_told_is_not_told() {
    let pose = Pose2::IDENTITY;
    let scan = scan(360, |_| Some(19.0));
    let look = look(&scan, &pose);
    let (near, far) = (along(&scan, &pose, 7, 8.0), along(&scan, &pose, 7, 18.6));
    assert!(look.reaches(&near) && !look.reaches(&far));
    assert_eq!(look.sight(&near), Sight::Passed);
    assert_eq!(look.sight(&far), Sight::Hidden);
}

#[test]
fn a_pose_that_is_off_tells_less() {
    let pose = Pose2::IDENTITY;
    let scan = scan(360, |_| Some(9.0));
    let sure = look(&scan, &pose);
    let unsure = look(&scan, &pose).with_pose_error(0.03);
    let hopeless = look(&scan, &pose).with_pose_error(0.2);
    let before = along(&scan, &pose, 7, 8.78);
    assert_eq!(sure.sight(&before), Sight::Passed);
    assert_eq!(unsure.sight(&before), Sight::Struck);
    let near = along(&scan, &pose, 7, 2.0);
    assert_eq!(unsure.sight(&near), Sight::Passed);
    assert_eq!(hopeless.sight(&near), Sight::Hidden);
    assert!(!hopeless.reaches(&near));
}

#[test]
fn behind_a_lidar_that_looks_ahead_is_nothing_seen() {
    let lidar = Lidar {
        angle_min_rad: -0.5 * PI,
        angle_increment_rad: PI / 180.0,
        range_min_m: 0.05,
        range_max_m: 20.0,
        mount: Pose2::IDENTITY,
        range_sigma_m: 0.01,
    };
    let lidar = Arc::new(lidar.validated().unwrap());
    let scan = LaserScan::new(lidar, (0..181).map(|_| Some(9.0))).unwrap();
    let look = look(&scan, &Pose2::IDENTITY);
    assert_eq!(look.sight(&Vector2::new(5.0, 0.0)), Sight::Passed);
    assert_eq!(look.sight(&Vector2::new(-5.0, 0.3)), Sight::Hidden);
}
