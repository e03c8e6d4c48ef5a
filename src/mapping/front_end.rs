//! The motion between two keyframes of one trip.

use super::local_map::LocalMap;
use crate::geometry::{Information, Pose2};
use crate::matching::{
    Estimate, IcpParams, SearchParams, SearchWindow, Termination, align, search,
};
use crate::scan::SurfacePoint;

/// A measured motion.
#[derive(Debug, Clone, Copy)]
pub struct Motion {
    /// `last_from_base`.
    pub measurement: Pose2,
    /// Of the measurement.
    pub information: Information,
}

/// A match that explains this share of the points needs no search.
const SUPPORT_GOOD: f64 = 0.85;
/// A match that explains less is not used.
const SUPPORT_MIN: f64 = 0.35;
/// A search's result must explain so much more than the odometry's.
const SUPPORT_GAIN: f64 = 0.05;

const SEARCH_RESOLUTION_M: f64 = 0.05;
const SEARCH_LEVELS: usize = 5;
const SEARCH_POINTS_MAX: usize = 200;

/// Share of the scan's points that the map explains.
fn support(estimate: &Estimate) -> f64 {
    estimate.overlap * estimate.inlier_share
}

/// Matches a scan against the local map of the last keyframes (frame: the last keyframe's base).
///
/// `last_from_base` is the odometry's word. Directions that the scan does not fix, and scans that
/// cannot be matched, keep it, with the odometry's information.
pub fn measure_motion(
    local_map: &LocalMap<'_>,
    points: &[SurfacePoint],
    last_from_base: &Pose2,
    range_sigma_m: f64,
) -> Motion {
    let wheels = odometry_information(last_from_base);
    let by_odometry = Motion {
        measurement: *last_from_base,
        information: wheels,
    };
    let Some(cloud) = local_map.cloud() else {
        return by_odometry;
    };
    let refine = |start: &Pose2| align(&cloud, points, start, range_sigma_m, &IcpParams::ROBUST);
    let mut best = refine(last_from_base);
    if support(&best) < SUPPORT_GOOD
        && let Some(start) = search_start(local_map, points, last_from_base)
    {
        let searched = refine(&start);
        if support(&searched) > support(&best) + SUPPORT_GAIN {
            best = searched;
        }
    }
    if best.termination == Termination::TooFewPoints || support(&best) < SUPPORT_MIN {
        return by_odometry;
    }
    Motion {
        measurement: best.pose,
        information: Information::from_matrix(&(best.information.matrix() + wheels.matrix())),
    }
}

fn search_start(
    local_map: &LocalMap<'_>,
    points: &[SurfacePoint],
    last_from_base: &Pose2,
) -> Option<Pose2> {
    let grid = local_map.grid(SEARCH_RESOLUTION_M, SEARCH_LEVELS)?;
    let scan = LocalMap::new(vec![(Pose2::IDENTITY, points)]);
    let window = SearchWindow {
        centre: *last_from_base,
        half_width_m: 0.2 + 0.3 * last_from_base.translation().norm().min(3.0),
        half_turn_rad: 0.15 + 0.3 * last_from_base.theta.abs(),
    };
    let params = SearchParams {
        score_min: 0.3,
        distinct_distance_m: f64::INFINITY,
        distinct_turn_rad: f64::INFINITY,
        rival_share: 1.0,
    };
    let candidates = scan.thinned(SEARCH_RESOLUTION_M, SEARCH_POINTS_MAX);
    Some(search(&grid, &candidates, &window, &params)?.pose)
}

/// What a vehicle's own odometry is trusted with: a tenth of the way and a fifth of the turn.
fn odometry_information(motion: &Pose2) -> Information {
    let distance_m = motion.translation().norm();
    Information::from_sigmas(
        0.05 + 0.1 * distance_m,
        0.05 + 0.2 * motion.theta.abs() + 0.02 * distance_m,
    )
}
