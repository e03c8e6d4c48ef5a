//! Corridors, empty scans, priors.

use mapshift::geometry::{Information, Pose2, Vector3};
use mapshift::matching::{Estimate, IcpParams, Prior, ReferenceCloud, Termination, align};
use mapshift::scan::{SurfacePoint, surface_points};
use mapshift::sim::{Shape, World};

use crate::scans::{Noise, lidar, look};

/// Two parallel walls whose ends are out of sight.
fn corridor() -> World {
    World::new([Shape::rectangle(&Pose2::IDENTITY, 400.0, 3.0)])
}

/// Views of the corridor 0.3 m apart along it.
fn corridor_views(seed: u64) -> (ReferenceCloud, Vec<SurfacePoint>, Pose2) {
    let lidar = lidar(360, 720, Pose2::new(0.2, 0.0, 0.0), 0.01);
    let mut noise = Noise::new(seed);
    let old_at = Pose2::new(1.0, 0.2, 0.05);
    let truth = Pose2::new(0.3, 0.05, -0.03);
    let old = surface_points(&look(&corridor(), &lidar, 720, &old_at, &mut noise));
    let new_at = old_at.compose(&truth);
    let new = surface_points(&look(&corridor(), &lidar, 720, &new_at, &mut noise));
    let cloud = ReferenceCloud::new([(Pose2::IDENTITY, old.as_slice())]).unwrap();
    (cloud, new, truth)
}

/// The corridor's direction and the one across it, in the base frame of an estimate.
fn directions(pose: &Pose2) -> (Vector3<f64>, Vector3<f64>) {
    let (sin, cos) = (-0.05 - pose.theta).sin_cos();
    (Vector3::new(cos, sin, 0.0), Vector3::new(-sin, cos, 0.0))
}

/// How far an estimate lies from the truth along the corridor and across it, metres.
fn errors(truth: &Pose2, found: &Estimate) -> (f64, f64) {
    let error = truth.between(&found.pose);
    let error = Vector3::new(error.x, error.y, 0.0);
    let (along, across) = directions(truth);
    (along.dot(&error), across.dot(&error))
}

#[test]
fn along_a_corridor_the_start_stays() {
    for seed in 0..10 {
        let (cloud, points, truth) = corridor_views(seed);
        let (along, across) = directions(&truth);
        let off = along * 0.25 + across * 0.1;
        let start = truth.compose(&Pose2::new(off.x, off.y, 0.05));
        let found = align(&cloud, &points, &start, 0.01, None, &IcpParams::ROBUST);
        assert_eq!(found.termination, Termination::Converged, "{found:?}");
        assert_eq!(found.observable_directions, 2, "{found:?}");
        let (along_m, across_m) = errors(&truth, &found);
        let turn_rad = truth.between(&found.pose).theta;
        assert!((along_m - 0.25).abs() < 0.02, "{along_m}");
        assert!(
            across_m.abs() < 0.004 && turn_rad.abs() < 0.002,
            "{across_m} {turn_rad}"
        );
        let (along, across) = directions(&found.pose);
        let information = &found.information;
        let (free, fixed) = (
            information.squared_norm(&along),
            information.squared_norm(&across),
        );
        assert!(free < 1e-3 * fixed && fixed > 1e4, "{free} {fixed}");
        assert!(information.is_positive_semidefinite());
    }
}

#[test]
fn a_prior_pulls_along_a_corridor_and_nowhere_else() {
    for (seed, sigma_m) in [(0, 0.05), (1, 0.1), (2, 0.2)] {
        let (cloud, points, truth) = corridor_views(seed);
        let (along, across) = directions(&truth);
        let off = |along_m: f64, across_m: f64, turn_rad: f64| {
            let off = along * along_m + across * across_m;
            truth.compose(&Pose2::new(off.x, off.y, turn_rad))
        };
        let prior = Prior {
            pose: off(-0.1, 0.05, 0.02),
            information: Information::from_sigmas(sigma_m, 0.06),
        };
        let start = off(0.2, -0.05, -0.03);
        let params = &IcpParams::ROBUST;
        let found = align(&cloud, &points, &start, 0.01, Some(&prior), params);
        let (along_m, across_m) = errors(&truth, &found);
        assert!((along_m - -0.1).abs() < 0.02, "{along_m}");
        assert!(across_m.abs() < 0.004, "{across_m}");
        let without = align(&cloud, &points, &found.pose, 0.01, None, params);
        assert_eq!(found.observable_directions, 2);
        let (free, _) = directions(&found.pose);
        let said = found.information.squared_norm(&free);
        assert!(
            said < 0.1 / (sigma_m * sigma_m),
            "the points' alone: {said}"
        );
        let difference = found.information.matrix() - without.information.matrix();
        assert!(difference.norm() < 0.05 * found.information.matrix().norm());
    }
}

#[test]
fn a_strong_prior_holds_and_a_weak_one_lets_go() {
    let lidar = lidar(360, 720, Pose2::IDENTITY, 0.01);
    let world = World::new([
        Shape::rectangle(&Pose2::IDENTITY, 9.0, 7.0),
        Shape::rectangle(&Pose2::new(2.0, 1.0, 0.3), 1.0, 1.0),
    ]);
    let mut noise = Noise::new(8);
    let scan =
        |noise: &mut Noise| surface_points(&look(&world, &lidar, 720, &Pose2::IDENTITY, noise));
    let (old, new) = (scan(&mut noise), scan(&mut noise));
    let cloud = ReferenceCloud::new([(Pose2::IDENTITY, old.as_slice())]).unwrap();
    let off = Pose2::new(0.04, 0.0, 0.0);
    let with = |sigma_m: f64| {
        let prior = Prior {
            pose: off,
            information: Information::from_sigmas(sigma_m, 0.05),
        };
        align(&cloud, &new, &off, 0.01, Some(&prior), &IcpParams::ROBUST)
            .pose
            .x
    };
    assert!(with(0.2).abs() < 0.003, "{}", with(0.2));
    assert!((with(1e-4) - 0.04).abs() < 0.001, "{}", with(1e-4));
    assert!(with(1e-2) > with(0.1));
}

#[test]
fn too_few_points_leave_the_start_and_say_nothing() {
    let lidar = lidar(360, 360, Pose2::IDENTITY, 0.01);
    let mut noise = Noise::new(6);
    let world = World::new([Shape::rectangle(&Pose2::IDENTITY, 6.0, 5.0)]);
    let scan = look(&world, &lidar, 360, &Pose2::IDENTITY, &mut noise);
    let points = surface_points(&scan);
    let cloud = ReferenceCloud::new([(Pose2::IDENTITY, points.as_slice())]).unwrap();
    let start = Pose2::new(0.1, 0.2, 0.3);
    let far = Pose2::new(100.0, 0.0, 0.0);
    for params in [IcpParams::ROBUST, IcpParams::ALL_POINTS] {
        let cases: [(&[SurfacePoint], &Pose2); 3] =
            [(&[], &start), (&points[..11], &start), (&points, &far)];
        for (points, start) in cases {
            let found = align(&cloud, points, start, 0.01, None, &params);
            assert_eq!(found.termination, Termination::TooFewPoints);
            assert_eq!(found.pose, *start);
            assert_eq!(found.information, Information::from_upper([0.0; 6]));
            assert_eq!(found.observable_directions, 0);
            assert!(found.rmse_m.is_finite());
        }
    }
    assert!(ReferenceCloud::new([(start, [].as_slice())]).is_none());
}

#[test]
fn points_that_lose_their_counterparts_on_the_way_leave_the_start() {
    // Twenty points 0.6 m beside a wall's stub: pairs at first, none within the last gate.
    let line = |y: f64, normal| -> Vec<SurfacePoint> {
        (0..20)
            .map(|k| SurfacePoint {
                position: mapshift::geometry::Vector2::new(0.05 * f64::from(k), y),
                normal,
                beam: k as usize,
                range_m: 1.0,
            })
            .collect()
    };
    let east = Some(mapshift::geometry::Vector2::new(1.0, 0.0));
    let (old, new) = (line(0.0, east), line(0.6, east));
    let cloud = ReferenceCloud::new([(Pose2::IDENTITY, old.as_slice())]).unwrap();
    let start = Pose2::new(0.02, 0.0, 0.0);
    let found = align(&cloud, &new, &start, 0.01, None, &IcpParams::ROBUST);
    assert_eq!(found.termination, Termination::TooFewPoints);
    assert_eq!(found.pose, start);
    assert_eq!(found.information, Information::from_upper([0.0; 6]));
}

#[test]
fn a_cloud_of_many_equal_points_is_searched() {
    let point = SurfacePoint {
        position: mapshift::geometry::Vector2::new(1.0, 2.0),
        normal: None,
        beam: 0,
        range_m: 2.2,
    };
    let points = vec![point; 500];
    let cloud = ReferenceCloud::new([(Pose2::IDENTITY, points.as_slice())]).unwrap();
    assert_eq!(cloud.len(), 500);
    let near = mapshift::geometry::Vector2::new(1.2, 2.0);
    assert!(cloud.nearest(&near, 0.25).is_some());
    assert!(cloud.nearest(&near, 0.15).is_none());
    let found = align(
        &cloud,
        &points,
        &Pose2::new(0.1, 0.0, 0.0),
        0.01,
        None,
        &IcpParams::ROBUST,
    );
    assert!(found.pose.is_finite() && found.information.is_positive_semidefinite());
}
