//! Range scale, against a map that other vehicles have made.
//!
//! What a vehicle sees by itself does not show it. Scans whose ranges are all 2 % short match each
//! other as well as true ones, and show ways that are 2 % short; compared with the wheels, that is
//! a way scale ([`Quantity::WayScale`]), and whether wheels or ranges are wrong stays open. Against
//! the walls of a map of true size a scan shows it at once: a room is too small for it. If the map
//! is the vehicle's own, or its makers share the error, it shows nothing.
//!
//! Where both are known, the wheels' own factor is that of the way times that of the ranges.

use super::corrections::scaled;
use super::joint_match::{Moving, PoseSigmas, step_of_unknown};
use super::shared_value::{Measured, shared_value};
use super::{Estimate, Quantity};
use crate::geometry::{Pose2, Vector2};
use crate::matching::{IcpParams, ReferenceCloud, Termination, align};
use crate::scan::{LaserScan, SurfacePoint, surface_points};

/// A scan and what other vehicles know of the place.
#[derive(Clone, Copy)]
pub struct MapScan<'a> {
    /// The vehicle's.
    pub scan: &'a LaserScan,
    /// Points of scans of other vehicles, map frame.
    pub map: &'a ReferenceCloud,
    /// About where it was taken.
    pub map_from_base: Pose2,
}

/// Factors less one that a match is begun with if it finds none from 0: far walls are beyond the reach
/// of a match that begins 2 % off.
const STARTS: [f64; 8] = [0.02, -0.02, 0.04, -0.04, 0.06, -0.06, 0.08, -0.08];
const STEPS_MAX: usize = 12;
const STEP_TOLERANCE: f64 = 3e-4;
/// Factors beyond this are none.
const SCALE_MAX: f64 = 0.2;
/// A match with fewer inliers is none.
const INLIER_SHARE_MIN: f64 = 0.6;
/// Hardly anything: the scan itself fixes the pose.
const UNKNOWN_POSE: PoseSigmas = PoseSigmas {
    xy_m: 1.0,
    theta_rad: 0.5,
};

/// What scans of a trip, in the order of time, say of [`Quantity::RangeScale`]. `None` without
/// enough of them that match and have walls on several sides.
pub(super) fn range_scale(scans: &[MapScan<'_>]) -> Option<Estimate> {
    let measured: Vec<Measured> = scans.iter().filter_map(measured_by).collect();
    shared_value(Quantity::RangeScale, &measured)
}

fn measured_by(one: &MapScan<'_>) -> Option<Measured> {
    let nearby = fitted(one, 0.0);
    let best = nearby.or_else(|| {
        let all = STARTS.into_iter().filter_map(|start| fitted(one, start));
        all.max_by(|a, b| a.inlier_share.total_cmp(&b.inlier_share))
    });
    best.map(|fitted| fitted.measured)
}

/// What a match says, and how well it fits.
struct Fitted {
    measured: Measured,
    inlier_share: f64,
}

fn fitted(one: &MapScan<'_>, start: f64) -> Option<Fitted> {
    let lidar = one.scan.lidar();
    let eye = lidar.mount.translation();
    let (mut pose, mut scale) = (one.map_from_base, start);
    for _ in 0..STEPS_MAX {
        let scan = scaled(one.scan, lidar, 1.0 + scale).ok()?;
        let points = surface_points(&scan);
        let sigma_m = lidar.range_sigma_m;
        let estimate = align(one.map, &points, &pose, sigma_m, None, &IcpParams::ROBUST);
        if estimate.termination == Termination::TooFewPoints {
            return None;
        }
        pose = estimate.pose;
        let moving = Moving {
            point: |point: &SurfacePoint| (point.position - eye) / (1.0 + scale),
            place: |_: &Vector2<f64>| Vector2::zeros(),
        };
        let step = step_of_unknown(
            one.map,
            &points,
            &pose,
            &pose,
            &UNKNOWN_POSE,
            sigma_m,
            &moving,
        )?;
        scale += step.value;
        if scale.abs() > SCALE_MAX {
            return None;
        }
        if step.value.abs() < STEP_TOLERANCE {
            let inlier_share = estimate.inlier_share;
            return (inlier_share >= INLIER_SHARE_MIN).then_some(Fitted {
                measured: Measured {
                    value: scale,
                    information: step.information,
                },
                inlier_share,
            });
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::Corrections;
    use crate::calibration::testing::drive_with;
    use crate::sim::{Hall, Scene, Vehicle};
    use std::sync::Arc;

    #[test]
    fn another_vehicle_s_map_shows_the_scale() {
        let sound = Corrections::default();
        let (maker, vehicle) = (drive_with(&sound, 4, 1), drive_with(&sound, 4, 2));
        let points: Vec<_> = maker.scans().map(surface_points).collect();
        let placed = maker.truth.iter().zip(&points);
        let map = ReferenceCloud::new(placed.map(|(pose, p)| (*pose, p.as_slice()))).unwrap();
        for factor in [0.97, 1.0, 1.02] {
            let scans = vehicle
                .scans()
                .map(|scan| scaled(scan, scan.lidar(), 1.0 / factor).unwrap());
            let scans: Vec<_> = scans.collect();
            let placed = scans.iter().zip(&vehicle.truth).step_by(3);
            let placed: Vec<_> = placed
                .map(|(scan, pose)| MapScan {
                    scan,
                    map: &map,
                    map_from_base: *pose,
                })
                .collect();
            let found = range_scale(&placed).unwrap();
            let off = found.value - (factor - 1.0);
            assert!(off.abs() < 4.0 * found.sigma, "{factor}: {found:?}");
            assert!(found.sigma < 0.01, "{factor}: {found:?}");
        }
        assert_eq!(range_scale(&[]), None);
    }

    /// Walls are up to 30 m away, where 3 % are 0.9 m.
    #[test]
    fn a_lidar_that_sees_far_shows_it_too() {
        let hall = Hall::generate(1).unwrap();
        let scene = Scene::lasting(hall.route, hall.world.shapes().cloned(), 0);
        let (maker, vehicle) = (Vehicle::of_fleet(0, 0.3), Vehicle::of_fleet(2, 0.3));
        let drive = |vehicle: &Vehicle, seed| scene.drive(vehicle, 1..2, seed);
        let scans_of = |vehicle: &Vehicle, factor: f64, seed| {
            let lidar = Arc::new(vehicle.lidar.geometry.clone());
            let scans = drive(vehicle, seed)
                .into_iter()
                .step_by(20)
                .map(move |seen| {
                    let scan = LaserScan::new(lidar.clone(), seen.ranges_m).unwrap();
                    let scan = scaled(&scan, &lidar, 1.0 / factor).unwrap();
                    (seen.map_from_base, scan)
                });
            scans.collect::<Vec<_>>()
        };
        let points = scans_of(&maker, 1.0, 3);
        let points: Vec<_> = points
            .iter()
            .map(|(pose, scan)| (*pose, surface_points(scan)))
            .collect();
        let placed = points
            .iter()
            .map(|(pose, points)| (*pose, points.as_slice()));
        let map = ReferenceCloud::new(placed).unwrap();
        for factor in [0.95, 0.97, 1.0, 1.03, 1.06] {
            let scans = scans_of(&vehicle, factor, 4);
            let placed = scans.iter().map(|(map_from_base, scan)| MapScan {
                scan,
                map: &map,
                map_from_base: *map_from_base,
            });
            let found = range_scale(&placed.collect::<Vec<_>>()).unwrap();
            let off = found.value - (factor - 1.0);
            assert!(off.abs() < 0.002, "{factor}: {found:?}");
        }
    }
}
