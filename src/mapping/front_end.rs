//! The motion between two keyframes of one trip.

use super::local_map::{LocalCloud, LocalMap, SEARCH_REACH_M};
use super::odometry::{OdometryMotion, OdometrySigmas};
use crate::geometry::{Information, Pose2};
use crate::matching::{
    Alignment, Estimate, IcpParams, Prior, ReferenceCloud, SearchParams, SearchWindow, Termination,
    search,
};
use crate::scan::SurfacePoint;

/// A measured motion.
#[derive(Debug, Clone, Copy)]
pub(super) struct Motion {
    /// `last_from_base`.
    pub measurement: Pose2,
    /// Of the measurement.
    pub information: Information,
    /// Whether the scans were matched; if not, the odometry stands alone.
    pub matched: bool,
}

/// A match that explains this share of the points needs no search.
const SUPPORT_GOOD: f64 = 0.85;
/// A match that explains less is not used.
const SUPPORT_MIN: f64 = 0.35;
/// A search's result must explain so much more than the match that began at the odometry …
const SUPPORT_GAIN: f64 = 0.05;
/// … and so much more for every squared standard deviation that it is farther from the odometry.
const SUPPORT_GAIN_PER_SQUARED_SIGMA: f64 = 0.015;

/// A match farther from the odometry, in its standard deviations, is not used.
const ODOMETRY_SIGMAS_MAX: f64 = 5.0;

const SEARCH_RESOLUTION_M: f64 = 0.05;
/// How far around the odometry a search goes, in its standard deviations …
const SEARCH_SIGMAS: f64 = 4.0;
/// … and at most, metres …
const SEARCH_HALF_WIDTH_MAX_M: f64 = 1.5;
/// … and radians.
const SEARCH_HALF_TURN_MAX_RAD: f64 = 1.0;
const SEARCH_LEVELS: usize = 5;
const SEARCH_POINTS_MAX: usize = 200;

/// Matches a scan against the local map of the last keyframes (frame: the last keyframe's base).
///
/// Directions that the scan does not fix, and scans that
/// cannot be matched, keep it, with the odometry's information.
pub(super) fn measure_motion(
    local_map: &LocalMap<'_>,
    cloud: &LocalCloud,
    points: &[SurfacePoint],
    odometry: &OdometryMotion,
    range_sigma_m: f64,
) -> Motion {
    let (last_from_base, sigmas) = (&odometry.motion, odometry.sigmas);
    let wheels = sigmas.information();
    let by_odometry = Motion {
        measurement: *last_from_base,
        information: wheels,
        matched: false,
    };
    let Some(cloud) = cloud.points() else {
        return by_odometry;
    };
    let prior = Prior {
        pose: *last_from_base,
        information: wheels,
    };
    let mut alignment = Alignment::new(cloud, points);
    let mut refine = |start: &Pose2| {
        alignment.align_from(start, range_sigma_m, Some(&prior), &IcpParams::ROBUST)
    };
    let odometry_error = |estimate: &Estimate| {
        let error = Pose2::edge_error(&Pose2::IDENTITY, &estimate.pose, last_from_base);
        sigmas.mahalanobis(&error)
    };
    let plausible = |estimate: &Estimate| {
        estimate.termination != Termination::TooFewPoints
            && estimate.explained_share() >= SUPPORT_MIN
            && odometry_error(estimate) <= ODOMETRY_SIGMAS_MAX
    };
    let mut best = refine(last_from_base);
    if (best.explained_share() < SUPPORT_GOOD || !plausible(&best))
        && let Some(start) = search_start(local_map, points, last_from_base, &sigmas)
    {
        let searched = refine(&start);
        let farther = odometry_error(&searched).powi(2) - odometry_error(&best).powi(2);
        let gain_min = SUPPORT_GAIN + SUPPORT_GAIN_PER_SQUARED_SIGMA * farther.max(0.0);
        let better = searched.explained_share() > best.explained_share() + gain_min;
        if plausible(&searched) && (better || !plausible(&best)) {
            best = searched;
        }
    }
    if !plausible(&best) {
        return by_odometry;
    }
    Motion {
        measurement: best.pose,
        information: Information::from_matrix(&(best.information.matrix() + wheels.matrix())),
        matched: true,
    }
}

/// Matches a scan with the one before it, with all points of both, as the paper does (section 2:
/// direct matching for relative motion and loop closures alike; section 4: all the points of the
/// frames).
///
/// The odometry is where the match starts and no more: no prior, no search, no comparison with it
/// afterwards. It stands alone if the scans share too few points for an estimate, and along
/// directions that they do not fix.
pub(super) fn match_scans(
    last_points: &[SurfacePoint],
    points: &[SurfacePoint],
    odometry: &OdometryMotion,
    range_sigma_m: f64,
) -> Motion {
    let start = &odometry.motion;
    let by_odometry = Motion {
        measurement: *start,
        information: odometry.sigmas.information(),
        matched: false,
    };
    let Some(last) = ReferenceCloud::new([(Pose2::IDENTITY, last_points)]) else {
        return by_odometry;
    };
    let params = &IcpParams::ALL_POINTS;
    let matched = Alignment::new(&last, points).align_from(start, range_sigma_m, None, params);
    if matched.termination == Termination::TooFewPoints {
        return by_odometry;
    }
    Motion {
        measurement: matched.pose,
        information: matched.information,
        matched: true,
    }
}

fn search_start(
    local_map: &LocalMap<'_>,
    points: &[SurfacePoint],
    last_from_base: &Pose2,
    sigmas: &OdometrySigmas,
) -> Option<Pose2> {
    let (centre, half_width_m) = (
        last_from_base.translation(),
        SEARCH_REACH_M + SEARCH_HALF_WIDTH_MAX_M,
    );
    let grid = local_map.grid_around(&centre, half_width_m, SEARCH_RESOLUTION_M, SEARCH_LEVELS)?;
    let scan = LocalMap::new(vec![(Pose2::IDENTITY, points)]);
    let window = SearchWindow {
        centre: *last_from_base,
        half_width_m: (SEARCH_SIGMAS * sigmas.xy_m).min(SEARCH_HALF_WIDTH_MAX_M),
        half_turn_rad: (SEARCH_SIGMAS * sigmas.theta_rad).min(SEARCH_HALF_TURN_MAX_RAD),
    };
    let params = SearchParams {
        score_min: 0.3,
        distinct_distance_m: f64::INFINITY,
        distinct_turn_rad: f64::INFINITY,
        rival_share: 1.0,
    };
    let candidates = scan.thinned(SEARCH_RESOLUTION_M, SEARCH_REACH_M, SEARCH_POINTS_MAX);
    Some(search(&grid, &candidates, &window, &params)?.pose)
}
