//! Whether the stated information is the scatter that repeated matches have.

use mapshift::geometry::{Matrix3, Pose2, Vector3};
use mapshift::matching::{Estimate, IcpParams, ReferenceCloud, align};
use mapshift::scan::surface_points;
use mapshift::sim::Hall;

use crate::scans::{Noise, lidar, look};

/// Repeated matches near one place, with new noise and a new way between the two views each
/// time: truths and estimates.
fn repeated(sigma_m: f64, place_m: f64, count: usize) -> Vec<(Pose2, Estimate)> {
    let hall = Hall::generate(21).unwrap();
    let lidar = lidar(270, 541, Pose2::new(0.4, 0.0, 0.2), sigma_m);
    let mut noise = Noise::new(place_m as u64);
    let old_at = hall.route.pose_at(place_m);
    let pairs = (0..count).map(|_| {
        let truth = noise.on_rim(0.25, 0.15);
        let old = look(&hall.world, &lidar, 541, &old_at, &mut noise);
        let new_at = old_at.compose(&truth);
        let new = look(&hall.world, &lidar, 541, &new_at, &mut noise);
        let old = surface_points(&old);
        let cloud = ReferenceCloud::new([(Pose2::IDENTITY, old.as_slice())]).unwrap();
        let points = surface_points(&new);
        let found = align(&cloud, &points, &truth, sigma_m, None, &IcpParams::ROBUST);
        (truth, found)
    });
    pairs.collect()
}

/// eᵀΩe of an estimate's error in its own base frame, as an edge has it.
fn squared_error(truth: &Pose2, estimate: &Estimate) -> f64 {
    let error = Pose2::edge_error(&Pose2::IDENTITY, truth, &estimate.pose);
    estimate.information.squared_norm(&error)
}

#[test]
fn information_is_symmetric_and_positive_semidefinite() {
    for place_m in [0.0, 25.0, 50.0] {
        for (_, estimate) in repeated(0.01, place_m, 5) {
            let matrix = estimate.information.matrix();
            assert_eq!(matrix, &matrix.transpose());
            assert!(estimate.information.is_positive_semidefinite());
            assert_eq!(estimate.observable_directions, 3);
        }
    }
}

#[test]
fn information_foretells_the_scatter_of_repeated_matches() {
    for place_m in [5.0, 35.0, 65.0, 95.0] {
        let estimates = repeated(0.03, place_m, 60);
        let nees: f64 = estimates.iter().map(|(t, e)| squared_error(t, e)).sum();
        let per_coordinate = nees / (3.0 * estimates.len() as f64);
        // Each direction by itself too: no coordinate may pay for another.
        let mut scatter = Matrix3::zeros();
        let mut information = Matrix3::zeros();
        for (truth, estimate) in &estimates {
            let error = Pose2::edge_error(&Pose2::IDENTITY, truth, &estimate.pose);
            scatter += error * error.transpose() / estimates.len() as f64;
            information += estimate.information.matrix() / estimates.len() as f64;
        }
        let root = information.cholesky().unwrap().l();
        let ratios = (root.transpose() * scatter * root).symmetric_eigenvalues();
        // Within a factor of five as standard deviations, and never too sure: the floor stands for
        // errors that these scans do not have.
        let cautious = 1.0 / 25.0;
        assert!(
            (cautious..1.5).contains(&per_coordinate),
            "{per_coordinate}"
        );
        assert!(
            ratios.min() > cautious / 8.0 && ratios.max() < 2.0,
            "{ratios}"
        );
    }
}

#[test]
fn small_noise_is_never_believed_beyond_the_floor() {
    for place_m in [5.0, 35.0, 65.0] {
        let estimates = repeated(0.005, place_m, 20);
        for (_, estimate) in &estimates {
            let covariance = estimate.information.matrix().try_inverse().unwrap();
            assert!(covariance[(0, 0)].sqrt() > 0.003, "{covariance}");
            assert!(covariance[(2, 2)].sqrt() > 0.001, "{covariance}");
        }
        let worst = estimates.iter().map(|(t, e)| squared_error(t, e));
        assert!(worst.fold(0.0, f64::max) < 16.0);
    }
}

#[test]
fn information_is_in_the_frame_of_the_base() {
    // A narrow view of one wall ahead, taken by a base that is turned by 90° in the reference:
    // what is fixed is the way along the base's own x axis … and y, once the base looks aside.
    use mapshift::sim::{Shape, World};
    let world = World::new([Shape::rectangle(&Pose2::new(6.0, 0.0, 0.0), 4.0, 80.0)]);
    for (mount_rad, axis) in [
        (0.0, Vector3::new(1.0, 0.0, 0.0)),
        (-0.7, Vector3::new((-0.7_f64).cos(), (-0.7_f64).sin(), 0.0)),
    ] {
        let lidar = lidar(60, 61, Pose2::new(0.0, 0.0, mount_rad), 0.01);
        let mut noise = Noise::new(2);
        // The lidar looks along the map's x axis whatever the mount: at the wall, 4 m ahead.
        let at = Pose2::new(0.0, 0.0, -mount_rad);
        let scan = |noise: &mut Noise| surface_points(&look(&world, &lidar, 61, &at, noise));
        let (old, new) = (scan(&mut noise), scan(&mut noise));
        // The reference is a frame that is turned by a quarter against the old base.
        let reference_from_base = Pose2::new(3.0, 1.0, std::f64::consts::FRAC_PI_2);
        let cloud = ReferenceCloud::new([(reference_from_base, old.as_slice())]).unwrap();
        let params = &IcpParams::ROBUST;
        let found = align(&cloud, &new, &reference_from_base, 0.01, None, params);
        assert_eq!(found.observable_directions, 2, "{found:?}");
        let along = Vector3::new(-axis.y, axis.x, 0.0);
        let (across, along) = (
            found.information.squared_norm(&axis),
            found.information.squared_norm(&along),
        );
        assert!(across > 1e4 && along < 1e-2 * across, "{across} {along}");
    }
}
