//! The motion between two keyframes of one trip.

use super::local_map::{LocalCloud, LocalMap, SEARCH_REACH_M};
use super::odometry::{OdometryMotion, OdometrySigmas};
use crate::geometry::{Information, Pose2};
use crate::matching::{
    Alignment, BESIDE_A_STEP_M, Contrast, Estimate, IcpParams, Prior, ReferenceCloud, SearchHit,
    SearchParams, SearchWindow, Termination, search,
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
/// Directions that the scan does not fix, and scans that cannot be matched, keep the odometry, with
/// its information.
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
    let contrast = alignment.contrast(&best.pose, &IcpParams::ROBUST, BESIDE_A_STEP_M);
    let (measurement, information) = with_wheels_along(&best, &contrast, last_from_base);
    Motion {
        measurement,
        information: Information::from_matrix(&(information.matrix() + wheels.matrix())),
        matched: true,
    }
}

/// Matches without an odometry explain so much at least, …
const ALONE_SUPPORT_MIN: f64 = 0.6;
/// … are looked for no farther from where the scan before was taken than this, metres …
const ALONE_HALF_WIDTH_M: f64 = 1.5;
/// … and radians, …
const ALONE_HALF_TURN_RAD: f64 = 1.0;
/// … and mean, along a direction that they do not fix, that the vehicle is still about there,
/// metres.
const ALONE_SIGMA_M: f64 = 1.0;

/// Matches a scan against the local map (frame: the last keyframe's base) around `before`, where
/// the scan before it was taken; for vehicles whose odometry says nothing that can be believed.
///
/// `None` if the scan fits nowhere, or in two places. Along a corridor the vehicle is taken to be
/// where it was.
pub(super) fn match_alone(
    local_map: &LocalMap<'_>,
    cloud: &LocalCloud,
    points: &[SurfacePoint],
    before: &Pose2,
    range_sigma_m: f64,
) -> Option<Motion> {
    let mut alignment = Alignment::new(cloud.points()?, points);
    let mut refine =
        |start: &Pose2| alignment.align_from(start, range_sigma_m, None, &IcpParams::ROBUST);
    let near = refine(before);
    let best = if is_plausible_alone(&near) && near.explained_share() >= SUPPORT_GOOD {
        near
    } else {
        let window = SearchWindow {
            centre: *before,
            half_width_m: ALONE_HALF_WIDTH_M,
            half_turn_rad: ALONE_HALF_TURN_RAD,
        };
        let hit = search_around(local_map, points, &window, &ALONE)?;
        let found = refine(&hit.pose);
        match (hit.rival, is_plausible_alone(&near)) {
            (None, _) => found,
            (Some(_), true) => near,
            (Some(_), false) => return None,
        }
    };
    motion_alone(&mut alignment, &best, before)
}

/// Matches a scan against the local map (frame: the last keyframe's base) from `start` on, without
/// a word of the odometry's. Along a corridor it stays there.
///
/// `None` if the scan does not fit.
pub(super) fn match_from(
    cloud: &LocalCloud,
    points: &[SurfacePoint],
    start: &Pose2,
    range_sigma_m: f64,
) -> Option<Motion> {
    let mut alignment = Alignment::new(cloud.points()?, points);
    let matched = alignment.align_from(start, range_sigma_m, None, &IcpParams::ROBUST);
    motion_alone(&mut alignment, &matched, start)
}

fn is_plausible_alone(estimate: &Estimate) -> bool {
    estimate.termination != Termination::TooFewPoints
        && estimate.explained_share() >= ALONE_SUPPORT_MIN
}

fn motion_alone(
    alignment: &mut Alignment<'_>,
    matched: &Estimate,
    expected: &Pose2,
) -> Option<Motion> {
    if !is_plausible_alone(matched) {
        return None;
    }
    let contrast = alignment.contrast(&matched.pose, &IcpParams::ROBUST, BESIDE_A_STEP_M);
    let (measurement, information) = with_wheels_along(matched, &contrast, expected);
    let weak = Information::from_sigmas(ALONE_SIGMA_M, ALONE_HALF_TURN_RAD);
    Some(Motion {
        measurement,
        information: Information::from_matrix(&(information.matrix() + weak.matrix())),
        matched: true,
    })
}

/// A match with the odometry's word along the direction that the scans do not fix: along a corridor
/// they end anywhere.
fn with_wheels_along(
    matched: &Estimate,
    contrast: &Contrast,
    by_odometry: &Pose2,
) -> (Pose2, Information) {
    let Contrast { axis, fixed_share } = contrast;
    let to_odometry = matched.pose.between(by_odometry).translation();
    let by_m = (1.0 - fixed_share) * axis.dot(&to_odometry);
    let moved = Pose2::new(by_m * axis.x, by_m * axis.y, 0.0);
    (
        matched.pose.compose(&moved),
        contrast.held_to(&matched.information),
    )
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
    let window = SearchWindow {
        centre: *last_from_base,
        half_width_m: (SEARCH_SIGMAS * sigmas.xy_m).min(SEARCH_HALF_WIDTH_MAX_M),
        half_turn_rad: (SEARCH_SIGMAS * sigmas.theta_rad).min(SEARCH_HALF_TURN_MAX_RAD),
    };
    Some(search_around(local_map, points, &window, &BEST_START)?.pose)
}

/// The odometry chooses among rivals.
const BEST_START: SearchParams = SearchParams {
    score_min: 0.3,
    distinct_distance_m: f64::INFINITY,
    distinct_turn_rad: f64::INFINITY,
    rival_share: 1.0,
    wants_best_rival: false,
};
/// Nothing does.
const ALONE: SearchParams = SearchParams {
    score_min: 0.4,
    distinct_distance_m: 0.7,
    distinct_turn_rad: 0.35,
    rival_share: 0.9,
    wants_best_rival: false,
};

fn search_around(
    local_map: &LocalMap<'_>,
    points: &[SurfacePoint],
    window: &SearchWindow,
    params: &SearchParams,
) -> Option<SearchHit> {
    let centre = window.centre.translation();
    let half_width_m = SEARCH_REACH_M + SEARCH_HALF_WIDTH_MAX_M;
    let grid = local_map.grid_around(&centre, half_width_m, SEARCH_RESOLUTION_M, SEARCH_LEVELS)?;
    let scan = LocalMap::new(vec![(Pose2::IDENTITY, points)]);
    let candidates = scan.thinned(SEARCH_RESOLUTION_M, SEARCH_REACH_M, SEARCH_POINTS_MAX);
    search(&grid, &candidates, window, params)
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::geometry::Vector2;
    use crate::scan::{LaserScan, Lidar, surface_points};
    use crate::sim::{Shape, World};

    fn look(world: &World, from: &Pose2) -> Vec<SurfacePoint> {
        let lidar = Arc::new(Lidar {
            angle_min_rad: -3.1,
            angle_increment_rad: 0.0172,
            range_min_m: 0.05,
            range_max_m: 20.0,
            mount: Pose2::IDENTITY,
            range_sigma_m: 0.01,
            band: None,
        });
        let ranges = (0..360).map(|beam| {
            let (sin, cos) = (from.theta + lidar.beam_angle_rad(beam)).sin_cos();
            let hit = world.cast(&from.translation(), &Vector2::new(cos, sin));
            hit.map(|hit| hit.range_m + 0.01 * (beam as f64 * beam as f64).sin())
        });
        let ranges: Vec<_> = ranges.collect();
        surface_points(&LaserScan::new(lidar, ranges).unwrap())
    }

    /// The motion that is measured where the vehicle moved half a metre and its wheels say 0.56 m.
    fn measured_in(world: &World) -> Motion {
        let last = look(world, &Pose2::IDENTITY);
        let points = look(world, &Pose2::new(0.5, 0.02, 0.01));
        let local_map = LocalMap::new(vec![(Pose2::IDENTITY, &last)]);
        let mut cloud = LocalCloud::default();
        cloud.follow(crate::ids::NodeId(1), &local_map);
        let odometry = OdometryMotion::told(&Pose2::new(0.56, 0.0, 0.0));
        measure_motion(&local_map, &cloud, &points, &odometry, 0.01)
    }

    #[test]
    fn along_a_bare_corridor_the_wheels_are_believed() {
        let wall = |y: f64| Shape::rectangle(&Pose2::new(0.0, y, 0.0), 60.0, 0.2);
        let bare = World::new([wall(-1.2), wall(1.2)]);
        let motion = measured_in(&bare);
        assert!(motion.matched);
        let Pose2 { x, y, theta } = motion.measurement;
        assert!((x - 0.56).abs() < 0.005, "{x}");
        assert!((y - 0.02).abs() < 0.005 && (theta - 0.01).abs() < 0.003);
        let wheels = OdometryMotion::told(&Pose2::new(0.56, 0.0, 0.0)).sigmas;
        let along = motion.information.matrix()[(0, 0)];
        assert!(along < 2.0 / wheels.xy_m.powi(2), "{along}");

        let pillar = Shape::rectangle(&Pose2::new(2.0, 1.0, 0.0), 0.4, 0.4);
        let with_pillar = measured_in(&World::new([wall(-1.2), wall(1.2), pillar]));
        let x = with_pillar.measurement.x;
        assert!((x - 0.5).abs() < 0.01, "{x}");
    }
}
