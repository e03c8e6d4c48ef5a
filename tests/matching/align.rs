//! What the two forms of the alignment recover in a hall.

use std::f64::consts::PI;

use mapshift::geometry::Pose2;
use mapshift::matching::{Estimate, IcpParams, ReferenceCloud, Termination, align};
use mapshift::scan::{LaserScan, surface_points};
use mapshift::sim::{Hall, Shape, World};

use crate::scans::{Noise, apart, lidar, look, quantile};

const SIGMA_M: f64 = 0.01;

/// The new scan against the old one, from a start.
fn align_scans(old: &LaserScan, new: &LaserScan, start: &Pose2, params: &IcpParams) -> Estimate {
    let old = surface_points(old);
    let cloud = ReferenceCloud::new([(Pose2::IDENTITY, old.as_slice())]).unwrap();
    align(&cloud, &surface_points(new), start, SIGMA_M, None, params)
}

/// Errors (metres, radians) of robust matches between views 0.3 m and 8° apart, started up to
/// this many metres and degrees beside the truth.
fn errors_in_halls(
    (field_of_view_deg, beams, mount): (u32, usize, Pose2),
    (off_m, off_deg): (f64, f64),
) -> (Vec<f64>, Vec<f64>) {
    let lidar = lidar(field_of_view_deg, beams, mount, SIGMA_M);
    let mut noise = Noise::new(u64::from(field_of_view_deg));
    let (mut shifts_m, mut turns_rad) = (Vec::new(), Vec::new());
    for seed in 0..4 {
        let hall = Hall::generate(seed).unwrap();
        for k in 0..15 {
            let old_at = hall.route.pose_at(8.0 * f64::from(k));
            let truth = noise.on_rim(0.3, 0.14);
            let new_at = old_at.compose(&truth);
            let old = look(&hall.world, &lidar, beams, &old_at, &mut noise);
            let new = look(&hall.world, &lidar, beams, &new_at, &mut noise);
            let off_m = noise.between(0.0, off_m);
            let start = truth.compose(&noise.on_rim(off_m, off_deg.to_radians()));
            let found = align_scans(&old, &new, &start, &IcpParams::ROBUST);
            let (shift_m, turn_rad) = apart(&truth, &found.pose);
            shifts_m.push(shift_m);
            turns_rad.push(turn_rad);
        }
    }
    (shifts_m, turns_rad)
}

#[test]
fn robust_matches_recover_the_motion_for_every_field_of_view_and_mount() {
    let mounts = [
        Pose2::IDENTITY,
        Pose2::new(0.6, -0.2, 0.9),
        Pose2::new(-0.5, 0.3, PI),
    ];
    for (field_of_view_deg, beams, good_min) in [(180, 361, 42), (270, 541, 44), (360, 720, 46)] {
        for mount in mounts {
            let (shifts_m, turns_rad) =
                errors_in_halls((field_of_view_deg, beams, mount), (0.5, 15.0));
            let median_m = quantile(&shifts_m, 0.5);
            let median_deg = quantile(&turns_rad, 0.5).to_degrees();
            let good = shifts_m.iter().zip(&turns_rad);
            let good = good.filter(|(m, rad)| **m < 0.03 && **rad < 0.01).count();
            let said = format!(
                "{field_of_view_deg}° {mount:?}: {median_m} m, {median_deg}°, {good} of 60"
            );
            assert!(median_m < 0.003 && median_deg < 0.05, "{said}");
            assert!(good >= good_min, "{said}");
        }
    }
}

#[test]
fn from_where_odometry_leads_every_match_ends_at_the_truth() {
    for (field_of_view_deg, beams) in [(180, 361), (270, 541), (360, 720)] {
        let (shifts_m, turns_rad) = errors_in_halls(
            (field_of_view_deg, beams, Pose2::new(0.6, -0.2, 0.9)),
            (0.1, 3.0),
        );
        let (shift_m, turn_rad) = (quantile(&shifts_m, 1.0), quantile(&turns_rad, 1.0));
        assert!(
            shift_m < 0.03 && turn_rad < 0.004,
            "{shift_m} m, {turn_rad}"
        );
    }
}

#[test]
fn a_match_of_a_scan_with_itself_ends_where_it_is() {
    let hall = Hall::generate(9).unwrap();
    let lidar = lidar(270, 541, Pose2::new(0.3, 0.1, -0.4), SIGMA_M);
    let mut noise = Noise::new(1);
    let scan = look(
        &hall.world,
        &lidar,
        541,
        &hall.route.pose_at(30.0),
        &mut noise,
    );
    // The surface that points describe together passes beside single ones of them: what ends
    // smoothly ends a little beside the scan.
    for (params, off_max) in [(IcpParams::ROBUST, 1e-4), (IcpParams::ALL_POINTS, 1e-5)] {
        let found = align_scans(&scan, &scan, &Pose2::new(0.03, -0.02, 0.01), &params);
        let (shift_m, turn_rad) = apart(&Pose2::IDENTITY, &found.pose);
        assert!(shift_m < off_max && turn_rad < 1e-5, "{found:?}");
        assert_eq!(found.termination, Termination::Converged);
        assert_eq!((found.overlap, found.inlier_share), (1.0, 1.0));
    }
}

/// A room with two boxes; the second one stands `moved_m` farther on.
fn room(moved_m: f64) -> World {
    World::new([
        Shape::rectangle(&Pose2::IDENTITY, 9.0, 7.0),
        Shape::rectangle(&Pose2::new(-2.0, 1.5, 0.3), 1.0, 0.8),
        Shape::rectangle(&Pose2::new(2.0 + moved_m, -0.5, 0.1), 0.8, 1.6),
    ])
}

#[test]
fn a_moved_object_pulls_the_all_points_form_alone() {
    let lidar = lidar(360, 720, Pose2::IDENTITY, SIGMA_M);
    let mut noise = Noise::new(3);
    let (mut robust_m, mut all_points_m) = (Vec::new(), Vec::new());
    for _ in 0..20 {
        let old_at = Pose2::new(noise.between(-1.0, 0.0), noise.between(-1.0, 0.5), 0.4);
        let truth = noise.on_rim(0.2, 0.1);
        let old = look(&room(0.0), &lidar, 720, &old_at, &mut noise);
        let new = look(&room(0.4), &lidar, 720, &old_at.compose(&truth), &mut noise);
        let robust = align_scans(&old, &new, &truth, &IcpParams::ROBUST);
        let all_points = align_scans(&old, &new, &robust.pose, &IcpParams::ALL_POINTS);
        robust_m.push(apart(&truth, &robust.pose).0);
        all_points_m.push(apart(&truth, &all_points.pose).0);
    }
    let (robust_m, least_m) = (quantile(&robust_m, 0.9), quantile(&all_points_m, 0.1));
    assert!(robust_m < 0.005, "{robust_m}");
    assert!(
        least_m > 0.02 && least_m > 8.0 * robust_m,
        "{least_m} {robust_m}"
    );
}

#[test]
fn where_nothing_moved_both_forms_agree() {
    let lidar = lidar(360, 720, Pose2::IDENTITY, SIGMA_M);
    let mut noise = Noise::new(4);
    let old_at = Pose2::new(-0.5, -0.3, 0.4);
    let truth = Pose2::new(0.1, -0.05, 0.06);
    let old = look(&room(0.0), &lidar, 720, &old_at, &mut noise);
    let new = look(&room(0.0), &lidar, 720, &old_at.compose(&truth), &mut noise);
    let robust = align_scans(&old, &new, &truth, &IcpParams::ROBUST);
    let all_points = align_scans(&old, &new, &robust.pose, &IcpParams::ALL_POINTS);
    let (shift_m, turn_rad) = apart(&robust.pose, &all_points.pose);
    assert!(shift_m < 0.008 && turn_rad < 0.003, "{shift_m} {turn_rad}");
}

#[test]
fn overlap_and_inliers_are_shares_of_the_points() {
    let lidar = lidar(360, 720, Pose2::IDENTITY, SIGMA_M);
    let mut noise = Noise::new(5);
    let box_room = World::new([Shape::rectangle(&Pose2::IDENTITY, 8.0, 6.0)]);
    let old = look(&box_room, &lidar, 720, &Pose2::IDENTITY, &mut noise);
    // The new view has a wall across it: half of its points lie 1.4 m off any old one.
    let split_room = World::new([
        Shape::rectangle(&Pose2::IDENTITY, 8.0, 6.0),
        Shape::rectangle(&Pose2::new(0.0, -2.0, 0.0), 7.98, 1.2),
    ]);
    let new = look(&split_room, &lidar, 720, &Pose2::IDENTITY, &mut noise);
    let found = align_scans(&old, &new, &Pose2::IDENTITY, &IcpParams::ROBUST);
    let points = surface_points(&new);
    let on_old_walls = points.iter().filter(|p| p.position.y > -1.3).count();
    let share = on_old_walls as f64 / points.len() as f64;
    assert!((found.overlap - share).abs() < 0.06, "{found:?} {share}");
    assert!(found.inlier_share > 0.85, "{found:?}");
    assert!((0.005..0.025).contains(&found.rmse_m), "{found:?}");
}
