//! Whether a segment of a trip that may be lost is where its odometry has it.

use super::anchor::{self, AnchorError};
use super::closure;
use super::confirmation::{Confirmation, STRICT, TRUSTING, confirm};
use super::partners::{self, Placed};
use super::route_map::RouteMap;
use crate::geometry::Pose2;

/// A segment is where its odometry has it if what is left of the place fits in this share of the
/// comparisons.
pub(super) const EXPECTED_SHARE_MIN: f64 = 0.6;
/// So many of its newest keyframes say whether the step before it was right.
const NEWEST: usize = 8;

impl RouteMap {
    /// Whether keyframes of a lost segment are where the odometry has them, and it is the place that
    /// has changed: what is left of it fits.
    pub(super) fn are_where_expected(&self, keyframes: &[usize]) -> bool {
        let layer = keyframes.first().and_then(|&k| self.keyframes[k].layer());
        let share = self.fitting_share(keyframes, self.placed_references(layer));
        share.is_some_and(|share| share >= EXPECTED_SHARE_MIN)
    }

    /// Whether keyframes after a step that is not believed agree with the map where they lie: the
    /// step was right after all, and something beside the vehicle was moved. The newest say so, which
    /// have left that behind.
    pub(super) fn agree_as_placed(&self, keyframes: &[usize]) -> bool {
        let newest = &keyframes[keyframes.len().saturating_sub(NEWEST)..];
        self.are_confirmed(newest, &STRICT)
    }

    /// Whether keyframes after a step that is not believed agree one by one with the map where they
    /// lie, though they contradict it, and no place looks more like them: a load has tilted the lidar, say.
    pub(super) fn are_best_here(&self, keyframes: &[usize], elsewhere: &AnchorError) -> bool {
        let first = keyframes.first().map(|&k| self.placed(k).pose);
        let is_here = |best: &Pose2| first.is_some_and(|first| anchor::is_same(best, &first));
        elsewhere.best().is_none_or(is_here) && self.are_confirmed(keyframes, &TRUSTING)
    }

    /// Whether the map confirms keyframes where they lie.
    fn are_confirmed(&self, keyframes: &[usize], confirmation: &Confirmation) -> bool {
        let own: Vec<Placed<'_>> = keyframes.iter().map(|&k| self.placed(k)).collect();
        let layer = own.first().and_then(|own| own.keyframe.layer());
        let references = self.placed_references(layer);
        confirm(&references, &own, &Pose2::IDENTITY, confirmation).is_ok()
    }

    /// In how many of the comparisons of keyframes with references what is left of the place fits, as
    /// a share; `None` if there are fewer than keyframes.
    pub(super) fn fitting_share(
        &self,
        keyframes: &[usize],
        mut references: Vec<Placed<'_>>,
    ) -> Option<f64> {
        let layer = keyframes.first().and_then(|&k| self.keyframes[k].layer());
        // Of another height band little fits in any case.
        references.retain(|old| old.keyframe.layer() == layer);
        let (mut compared, mut fitting) = (0, 0);
        for &k in keyframes {
            let new = self.placed(k);
            for old in partners::choose(&new, &references) {
                compared += 1;
                fitting += usize::from(closure::what_is_left_fits(&old, &new));
            }
        }
        let enough = compared >= keyframes.len().max(1);
        enough.then(|| fitting as f64 / compared as f64)
    }
}

#[cfg(test)]
mod tests {
    use super::super::route_map::Weighting;
    use super::super::testing::{SCANS, drive_through, rooms};
    use super::*;

    #[test]
    fn where_another_place_looks_more_like_it_a_segment_is_not_where_it_lies() {
        let mut map = RouteMap::new(Weighting::Robust);
        let known = drive_through(&rooms(), "known", 0.0, 0..SCANS, |_, motion| motion);
        map.extend(&known).unwrap();
        let segment: Vec<usize> = (0..NEWEST).collect();
        let here = map.placed(segment[0]).pose;
        let there = here.compose(&Pose2::new(2.0, 0.0, 0.0));
        let are_best_beside = |elsewhere| map.are_best_here(&segment, &elsewhere);
        let contradicted = |place| AnchorError::Contradicted {
            place,
            agreeing: 0,
            compared: NEWEST,
        };
        assert!(are_best_beside(AnchorError::Unknown));
        assert!(are_best_beside(contradicted(here)));
        assert!(are_best_beside(AnchorError::Ambiguous(here, there)));
        assert!(!are_best_beside(AnchorError::Ambiguous(there, here)));
        assert!(!are_best_beside(contradicted(there)));
    }
}
