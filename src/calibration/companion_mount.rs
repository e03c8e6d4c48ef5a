//! Where a companion's lidar sits beside the primary one, by what both see of the same places.

use nalgebra::Vector3;

use super::blocks::{Block, block_count, sigmas};
use super::motion_terms::median;
use super::{Estimate, Estimates, Quantity, TripCalibration};
use crate::geometry::{Matrix3, Pose2, wrap_angle};
use crate::matching::{IcpParams, ReferenceCloud, Termination, align};
use crate::scan::{LaserScan, SurfacePoint, surface_points};

/// A companion's scan among scans of the primary lidar that show the same places.
pub struct CompanionScan<'a> {
    /// With the mount as it is stated.
    pub scan: &'a LaserScan,
    /// What the primary lidar saw around, each with the pose of its base in the frame of the base
    /// at the companion's scan.
    pub around: Vec<(Pose2, &'a [SurfacePoint])>,
}

/// Fewest scans that show a mount.
const SCANS_MIN: usize = 8;
/// Least share of a scan's points with a counterpart, and of those that agree with it.
const OVERLAP_MIN: f64 = 0.3;
const INLIER_SHARE_MIN: f64 = 0.6;
/// Matches farther off are wrong: metres and radians.
const OFF_MAX_M: f64 = 0.4;
const OFF_MAX_RAD: f64 = 0.3;
const STEPS: usize = 10;
/// A scan so many standard deviations off counts half (Cauchy).
const CAUCHY_SCALE: f64 = 3.0;
/// The median length of three normal numbers.
const MEDIAN_LENGTH: f64 = 1.538;

const QUANTITIES: [Quantity; 3] = [Quantity::MountX, Quantity::MountY, Quantity::MountYaw];

/// What one scan says of the mount: how far ahead, to the left and turned the lidar sits.
struct Measured {
    off: Vector3<f64>,
    information: Matrix3<f64>,
}

impl TripCalibration {
    /// How far a companion's lidar sits from where its stated mount has it, taken that the primary
    /// one's mount is as stated; of the scans of one companion, in the order of time.
    pub fn of_companion<'a>(scans: impl Iterator<Item = CompanionScan<'a>>) -> Self {
        let measured: Vec<Measured> = scans.filter_map(|scan| scan.measured()).collect();
        Self {
            estimates: estimates(&measured),
            ..Self::default()
        }
    }
}

impl CompanionScan<'_> {
    fn measured(&self) -> Option<Measured> {
        let reference = ReferenceCloud::new(self.around.iter().copied())?;
        let lidar = self.scan.lidar();
        let (points, sigma_m) = (surface_points(self.scan), lidar.range_sigma_m);
        let stated = Pose2::IDENTITY;
        let matched = align(
            &reference,
            &points,
            &stated,
            sigma_m,
            None,
            &IcpParams::ROBUST,
        );
        let off = &matched.pose;
        let is_good = matched.termination != Termination::TooFewPoints
            && matched.observable_directions == 3
            && matched.overlap >= OVERLAP_MIN
            && matched.inlier_share >= INLIER_SHARE_MIN
            && off.translation().norm() <= OFF_MAX_M
            && off.theta.abs() <= OFF_MAX_RAD;
        if !is_good {
            return None;
        }
        // The match moves the base; the lidar sits away from it, and a turn of the base shifts it.
        let (mount, seen) = (&lidar.mount, off.compose(&lidar.mount));
        let base_from_mount = Matrix3::new(
            1.0, 0.0, mount.y, //
            0.0, 1.0, -mount.x, //
            0.0, 0.0, 1.0,
        );
        let turned = wrap_angle(seen.theta - mount.theta);
        Some(Measured {
            off: Vector3::new(seen.x - mount.x, seen.y - mount.y, turned),
            information: base_from_mount.transpose()
                * matched.information.matrix()
                * base_from_mount,
        })
    }
}

/// The robust weighted mean, its error by blocks of scans in the order of time.
fn estimates(measured: &[Measured]) -> Estimates {
    if measured.len() < SCANS_MIN {
        return Estimates::new();
    }
    let middle = |k: usize| median(measured.iter().map(|one| one.off[k]).collect());
    let mut mean = Vector3::new(middle(0), middle(1), middle(2));
    let length2 = |one: &Measured, mean: &Vector3<f64>| {
        let off = one.off - mean;
        off.dot(&(one.information * off))
    };
    let mut scale = 1.0;
    let block = |measured: &[Measured], mean: &Vector3<f64>, scale: f64| {
        let mut block = Block::<3>::EMPTY;
        for one in measured {
            let far2 = length2(one, mean) / (scale * scale * CAUCHY_SCALE * CAUCHY_SCALE);
            let weight = one.information / (scale * scale * (1.0 + far2));
            block.add(&Block {
                hessian: weight,
                gradient: weight * (mean - one.off),
            });
        }
        block
    };
    for _ in 0..STEPS {
        let lengths = measured.iter().map(|one| length2(one, &mean).sqrt());
        scale = (median(lengths.collect()) / MEDIAN_LENGTH).max(1e-6);
        let whole = block(measured, &mean, scale);
        let Some(inverse) = whole.hessian.try_inverse() else {
            return Estimates::new();
        };
        mean -= inverse * whole.gradient;
    }
    let size = measured.len().div_ceil(block_count(measured.len())).max(1);
    let blocks: Vec<_> = measured
        .chunks(size)
        .map(|measured| block(measured, &mean, scale))
        .collect();
    let sigmas = sigmas(&blocks, &Vector3::repeat(1e-9));
    let estimate = |k: usize| Estimate::known(QUANTITIES[k], mean[k], sigmas[k]);
    let known = (0..3).filter_map(|k| Some((QUANTITIES[k], estimate(k)?)));
    known.collect()
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::sim::{Hall, OdometryError, Scene, SimLidar, SimScan, Vehicle};

    const SCANS: usize = 120;

    fn scans(driven: &[SimScan], lidar: &SimLidar) -> Vec<LaserScan> {
        let stated = Arc::new(lidar.geometry.clone());
        let scans = driven.iter();
        let scans =
            scans.map(|scan| LaserScan::new(stated.clone(), scan.ranges_m.clone()).unwrap());
        scans.collect()
    }

    /// What a lap shows of a rear lidar that sits so far from where it should.
    fn found(mount_error: Pose2, seed: u64) -> Estimates {
        let [front, rear] = SimLidar::front_and_rear(std::f64::consts::PI, 181, 15.0, 0.01);
        let rear = SimLidar {
            mount_error,
            ..rear
        };
        let vehicle = Vehicle {
            lidar: front.clone(),
            odometry: OdometryError {
                scale: 0.0,
                yaw_drift_rad_per_m: 0.0,
                sigma_xy_m: 0.0,
                sigma_theta_rad: 0.0,
            },
            path_noise_m: 0.3,
            scan_spacing_m: 0.5,
            speed_mps: 1.0,
        };
        let scene = Scene::of_hall(&Hall::generate(seed).unwrap(), 0);
        let ahead = scene.drive(&vehicle, 1..2, seed);
        let back = scene.drive_of_companion(&vehicle, (1, &rear), 1..2, seed);
        let (seen, seen_back) = (scans(&ahead, &front), scans(&back, &rear));
        let points: Vec<_> = seen.iter().map(surface_points).collect();
        let around = |k: usize| {
            let others = k.saturating_sub(12)..(k + 13).min(points.len());
            let others = others.step_by(2).map(|other| {
                let pose = ahead[k].map_from_base.between(&ahead[other].map_from_base);
                (pose, points[other].as_slice())
            });
            others.collect()
        };
        let companions = (0..SCANS).step_by(2).map(|k| CompanionScan {
            scan: &seen_back[k],
            around: around(k),
        });
        TripCalibration::of_companion(companions).estimates
    }

    #[test]
    fn a_mount_that_is_off_is_measured_and_a_sound_one_too() {
        // Seen from the rear lidar, which points back: ahead of it is behind it for the vehicle.
        let errors = [
            (Pose2::IDENTITY, [0.0, 0.0, 0.0]),
            (Pose2::new(0.05, -0.03, 0.03), [-0.05, 0.03, 0.03]),
        ];
        for (seed, (error, truth)) in [(3, errors[0]), (4, errors[1]), (5, errors[1])] {
            let found_all = found(error, seed);
            for (quantity, truth) in QUANTITIES.into_iter().zip(truth) {
                let Estimate { value, sigma } = found_all[&quantity];
                let found = format!("{seed} {quantity:?}: {value} ± {sigma}, not {truth}");
                assert!((value - truth).abs() < 3.0 * sigma, "{found}");
                assert!(sigma < 2.0 * quantity.floor(), "{found}");
            }
        }
    }

    #[test]
    fn a_few_scans_say_nothing() {
        let none = TripCalibration::of_companion(std::iter::empty());
        assert_eq!(none, TripCalibration::default());
    }
}
