//! Which old nodes a new one is tied to: the partner policy.
//!
//! Closures are tied to *reference* nodes only, the oldest view of a place, never to the lap
//! before: tied to the map before a change, the signal stays lap after lap; tied to the previous
//! lap it vanishes at once.

use std::collections::BTreeMap;

use super::keyframe::Keyframe;
use crate::geometry::{Pose2, angle_difference_rad};
use crate::matching::Visibility;

/// A node becomes a reference unless one is as near as this, metres …
const COVERED_DISTANCE_M: f64 = 0.3;
/// … and turned by no more than this, radians.
const COVERED_TURN_RAD: f64 = 0.4;
/// How far a partner may be, metres.
pub(super) const PARTNER_DISTANCE_MAX_M: f64 = 5.0;
/// Partners of one node.
const PARTNERS_MAX: usize = 3;
/// Partners of one node are at least so far apart, metres.
const PARTNER_SPACING_M: f64 = 0.8;
/// The paper's one partner is no farther than this, metres.
const NEAREST_MAX_M: f64 = 1.5;
/// Least share of the new scan's points in the old scan's reach.
const REACH_SHARE_MIN: f64 = 0.4;
/// Every so many points are looked up to foresee the reach.
const REACH_STRIDE: usize = 6;
/// Depth tolerance of that look, metres.
const REACH_TOLERANCE_M: f64 = 0.6;

/// A placed keyframe.
#[derive(Clone, Copy)]
pub(super) struct Placed<'a> {
    /// `map_from_base`.
    pub pose: Pose2,
    /// Its scan.
    pub keyframe: &'a Keyframe,
}

/// Whether a place has a reference node already.
pub(super) fn is_covered(pose: &Pose2, references: impl Iterator<Item = Pose2>) -> bool {
    let mut references = references;
    references.any(|reference| {
        (reference.translation() - pose.translation()).norm() < COVERED_DISTANCE_M
            && angle_difference_rad(reference.theta, pose.theta) < COVERED_TURN_RAD
    })
}

/// References by where they are: to ask of very many places whether they are covered.
#[derive(Default)]
pub(super) struct Covering {
    /// Squares of [`COVERED_DISTANCE_M`].
    squares: BTreeMap<(i64, i64), Vec<Pose2>>,
}

impl Covering {
    pub(super) fn insert(&mut self, reference: Pose2) {
        let square = square_of(&reference);
        self.squares.entry(square).or_default().push(reference);
    }

    /// As [`is_covered`] by all that were inserted.
    pub(super) fn covers(&self, pose: &Pose2) -> bool {
        let (x, y) = square_of(pose);
        let columns = (x - 1..=x + 1).flat_map(|x| self.squares.range((x, y - 1)..=(x, y + 1)));
        is_covered(
            pose,
            columns.flat_map(|(_, references)| references).copied(),
        )
    }
}

fn square_of(pose: &Pose2) -> (i64, i64) {
    let [x, y] = [pose.x, pose.y].map(|metres| (metres / COVERED_DISTANCE_M).floor() as i64);
    (x, y)
}

/// Share of the new scan's points that lie where the old scan looked; 0 without an old scan.
fn reach_share(new: &Placed<'_>, old: &Placed<'_>) -> f64 {
    let Some(views) = old.keyframe.views() else {
        return 0.0;
    };
    let old_from_new = old.pose.between(&new.pose).to_transform();
    let sampled = new.keyframe.points.iter().step_by(REACH_STRIDE);
    let (mut within, mut count) = (0usize, 0usize);
    for point in sampled {
        count += 1;
        let position = old_from_new.apply(&point.position);
        let seen = views.look_at(&position, None, REACH_TOLERANCE_M);
        within += usize::from(matches!(seen, Visibility::Surface | Visibility::Free));
    }
    within as f64 / count.max(1) as f64
}

/// The reference nodes that a new node is tied to: those that share the most of its view, and
/// among those about equal the oldest, a distance apart.
pub(super) fn choose<'a>(new: &Placed<'a>, candidates: &[Placed<'a>]) -> Vec<Placed<'a>> {
    let mut ranked: Vec<(u32, Placed<'a>)> = candidates
        .iter()
        .map(|old| (reach_share(new, old), *old))
        .filter(|(share, _)| *share >= REACH_SHARE_MIN)
        .map(|(share, old)| ((share * 5.0) as u32, old))
        .collect();
    ranked.sort_by_key(|(tier, old)| (std::cmp::Reverse(*tier), old.keyframe.node));
    spaced(ranked.into_iter().map(|(_, old)| old), PARTNERS_MAX)
}

/// The first of some placed keyframes, and of the others in their order those that are
/// [`PARTNER_SPACING_M`] from all taken before, `count_max` at most.
pub(super) fn spaced<'a>(
    ranked: impl IntoIterator<Item = Placed<'a>>,
    count_max: usize,
) -> Vec<Placed<'a>> {
    let mut kept: Vec<Placed<'a>> = Vec::new();
    for placed in ranked {
        if kept.len() == count_max {
            break;
        }
        if (kept.iter()).all(|other| way_m(&other.pose, &placed.pose) >= PARTNER_SPACING_M) {
            kept.push(placed);
        }
    }
    kept
}

/// Placed keyframes no farther from a pose than so many metres.
pub(super) fn within<'a>(
    distance_max_m: f64,
    pose: &Pose2,
    placed: &[Placed<'a>],
) -> Vec<Placed<'a>> {
    let near = placed.iter().copied();
    near.filter(|old| way_m(&old.pose, pose) <= distance_max_m)
        .collect()
}

/// Placed keyframes by their distance from a pose.
pub(super) fn nearest_first<'a>(
    pose: &Pose2,
    placed: impl IntoIterator<Item = Placed<'a>>,
) -> Vec<Placed<'a>> {
    let mut ranked: Vec<Placed<'a>> = placed.into_iter().collect();
    ranked.sort_by(|a, b| way_m(&a.pose, pose).total_cmp(&way_m(&b.pose, pose)));
    ranked
}

/// The way between two poses as the crow flies, metres.
pub(super) fn way_m(a: &Pose2, b: &Pose2) -> f64 {
    (a.translation() - b.translation()).norm()
}

/// The one reference node that a new node is tied to in the paper's graph: the nearest, if it is
/// near and shows the view. Scans from one place differ by what changed; from farther apart an
/// estimate from all points is disturbed as much by what hides what.
pub(super) fn nearest<'a>(new: &Placed<'a>, candidates: &[Placed<'a>]) -> Option<Placed<'a>> {
    let shows_it = |old: &Placed<'a>| reach_share(new, old) >= REACH_SHARE_MIN;
    by_distance(new, candidates).into_iter().find(shows_it)
}

/// As [`nearest`], whatever it shows: the paper leaves it to the score of the match whether two
/// scans are of one place (section 5.1). The reach of 1.5 m is our reading of "approximately the
/// same path" (section 6).
pub(super) fn nearest_of_any<'a>(
    new: &Placed<'a>,
    candidates: &[Placed<'a>],
) -> Option<Placed<'a>> {
    by_distance(new, candidates).into_iter().next()
}

/// The candidates within [`NEAREST_MAX_M`], the nearest first.
fn by_distance<'a>(new: &Placed<'a>, candidates: &[Placed<'a>]) -> Vec<Placed<'a>> {
    nearest_first(&new.pose, within(NEAREST_MAX_M, &new.pose, candidates))
}

#[cfg(test)]
mod tests;
