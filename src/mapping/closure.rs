//! A loop closure: two scans of one place, matched twice.

use super::corridor;
use super::keyframe::Keyframe;
use super::partners::Placed;
use crate::geometry::{Information, Pose2, angle_difference_rad};
use crate::ids::EdgeId;
use crate::matching::{
    Alignment, BESIDE_A_PLACE_M, DepthTolerance, Estimate, IcpParams, ReferenceCloud, Termination,
    agreement,
};

/// Both measurements of one closure.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ClosureMeasurement {
    /// What makes the map: the robust estimate of `old_from_new`.
    pub robust: Estimate,
    /// What is watched: the estimate from all points.
    pub all_points: Estimate,
    /// How far the scans fix even the direction that they fix least, from 0 (not at all) to 1. The
    /// robust estimate's information is held to it where the new scan sees far.
    pub fixed_share: f64,
}

/// A closure that was added to the graph.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Closure {
    /// The edge from the old node to the new one.
    pub edge: EdgeId,
    /// The robust estimate of `old_from_new`.
    pub robust: Estimate,
    /// The all-points estimate of `old_from_new`.
    pub all_points_measurement: Pose2,
    /// The information that the all-points estimate is weighed with.
    pub all_points_information: Information,
    /// What it added to the optimum F when it was inserted (paper: ΔF).
    pub delta_f: f64,
    /// eᵀΩe of the all-points estimate at the optimum when it was inserted.
    pub all_points_residual: f64,
}

/// What a match must reach to be taken for a closure: the paper's loop closure threshold
/// (section 5.1).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ClosureRule {
    /// Least share of points with a counterpart.
    pub overlap_min: f64,
    /// Least share of the counterparts that agree.
    pub inlier_share_min: f64,
}

/// What a match must reach that ends where it was expected, where much of the place has changed.
const IF_EXPECTED: ClosureRule = ClosureRule {
    overlap_min: 0.2,
    inlier_share_min: 0.9,
};

impl Default for ClosureRule {
    fn default() -> Self {
        Self {
            overlap_min: 0.4,
            inlier_share_min: 0.6,
        }
    }
}

impl ClosureRule {
    /// The threshold on the score of a match where one number decides, as in the paper: the share
    /// of the new scan's points that the match must explain.
    pub fn score_min(&self) -> f64 {
        self.overlap_min * self.inlier_share_min
    }
}

/// Largest share of one scan's points in the other's free space, for a trip that is where it is
/// expected, …
pub(super) const CONTRADICTION_SHARE_MAX: f64 = 0.2;
/// … for one that was found again after it had drifted: the first tie must be beyond doubt, …
pub(super) const CONTRADICTION_SHARE_MAX_FROM_AFAR: f64 = 0.1;
/// … and for one that ends where it was expected: then it is the place that differs.
const CONTRADICTION_SHARE_MAX_IF_EXPECTED: f64 = 0.7;
/// No farther than this from the expected place counts as that, metres …
const EXPECTED_WITHIN_M: f64 = 0.2;
/// … and radians.
const EXPECTED_WITHIN_RAD: f64 = 0.06;
/// What is left of a changed place is at least this share of the points, …
const LEFT_OVERLAP_MIN: f64 = 0.1;
/// … of which so many agree, …
const LEFT_INLIER_SHARE_MIN: f64 = 0.75;
/// … and fix the loosest direction by this share.
const LEFT_FIXED_SHARE_MIN: f64 = 0.5;
/// By how much the depths of two scans of one place may differ. Not more where beams graze a
/// surface: places that look alike would be harder to tell apart.
pub(super) const DEPTH_TOLERANCE: DepthTolerance = DepthTolerance {
    depth_m: 0.15,
    sigma_theta_rad: 0.005,
    is_across: false,
};
/// Fewest directions of motion that the points must fix.
const OBSERVABLE_MIN: usize = 2;
/// All of them.
const OBSERVABLE_ALL: usize = 3;

/// How far a match may end from where it was expected.
#[derive(Debug, Clone, Copy)]
pub(super) struct Slack {
    /// Metres.
    pub distance_m: f64,
    /// Radians.
    pub turn_rad: f64,
    /// Whether the expected place is known well enough to believe it against what the scans show.
    pub well_known: bool,
    /// Largest share of one scan's points in the other's free space.
    pub contradiction_share_max: f64,
}

/// Two scans that show the same place.
#[derive(Debug, Clone, Copy)]
pub(super) struct Fit {
    /// The robust estimate of `old_from_new`.
    robust: Estimate,
    /// The larger share of one scan's points in the other's free space.
    pub contradiction_share: f64,
}

/// Whether a new scan, expected at `old_from_new`, shows the same place as an old one.
///
/// `None` if not: too little overlap or agreement, a result beyond the slack, or one scan's points
/// in the other's free space.
pub(super) fn fit(
    old: &Placed<'_>,
    new: &Placed<'_>,
    old_from_new: &Pose2,
    slack: &Slack,
    rule: &ClosureRule,
) -> Option<Fit> {
    let cloud = ReferenceCloud::new([(Pose2::IDENTITY, old.keyframe.points.as_slice())])?;
    let mut alignment = Alignment::new(&cloud, &new.keyframe.points);
    fit_aligned(&mut alignment, old, new, old_from_new, slack, rule)
}

fn fit_aligned(
    alignment: &mut Alignment<'_>,
    old: &Placed<'_>,
    new: &Placed<'_>,
    old_from_new: &Pose2,
    slack: &Slack,
    rule: &ClosureRule,
) -> Option<Fit> {
    let sigma_m = range_sigma_m(old, new)?;
    let robust = alignment.align_from(old_from_new, sigma_m, None, &IcpParams::ROBUST);
    let moved = old_from_new.between(&robust.pose);
    // Two height bands may differ as much as two worlds do: then the scans must agree.
    let is_expected = slack.well_known
        && old.keyframe.layer() == new.keyframe.layer()
        && robust.observable_directions >= OBSERVABLE_ALL
        && moved.translation().norm() <= EXPECTED_WITHIN_M
        && angle_difference_rad(moved.theta, 0.0) <= EXPECTED_WITHIN_RAD;
    let is_left = is_expected
        && robust.overlap >= IF_EXPECTED.overlap_min
        && robust.inlier_share >= IF_EXPECTED.inlier_share_min;
    let plausible = robust.termination != Termination::TooFewPoints
        && robust.observable_directions >= OBSERVABLE_MIN
        && (robust.overlap >= rule.overlap_min || is_left)
        && robust.inlier_share >= rule.inlier_share_min
        && moved.translation().norm() <= slack.distance_m
        && angle_difference_rad(moved.theta, 0.0) <= slack.turn_rad;
    let share_max = if is_expected {
        CONTRADICTION_SHARE_MAX_IF_EXPECTED
    } else {
        slack.contradiction_share_max
    };
    if !plausible {
        return None;
    }
    let contradiction_share =
        contradiction_share(old.keyframe, new.keyframe, &robust.pose, &DEPTH_TOLERANCE)?;
    (contradiction_share <= share_max).then_some(Fit {
        robust,
        contradiction_share,
    })
}

/// Matches a new scan with an old one, expected at `old_from_new`; `None` if they do not [`fit`].
pub(super) fn measure(
    old: &Placed<'_>,
    new: &Placed<'_>,
    old_from_new: &Pose2,
    slack: &Slack,
    rule: &ClosureRule,
) -> Option<ClosureMeasurement> {
    let cloud = ReferenceCloud::new([(Pose2::IDENTITY, old.keyframe.points.as_slice())])?;
    let sigma_m = range_sigma_m(old, new)?;
    let points = &new.keyframe.points;
    let mut alignment = Alignment::new(&cloud, points);
    let Fit { robust, .. } = fit_aligned(&mut alignment, old, new, old_from_new, slack, rule)?;
    let contrast = alignment.contrast(&robust.pose, &IcpParams::ROBUST, BESIDE_A_PLACE_M);
    // The map of a short-sighted lidar, to which every wall is bare, would fall apart.
    let sees_far = corridor::length_m(points, &contrast.axis) >= corridor::SEEN_MIN_M;
    let information = match sees_far {
        true => contrast.held_to(&robust.information),
        false => robust.information,
    };
    let all_points = alignment.align_from(&robust.pose, sigma_m, None, &IcpParams::ALL_POINTS);
    Some(ClosureMeasurement {
        robust: Estimate {
            information,
            ..robust
        },
        all_points,
        fixed_share: contrast.fixed_share,
    })
}

/// Whether two scans agree on what both show, exactly where they are expected, however much of the
/// place has changed: few points have a counterpart then, but those fit, and fix every direction.
pub(super) fn what_is_left_fits(old: &Placed<'_>, new: &Placed<'_>) -> bool {
    let Some(cloud) = ReferenceCloud::new([(Pose2::IDENTITY, old.keyframe.points.as_slice())])
    else {
        return false;
    };
    let Some(scan) = &new.keyframe.scan else {
        return false;
    };
    let expected = old.pose.between(&new.pose);
    let mut alignment = Alignment::new(&cloud, &new.keyframe.points);
    let sigma_m = scan.lidar().range_sigma_m;
    let matched = alignment.align_from(&expected, sigma_m, None, &IcpParams::ROBUST);
    let moved = expected.between(&matched.pose);
    let fits = matched.termination != Termination::TooFewPoints
        && matched.overlap >= LEFT_OVERLAP_MIN
        && matched.inlier_share >= LEFT_INLIER_SHARE_MIN
        && moved.translation().norm() <= EXPECTED_WITHIN_M
        && angle_difference_rad(moved.theta, 0.0) <= EXPECTED_WITHIN_RAD;
    fits && alignment
        .contrast(&matched.pose, &IcpParams::ROBUST, BESIDE_A_PLACE_M)
        .fixed_share
        >= LEFT_FIXED_SHARE_MIN
}

/// The robust estimate of `old_from_new` that a match ends at which begins there, whatever it is
/// worth; `None` without points.
pub(super) fn aligned_from(
    old: &Placed<'_>,
    new: &Placed<'_>,
    old_from_new: &Pose2,
) -> Option<Estimate> {
    let cloud = ReferenceCloud::new([(Pose2::IDENTITY, old.keyframe.points.as_slice())])?;
    let sigma_m = range_sigma_m(old, new)?;
    let mut alignment = Alignment::new(&cloud, &new.keyframe.points);
    Some(alignment.align_from(old_from_new, sigma_m, None, &IcpParams::ROBUST))
}

/// Matches a new scan with an old one, expected at `old_from_new`, as the paper does: with all
/// points of both (section 4), from where the graph expects it (section 3).
///
/// `None` if the score of that match is below the loop-closure threshold (section 5.1), or if the
/// scans share too few points for an estimate; nothing else refuses it. The robust estimate is made
/// afterwards, to be compared, and decides nothing.
pub(super) fn measure_by_score(
    old: &Placed<'_>,
    new: &Placed<'_>,
    old_from_new: &Pose2,
    rule: &ClosureRule,
) -> Option<ClosureMeasurement> {
    let cloud = ReferenceCloud::new([(Pose2::IDENTITY, old.keyframe.points.as_slice())])?;
    let sigma_m = range_sigma_m(old, new)?;
    let mut alignment = Alignment::new(&cloud, &new.keyframe.points);
    let all_points = alignment.align_from(old_from_new, sigma_m, None, &IcpParams::ALL_POINTS);
    let accepted = all_points.termination != Termination::TooFewPoints
        && all_points.explained_share() >= rule.score_min();
    if !accepted {
        return None;
    }
    let robust = alignment.align_from(old_from_new, sigma_m, None, &IcpParams::ROBUST);
    Some(ClosureMeasurement {
        robust,
        all_points,
        fixed_share: 1.0,
    })
}

/// The larger noise of two scans' ranges, metres; `None` without scans.
fn range_sigma_m(old: &Placed<'_>, new: &Placed<'_>) -> Option<f64> {
    let [old, new] = [old, new].map(|placed| placed.keyframe.range_sigma_m());
    Some(old?.max(new?))
}

/// The larger share of one scan's points in the other's free space; `None` without scans.
pub(super) fn contradiction_share(
    old: &Keyframe,
    new: &Keyframe,
    old_from_new: &Pose2,
    tolerance: &DepthTolerance,
) -> Option<f64> {
    let share = |of: &Keyframe, seen_by: &Keyframe, pose: &Pose2| {
        let (points, views) = (&of.points, seen_by.views()?);
        Some(agreement(points, &views, pose, tolerance).contradiction_share())
    };
    let new_in_old = share(new, old, old_from_new)?;
    let old_in_new = share(old, new, &old_from_new.inverse())?;
    Some(new_in_old.max(old_in_new))
}

#[cfg(test)]
mod tests;
