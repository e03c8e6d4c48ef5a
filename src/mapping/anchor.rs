//! The place of a trip that does not say where it is.

use super::closure::Slack;
use super::confirmation::{
    Confirmation, KEYFRAMES_MIN, POINTS_MAX, TRUSTING, confirm, distinguished,
};
use super::drive::{Drive, InitialPose};
use super::local_map::{LocalMap, SEARCH_REACH_M};
use super::partners::Placed;
use super::route_map::RouteMap;
use crate::geometry::{Pose2, Vector2};
use crate::matching::{LikelihoodGrid, SearchHit, SearchParams, SearchWindow, search};

/// Where the first trip of a route starts if it does not say.
pub(super) const ORIGIN: InitialPose = InitialPose {
    pose: Pose2::IDENTITY,
    sigma_xy_m: 0.1,
    sigma_theta_rad: 0.05,
};

/// Why a trip has no place in the map.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum AnchorError {
    /// The scans show too little.
    #[error(
        "the trip has only {0} usable keyframes so far; {KEYFRAMES_MIN} are needed to find its place"
    )]
    TooShort(usize),
    /// The given pose is nowhere near the map.
    #[error(
        "its initial pose is {0:.0} m from the map: give it in the frame of the map, or leave it out"
    )]
    TooFar(f64),
    /// Nothing in the map looks like it.
    #[error("nothing in the map looks like it")]
    Unknown,
    /// Two places look like it.
    #[error("two places look alike: near ({:.1}, {:.1}) and near ({:.1}, {:.1})", .0.x, .0.y, .1.x, .1.y)]
    Ambiguous(Pose2, Pose2),
    /// The best place does not stand a closer look.
    #[error("the most similar place, near ({:.1}, {:.1}), agrees with only {agreeing} of {compared} scans", .place.x, .place.y)]
    Contradicted {
        /// `map_from_base` of the trip's first scan there.
        place: Pose2,
        /// Scans that a closer match confirms.
        agreeing: usize,
        /// Scans that were compared.
        compared: usize,
    },
}

impl AnchorError {
    /// `map_from_base` of the trip's first scan at the place that looks most like the trip, if one does.
    pub(super) fn best(&self) -> Option<&Pose2> {
        match self {
            Self::TooShort(_) | Self::TooFar(_) | Self::Unknown => None,
            Self::Ambiguous(best, _) | Self::Contradicted { place: best, .. } => Some(best),
        }
    }
}

const GRID_LEVELS: usize = 7;

/// Another place is farther away than this, metres, …
const DISTINCT_DISTANCE_M: f64 = 0.7;
/// … or turned by more, radians.
const DISTINCT_TURN_RAD: f64 = 0.35;

/// A weaker place is another one if it is farther away than this, metres: matches that begin there
/// cannot end at the better one.
const WEAKER_DISTANCE_M: f64 = 2.0;

/// Whether two poses are one place to a search.
pub(super) fn is_same(a: &Pose2, b: &Pose2) -> bool {
    let apart = a.between(b);
    apart.translation().norm() <= DISTINCT_DISTANCE_M && apart.theta.abs() <= DISTINCT_TURN_RAD
}

/// The pose of the drive's first scan in the map.
pub(super) fn find(map: &RouteMap, drive: &Drive) -> Result<InitialPose, AnchorError> {
    let mut own = RouteMap::new(map.weighting);
    let own_drive = Drive {
        initial_pose: Some(ORIGIN),
        ..drive.clone()
    };
    let extended = own.extend(&own_drive);
    if extended.is_err() || own.keyframes.len() < KEYFRAMES_MIN {
        return Err(AnchorError::TooShort(own.keyframes.len()));
    }
    // What was driven before the vehicle was carried, if it was.
    let all_own = (0..own.keyframes.len()).take_while(|&k| !own.is_lost(k));
    let all_own: Vec<Placed<'_>> = all_own.map(|k| own.placed(k)).collect();
    let layer = own.keyframes[0].layer();
    let map_from_own = locate(&map.placed_references(layer), &all_own, &TRUSTING)?;
    Ok(InitialPose {
        pose: map_from_own.compose(&all_own[0].pose),
        sigma_xy_m: 0.05,
        sigma_theta_rad: 0.015,
    })
}

/// Where scans that are placed among themselves are in the map: `map_from_own`.
pub(super) fn locate(
    references: &[Placed<'_>],
    own: &[Placed<'_>],
    confirmation: &Confirmation,
) -> Result<Pose2, AnchorError> {
    if own.len() < KEYFRAMES_MIN {
        return Err(AnchorError::TooShort(own.len()));
    }
    let (best, rival) = search_everywhere(references, own, confirmation)?;
    let Some(rival) = rival else {
        confirm(references, own, &best, confirmation).map_err(|count| {
            AnchorError::Contradicted {
                place: best.compose(&own[0].pose),
                agreeing: count.agreeing(),
                compared: count.compared,
            }
        })?;
        return Ok(best);
    };
    distinguished(references, own, [&best, &rival], confirmation).ok_or_else(|| {
        let first = own[0].pose;
        AnchorError::Ambiguous(best.compose(&first), rival.compose(&first))
    })
}

/// The place that looks most like the scans, and another that looks like them too: similar in its
/// score, or hardly worse and confirmed by the scans.
fn search_everywhere(
    references: &[Placed<'_>],
    own: &[Placed<'_>],
    confirmation: &Confirmation,
) -> Result<(Pose2, Option<Pose2>), AnchorError> {
    let resolution_m = confirmation.resolution_m;
    let reference_map = placed_map(references);
    let grid = reference_map
        .grid(resolution_m, GRID_LEVELS)
        .ok_or(AnchorError::Unknown)?;
    let own_map = placed_map(own);
    let points = own_map.thinned(resolution_m, f64::INFINITY, confirmation.points_max);
    let middle = points.iter().sum::<Vector2<f64>>() / points.len().max(1) as f64;
    let centred: Vec<_> = points.iter().map(|p| p - middle).collect();
    let hit = search(
        &grid,
        &centred,
        &SearchWindow::everywhere(&grid),
        &SearchParams {
            score_min: confirmation.score_min,
            rival_share: confirmation.rival_share,
            distinct_distance_m: DISTINCT_DISTANCE_M,
            distinct_turn_rad: DISTINCT_TURN_RAD,
            wants_best_rival: true,
        },
    )
    .ok_or(AnchorError::Unknown)?;
    let own_from_centred = Pose2::new(middle.x, middle.y, 0.0);
    let to_map_from_own = |pose: &Pose2| pose.compose(&own_from_centred.inverse());
    let similar = hit.rival.map(|(rival, _)| to_map_from_own(&rival));
    let rival = similar.or_else(|| {
        let weaker = search_weaker(&grid, &centred, &hit, confirmation)?;
        let weaker = to_map_from_own(&weaker);
        let is_confirmed = confirm(references, own, &weaker, confirmation).is_ok();
        is_confirmed.then_some(weaker)
    });
    Ok((to_map_from_own(&hit.pose), rival))
}

/// A place elsewhere that leaves hardly more of the points unexplained than the one found, which has
/// no rival of a similar score. `None` also where so many places do that a search would take too long.
fn search_weaker(
    grid: &LikelihoodGrid,
    points: &[Vector2<f64>],
    found: &SearchHit,
    confirmation: &Confirmation,
) -> Option<Pose2> {
    let unexplained_max = confirmation.rival_unexplained_ratio * (1.0 - found.score);
    let rival_share = (1.0 - unexplained_max).max(confirmation.score_min) / found.score;
    if rival_share >= confirmation.rival_share {
        return None;
    }
    let params = SearchParams {
        // Just enough to find the same place again.
        score_min: 0.99 * found.score,
        rival_share,
        distinct_distance_m: WEAKER_DISTANCE_M,
        distinct_turn_rad: DISTINCT_TURN_RAD,
        wants_best_rival: true,
    };
    let hit = search(grid, points, &SearchWindow::everywhere(grid), &params)?;
    hit.rival.map(|(rival, _)| rival)
}

fn placed_map<'a>(placed: &[Placed<'a>]) -> LocalMap<'a> {
    let scans = placed
        .iter()
        .map(|p| (p.pose, p.keyframe.points.as_slice()));
    LocalMap::new(scans.collect())
}

const NEARBY: SearchParams = SearchParams {
    score_min: 0.45,
    // What is nearer is the same hill: along a corridor hills are long.
    distinct_distance_m: 1.0,
    distinct_turn_rad: 0.2,
    rival_share: 0.9,
    wants_best_rival: false,
};
const NEARBY_RESOLUTION_M: f64 = 0.05;
/// A hit that lies nearer than this to the end of its slack, metres, …
const BORDER_M: f64 = 0.1;
/// … or than this part of the slack, is the slope of a hill outside: such hits tied the maps of
/// large buildings falsely.
const BORDER_SHARE: f64 = 0.1;

/// The pose of a trip's newest keyframe among reference nodes, from its local map (frame: the
/// newest keyframe's base), within a slack around the expected `map_from_base`.
///
/// `None` if the place does not look like it, if two poses within the slack do, or if the best one
/// lies on the border of the slack.
pub(super) fn relocate(
    local_map: &LocalMap<'_>,
    references: &[Placed<'_>],
    expected: &Pose2,
    slack: &Slack,
) -> Option<Pose2> {
    let reference_map = placed_map(references);
    let (centre, half_width_m) = (expected.translation(), SEARCH_REACH_M + slack.distance_m);
    let grid =
        reference_map.grid_around(&centre, half_width_m, NEARBY_RESOLUTION_M, GRID_LEVELS)?;
    let points = local_map.thinned(NEARBY_RESOLUTION_M, SEARCH_REACH_M, POINTS_MAX);
    let window = SearchWindow {
        centre: *expected,
        half_width_m: slack.distance_m,
        half_turn_rad: slack.turn_rad,
    };
    let hit = search(&grid, &points, &window, &NEARBY)?;
    let moved = hit.pose.translation() - expected.translation();
    let border_m = BORDER_M.max(BORDER_SHARE * slack.distance_m);
    let is_inside = moved.norm() <= slack.distance_m - border_m;
    (is_inside && hit.rival.is_none()).then_some(hit.pose)
}
