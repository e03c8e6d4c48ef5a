//! Beam spacing by straight walls: seen with a wrong spacing, a straight wall is bent.
//!
//! A wall at a distance h whose normal has the bearing α ends a beam of bearing φ at h / cos(φ − α),
//! so that over the beams of one wall 1/r = a·cos(fψ) + b·sin(fψ), with ψ the stated angle from the
//! wall's middle beam and f what the stated spacing is to be multiplied by. Three unknowns for many
//! beams; the scale of the ranges goes into a and b and does not bend anything.

use super::shared_value::{Measured, shared_value};
use super::{Estimate, Quantity};
use crate::geometry::{Matrix3, Vector3};
use crate::scan::{LaserScan, SurfacePoint, surface_points};

/// Cosine of the most that the normals of two neighbouring points of a wall differ by.
const NEIGHBOURS_COSINE_MIN: f64 = 0.92;
/// Points of a wall lie no farther apart than so many beam spacings, nor than this, metres.
const GAP_SPACINGS: f64 = 8.0;
const GAP_MIN_M: f64 = 0.15;
/// A corner rounds the ends of a wall by so many points.
const END_POINTS: usize = 2;
/// Fewest points of a wall.
const POINTS_MIN: usize = 20;
/// Least angle that a wall fills, radians.
const SPAN_MIN_RAD: f64 = 0.7;
/// Largest root mean square distance of a wall's ranges, standard deviations of a range and metres.
const RMS_MAX_SIGMAS: f64 = 1.7;
const RMS_SLACK_M: f64 = 0.003;
const STEPS: usize = 8;
/// A wall that leaves the factor more uncertain than this says nothing of it.
const SIGMA_MAX: f64 = 0.04;
/// Factors beyond this are none.
const SPACING_MAX: f64 = 0.25;

/// What the straight walls in a trip's scans (in the order of time) say of [`Quantity::BeamSpacing`].
/// `None` without enough long walls.
pub fn spacing_by_walls<'a>(scans: impl IntoIterator<Item = &'a LaserScan>) -> Option<Estimate> {
    let measured: Vec<Measured> = scans.into_iter().flat_map(by_scan).collect();
    shared_value(Quantity::BeamSpacing, &measured)
}

fn by_scan(scan: &LaserScan) -> Vec<Measured> {
    let spacing_rad = scan.lidar().angle_increment_rad;
    let points = surface_points(scan);
    let mut walls = Vec::new();
    let mut from = 0;
    for k in 1..=points.len() {
        if k < points.len() && is_one_wall(&points[k - 1], &points[k], spacing_rad) {
            continue;
        }
        if k - from > 2 * END_POINTS {
            let wall = &points[from + END_POINTS..k - END_POINTS];
            walls.extend(by_wall(wall, spacing_rad, scan.lidar().range_sigma_m));
        }
        from = k;
    }
    walls
}

fn is_one_wall(before: &SurfacePoint, point: &SurfacePoint, spacing_rad: f64) -> bool {
    let (Some(normal_before), Some(normal)) = (before.normal, point.normal) else {
        return false;
    };
    let gap_m = (GAP_SPACINGS * spacing_rad * point.range_m).max(GAP_MIN_M);
    point.beam - before.beam <= 2
        && normal_before.dot(&normal) >= NEIGHBOURS_COSINE_MIN
        && (point.position - before.position).norm() <= gap_m
}

/// What one wall says: its own fit of (a, b, f).
fn by_wall(wall: &[SurfacePoint], spacing_rad: f64, range_sigma_m: f64) -> Option<Measured> {
    let (first, last) = (wall.first()?.beam, wall.last()?.beam);
    let span_rad = (last - first) as f64 * spacing_rad;
    if wall.len() < POINTS_MIN || span_rad < SPAN_MIN_RAD {
        return None;
    }
    let middle = 0.5 * (first + last) as f64;
    let angles_rad = wall.iter().map(|p| (p.beam as f64 - middle) * spacing_rad);
    let beams: Vec<(f64, f64)> = angles_rad.zip(wall.iter().map(|p| p.range_m)).collect();
    // Starts as a wall straight ahead; a and b are linear and right after one step.
    let mut fitted = Vector3::new(1.0 / wall[wall.len() / 2].range_m, 0.0, 1.0);
    for _ in 0..STEPS {
        let (hessian, gradient, _) = equations(&beams, &fitted);
        fitted -= hessian.cholesky()?.solve(&gradient);
        if (fitted.z - 1.0).abs() > SPACING_MAX {
            return None;
        }
    }
    let (hessian, _, squares_m2) = equations(&beams, &fitted);
    let rms_m = (squares_m2 / beams.len() as f64).sqrt();
    let variance = range_sigma_m.max(rms_m).powi(2) * hessian.try_inverse()?[(2, 2)];
    let is_wall = rms_m <= RMS_MAX_SIGMAS * range_sigma_m + RMS_SLACK_M;
    let says = is_wall && variance > 0.0 && variance <= SIGMA_MAX * SIGMA_MAX;
    says.then_some(Measured {
        value: fitted.z - 1.0,
        information: 1.0 / variance,
    })
}

/// H, g and the sum of squares of the range errors of (stated angle, range) by (a, b, f).
fn equations(beams: &[(f64, f64)], fitted: &Vector3<f64>) -> (Matrix3<f64>, Vector3<f64>, f64) {
    let (mut hessian, mut gradient, mut squares) = (Matrix3::zeros(), Vector3::zeros(), 0.0);
    for (angle_rad, range_m) in beams {
        let (sin, cos) = (fitted.z * angle_rad).sin_cos();
        // An error of 1/r is one of r, times −r².
        let to_range = range_m * range_m;
        let error = to_range * (fitted.x * cos + fitted.y * sin) - range_m;
        let by_factor = angle_rad * (fitted.y * cos - fitted.x * sin);
        let derivative = to_range * Vector3::new(cos, sin, by_factor);
        hessian += derivative * derivative.transpose();
        gradient += derivative * error;
        squares += error * error;
    }
    (hessian, gradient, squares)
}

#[cfg(test)]
mod tests {
    use std::f64::consts::{FRAC_PI_2, PI};
    use std::sync::Arc;

    use super::*;
    use crate::geometry::Pose2;
    use crate::scan::Lidar;

    /// A lidar of 180° beside one wall, whose beams are so many times as far apart as it states.
    fn beside_a_wall(factor: f64, distance_m: f64, bearing_rad: f64) -> LaserScan {
        let lidar = Lidar {
            angle_min_rad: -FRAC_PI_2,
            angle_increment_rad: PI / 360.0,
            range_min_m: 0.05,
            range_max_m: 12.0,
            mount: Pose2::new(0.1, 0.0, 0.2),
            range_sigma_m: 0.01,
            band: None,
        };
        let noise_m = |k: usize| 0.017 * (((k * k) as f64 * 0.618_034).fract() * 2.0 - 1.0);
        let ranges: Vec<_> = (0..361)
            .map(|k| {
                let cosine = (factor * lidar.beam_angle_rad(k) - bearing_rad).cos();
                Some(distance_m / cosine + noise_m(k)).filter(|_| cosine > 0.2)
            })
            .collect();
        LaserScan::new(Arc::new(lidar), ranges).unwrap()
    }

    #[test]
    fn a_wrong_spacing_bends_walls() {
        for factor in [0.9, 0.97, 1.0, 1.05, 1.1] {
            let scans: Vec<_> = (0..40)
                .map(|k| {
                    beside_a_wall(factor, 1.0 + 0.02 * f64::from(k), 0.5 - 0.02 * f64::from(k))
                })
                .collect();
            let found = spacing_by_walls(&scans).unwrap();
            let off = found.value - (factor - 1.0);
            assert!(off.abs() < 4.0 * found.sigma, "{factor}: {found:?}");
            assert!(off.abs() < 0.01 && found.sigma < 0.015, "{found:?}");
        }
    }

    #[test]
    fn without_walls_nothing_is_known() {
        assert_eq!(spacing_by_walls([]), None);
        // A round room, seen from its middle.
        let lidar = beside_a_wall(1.0, 1.0, 0.0).lidar().clone();
        let round = LaserScan::new(lidar, vec![Some(3.0); 361]).unwrap();
        assert_eq!(spacing_by_walls(std::iter::repeat_n(&round, 40)), None);
    }
}
