//! From the scans of a trip to what they say of its vehicle.

use std::sync::Arc;

use super::{
    Corrections, Motions, OdometryTrack, Quantity, ScanMotion, ScanPair, Spacing, TripCalibration,
    is_complete,
};
use crate::geometry::Pose2;
use crate::ids::StampNs;
use crate::matching::{IcpParams, ReferenceCloud, Termination, align};
use crate::scan::{LaserScan, Lidar, SurfacePoint, surface_points};

/// A scan of a trip as it was sent.
#[derive(Debug, Clone)]
pub struct TripScan {
    /// When it was taken.
    pub stamp: StampNs,
    /// In the odometry frame.
    pub odom_from_base: Pose2,
    /// Of the lidar as stated.
    pub scan: LaserScan,
}

/// Way between the scans of a pair that shows the beam spacing, metres …
const PAIR_WAY_M: std::ops::Range<f64> = 0.4..1.6;
/// … and turn, radians.
const PAIR_TURN_RAD: std::ops::Range<f64> = 0.1..0.9;
/// A pair begins no farther back than this, metres.
const PAIR_BACK_MAX_M: f64 = 1.2;
/// So many pairs are matched.
const PAIRS_MAX: usize = 120;
/// Way between two scans whose walls are compared, metres.
const WALLS_EVERY_M: f64 = 0.4;
/// Least share of a match's points with a counterpart, and of those that agree with it.
const OVERLAP_MIN: f64 = 0.5;
const INLIER_SHARE_MIN: f64 = 0.75;
/// Matches farther from the odometry are wrong: metres and radians.
const OFF_MAX_M: f64 = 0.4;
const OFF_MAX_RAD: f64 = 0.4;

impl TripCalibration {
    /// Of the scans of one trip, in the order of time, all of one lidar as stated: the beam spacing
    /// first, then the motions, matched from scan to scan with the beams where they truly are. About
    /// half a millisecond a scan.
    pub fn of_scans(scans: &[TripScan]) -> Self {
        let Some(first) = scans.first() else {
            return Self::default();
        };
        let stated = first.scan.lidar();
        let walls = walls_of(scans);
        let spacing = Spacing::of(walls, &pairs_of(scans));
        let corrected = spacing.significant().and_then(|spacing| {
            let correction = Corrections::default().with(Quantity::BeamSpacing, spacing.value);
            correction.lidar(stated, first.scan.beam_count()).ok()
        });
        let lidar = corrected.map_or_else(|| stated.clone(), Arc::new);
        Self::of(&matched_motions(scans, &lidar), Some(&spacing))
    }
}

/// The motions of a trip from scan to scan; `lidar` is that of the scans with the beam spacing that
/// is believed.
pub fn matched_motions(scans: &[TripScan], lidar: &Arc<Lidar>) -> Motions {
    let odometry = OdometryTrack::through(scans.iter().map(|s| (s.stamp, s.odom_from_base)));
    let mut by_scans = Vec::new();
    let mut last: Option<(&TripScan, Vec<SurfacePoint>)> = None;
    for scan in scans {
        let Some((from, from_points)) = &last else {
            last = points_of(scan, lidar).map(|points| (scan, points));
            continue;
        };
        let by_wheels = from.odom_from_base.between(&scan.odom_from_base);
        if !is_complete(&by_wheels) {
            continue;
        }
        let Some(points) = points_of(scan, lidar) else {
            continue;
        };
        by_scans.extend(
            matched(from_points, &points, &by_wheels, lidar).map(|estimate| ScanMotion {
                from: from.stamp,
                to: scan.stamp,
                motion: estimate.pose,
                information: estimate.information,
            }),
        );
        last = Some((scan, points));
    }
    Motions::new(lidar.mount, odometry, by_scans)
}

fn points_of(scan: &TripScan, lidar: &Arc<Lidar>) -> Option<Vec<SurfacePoint>> {
    let scan = LaserScan::from_ticks(lidar.clone(), scan.scan.ticks()).ok()?;
    Some(surface_points(&scan))
}

fn matched(
    from: &[SurfacePoint],
    to: &[SurfacePoint],
    by_wheels: &Pose2,
    lidar: &Lidar,
) -> Option<crate::matching::Estimate> {
    let reference = ReferenceCloud::new([(Pose2::IDENTITY, from)])?;
    let params = IcpParams::ROBUST;
    let estimate = align(
        &reference,
        to,
        by_wheels,
        lidar.range_sigma_m,
        None,
        &params,
    );
    let off = by_wheels.between(&estimate.pose);
    let is_good = estimate.termination != Termination::TooFewPoints
        && estimate.observable_directions == 3
        && estimate.overlap >= OVERLAP_MIN
        && estimate.inlier_share >= INLIER_SHARE_MIN
        && off.translation().norm() <= OFF_MAX_M
        && off.theta.abs() <= OFF_MAX_RAD;
    is_good.then_some(estimate)
}

/// Scans some way apart.
fn walls_of(scans: &[TripScan]) -> Vec<&LaserScan> {
    let mut walls: Vec<&LaserScan> = Vec::new();
    let mut last: Option<Pose2> = None;
    for scan in scans {
        let here = scan.odom_from_base;
        let way_m = last.map_or(f64::INFINITY, |last| {
            last.between(&here).translation().norm()
        });
        if way_m >= WALLS_EVERY_M {
            walls.push(&scan.scan);
            last = Some(here);
        }
    }
    walls
}

/// Pairs of scans between which the vehicle has turned on its way, spread over the trip.
fn pairs_of(scans: &[TripScan]) -> Vec<ScanPair<'_>> {
    let mut pairs = Vec::new();
    let mut start = 0;
    for (k, to) in scans.iter().enumerate() {
        while start < k {
            let from = &scans[start];
            let motion = from.odom_from_base.between(&to.odom_from_base);
            let (way_m, turn_rad) = (motion.translation().norm(), motion.theta.abs());
            if PAIR_WAY_M.contains(&way_m) && PAIR_TURN_RAD.contains(&turn_rad) {
                let (from, to) = (&from.scan, &to.scan);
                pairs.push(ScanPair { from, to, motion });
                start = k;
            } else if way_m >= PAIR_BACK_MAX_M || turn_rad >= PAIR_TURN_RAD.end {
                start += 1;
            } else {
                break;
            }
        }
    }
    let every = pairs.len().div_ceil(PAIRS_MAX).max(1);
    pairs.into_iter().step_by(every).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::testing::{drive_of, drive_with, stated_lidar};

    #[test]
    fn scans_alone_are_enough() {
        let truth = Corrections::default()
            .with(Quantity::MountYaw, 0.03)
            .with(Quantity::BeamSpacing, -0.05);
        let trip = TripCalibration::of_scans(&drive_with(&truth, 3, 3).scans);
        let yaw = trip.estimates[&Quantity::MountYaw];
        assert!((yaw.value - 0.03).abs() < 4.0 * yaw.sigma, "{trip:?}");
        let spacing = trip.estimates[&Quantity::BeamSpacing];
        assert!((spacing.value + 0.05).abs() < 0.005, "{trip:?}");
        assert!(trip.faults.is_empty());
        assert_eq!(TripCalibration::of_scans(&[]), TripCalibration::default());
    }

    /// The first beam is where the lidar states it, all others are not. About the middle of the fan
    /// that is a turn of the mount, so that spacing and yaw together give each beam its bearing.
    #[test]
    fn beams_get_their_true_bearings_whichever_of_them_was_stated_right() {
        let stated = stated_lidar();
        let mut lidar = stated.clone();
        lidar.geometry.angle_increment_rad *= 0.95;
        let trip = TripCalibration::of_scans(&drive_of(lidar.clone(), 3, 3).scans);
        let corrections = Corrections::of(&trip.estimates);
        let corrected = corrections.lidar(&stated.geometry, stated.beams).unwrap();
        for beam in [0, stated.beams / 2, stated.beams - 1] {
            let bearing_rad = |lidar: &Lidar| lidar.mount.theta + lidar.beam_angle_rad(beam);
            let off_rad = bearing_rad(&corrected) - bearing_rad(&lidar.geometry);
            assert!(off_rad.abs() < 0.012, "beam {beam}: {off_rad}, {trip:?}");
        }
        let half_fan_rad = 0.5 * (stated.beams - 1) as f64 * stated.geometry.angle_increment_rad;
        let yaw_rad = corrections.get(Quantity::MountYaw);
        assert!((yaw_rad + 0.05 * half_fan_rad).abs() < 0.012, "{trip:?}");
    }

    #[test]
    fn a_vehicle_that_stands_says_nothing() {
        let drive = drive_with(&Corrections::default(), 3, 3);
        let standing = (0..200).map(|k| TripScan {
            stamp: StampNs(100_000_000 * k),
            ..drive.scans[0].clone()
        });
        let trip = TripCalibration::of_scans(&standing.collect::<Vec<_>>());
        assert_eq!(trip, TripCalibration::default());
    }
}
