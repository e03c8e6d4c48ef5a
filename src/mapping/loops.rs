//! Which older keyframes a new one is tied to, and where it is for that.

use super::anchor;
use super::closure::{self, ClosureMeasurement};
use super::confirmation::{FROM_AFAR, confirm};
use super::corridor;
use super::drift::{DRIFT_FAR_M, DRIFT_SMALL_M, is_search_due, slack_after, slack_small};
use super::partners::{self, PARTNER_DISTANCE_MAX_M, Placed};
use super::route_map::{RouteMap, Weighting};
use crate::geometry::Pose2;
use crate::graph::{EdgeKind, EdgeStatus};

/// A trip's newest keyframes are no partners for its next one.
pub(super) const RECENT_KEYFRAMES: usize = 20;
/// A trip that comes from afar is found by what it saw on so much of its way, metres.
const STRETCH_M: f64 = 10.0;
/// A place found farther than this from where the trip is expected is another one, metres: if its
/// last metres look like both, it is tied to neither.
const RIVAL_FROM_M: f64 = 1.5;
/// A closure fixes a place in all directions if it says it to this in each, standard deviation, metres.
const FIXED_SIGMA_MAX_M: f64 = 0.1;

/// How far a trip may have drifted when it was at one of its keyframes, metres …
struct Drift {
    now_m: f64,
    /// … and at the keyframe before.
    before_m: f64,
}

impl RouteMap {
    /// The closures of the keyframe at `index` with reference nodes, each with its partner's place.
    pub(super) fn find_closures(&self, index: usize) -> Vec<(usize, ClosureMeasurement)> {
        let new = self.placed(index);
        let drift = self.drift_at(index);
        let within_m = PARTNER_DISTANCE_MAX_M + slack_after(drift.now_m).distance_m;
        let nearby = self.references_near(index, &new.pose, within_m);
        let Some(pose) = self.expected_among(index, &nearby, &drift) else {
            return Vec::new();
        };
        let expected = Placed { pose, ..new };
        // A search looks farther than scans have much in common.
        let within_m = PARTNER_DISTANCE_MAX_M + slack_after(new.keyframe.drift_m).distance_m;
        let nearby = partners::within(within_m, &pose, &nearby);
        let chosen = match self.weighting {
            Weighting::Robust => partners::choose(&expected, &nearby),
            Weighting::AllPointsIdentity => Vec::from_iter(partners::nearest(&expected, &nearby)),
            Weighting::Paper => Vec::from_iter(partners::nearest_of_any(&expected, &nearby)),
        };
        let measured = chosen.iter().filter_map(|old| {
            let found = self.measure_closure(old, &expected)?;
            Some((self.graph.node_position(old.keyframe.node)?, found))
        });
        measured.collect()
    }

    /// Where the keyframe at `index` is expected among references: where the odometry has it, where a
    /// search finds it if it has drifted far, and where it fits along the corridor that it is in.
    ///
    /// `None` without references, and where a trip that is not tied to the map is not found.
    fn expected_among(&self, index: usize, nearby: &[Placed<'_>], drift: &Drift) -> Option<Pose2> {
        if nearby.is_empty() {
            return None;
        }
        let new = self.placed(index);
        let is_paper = self.weighting == Weighting::Paper;
        let is_due =
            drift.now_m > DRIFT_SMALL_M && (is_paper || is_search_due(drift.before_m, drift.now_m));
        let found = is_due.then(|| self.found_again(index, nearby, drift.now_m));
        let is_tied = new.keyframe.drift_m <= DRIFT_SMALL_M;
        let pose = match found.flatten() {
            Some(found) => found,
            // A search that finds nothing is no gate of the paper's, which trusts the position
            // (section 3).
            None if is_tied || is_paper => new.pose,
            None => return None,
        };
        let far_m = slack_after(drift.now_m).distance_m;
        let along = self.along_corridor(index, nearby, &pose);
        let along = along.filter(|along| partners::way_m(along, &pose) <= far_m);
        Some(along.unwrap_or(pose))
    }

    /// A closure of an expected keyframe with a reference.
    fn measure_closure(
        &self,
        old: &Placed<'_>,
        expected: &Placed<'_>,
    ) -> Option<ClosureMeasurement> {
        let old_from_new = old.pose.between(&expected.pose);
        let slack = slack_small(expected.keyframe.drift_m);
        let rule = &self.closure_rule;
        match self.weighting {
            Weighting::Robust | Weighting::AllPointsIdentity => {
                closure::measure(old, expected, &old_from_new, &slack, rule)
            }
            Weighting::Paper => closure::measure_by_score(old, expected, &old_from_new, rule),
        }
    }

    /// Where the keyframe at `index` is among references, for a trip that has driven `drift_m` without
    /// being tied to the map. Where it comes from afar, all that its last metres show must agree: the
    /// place that it first looks like may be another one of the kind.
    fn found_again(&self, index: usize, nearby: &[Placed<'_>], drift_m: f64) -> Option<Pose2> {
        let (new, slack) = (self.placed(index), slack_after(drift_m));
        let found = anchor::relocate(&self.local_map(index), nearby, &new.pose, &slack)?;
        if drift_m <= DRIFT_FAR_M || self.weighting == Weighting::Paper {
            return Some(found);
        }
        let within_m = PARTNER_DISTANCE_MAX_M + slack.distance_m + STRETCH_M;
        let around = self.references_near(index, &new.pose, within_m);
        let stretch = self.stretch_before(index);
        let stretch: Vec<Placed<'_>> = stretch.iter().map(|&k| self.placed(k)).collect();
        let is_shown = |place: &Pose2| {
            let references = self.held_by(&new, place, &around);
            let map_from_own = place.compose(&new.pose.inverse());
            confirm(&references, &stretch, &map_from_own, &FROM_AFAR).is_ok()
        };
        if !is_shown(&found) {
            return None;
        }
        // At the border of what the map shows, the score of a search rises towards what it shows.
        let is_far = partners::way_m(&found, &new.pose) > RIVAL_FROM_M;
        if is_far && is_shown(&new.pose) {
            return None;
        }
        Some(found)
    }

    /// Of references those that stay where they are if the trip is tied at the place found: of its own
    /// only those that were taken about when its partners there were. Later ones would move with it.
    fn held_by<'a>(
        &self,
        new: &Placed<'a>,
        found: &Pose2,
        references: &[Placed<'a>],
    ) -> Vec<Placed<'a>> {
        let expected = Placed {
            pose: *found,
            ..*new
        };
        let partners = partners::choose(
            &expected,
            &partners::within(PARTNER_DISTANCE_MAX_M, found, references),
        );
        let is_own = |placed: &Placed<'_>| placed.keyframe.trip == new.keyframe.trip;
        let orders = partners.iter().filter(|partner| is_own(partner));
        let orders: Vec<u32> = orders.map(|partner| partner.keyframe.trip_order).collect();
        let is_beside_partner = |placed: &Placed<'_>| {
            let order = placed.keyframe.trip_order;
            (orders.iter()).any(|at| order.abs_diff(*at) as usize <= RECENT_KEYFRAMES)
        };
        let held = references.iter().copied();
        held.filter(|placed| !is_own(placed) || is_beside_partner(placed))
            .collect()
    }

    /// The keyframes on a trip's last metres up to one of them, the oldest first.
    fn stretch_before(&self, last: usize) -> Vec<usize> {
        let trip = self.trip_up_to(last);
        let mut driven_m = 0.0;
        let before = trip.windows(2).rev().take_while(|two| {
            driven_m += self.step_m(two[0], two[1]);
            driven_m <= STRETCH_M && self.is_lost(two[0]) == self.is_lost(last)
        });
        let mut stretch: Vec<usize> = before.map(|two| two[0]).collect();
        stretch.reverse();
        stretch.push(last);
        stretch
    }

    /// Where the keyframe at `index`, expected at `pose`, is along the corridor that it is in, if it
    /// is in one. The paper's matches are of single scans.
    fn along_corridor(
        &self,
        index: usize,
        references: &[Placed<'_>],
        pose: &Pose2,
    ) -> Option<Pose2> {
        if self.weighting != Weighting::Robust {
            return None;
        }
        let keyframe = &self.keyframes[index];
        let sigma_m = keyframe.range_sigma_m()?;
        let local_map = || self.local_map(index);
        corridor::find_along(&keyframe.points, local_map, references, pose, sigma_m)
    }

    /// Reference nodes around a pose that are not the trip's newest; of the layer of the one at
    /// `index`, if there are any.
    pub(super) fn references_near(
        &self,
        index: usize,
        pose: &Pose2,
        within_m: f64,
    ) -> Vec<Placed<'_>> {
        let trip = &self.trips[&self.keyframes[index].trip];
        let recent = trip.len().saturating_sub(RECENT_KEYFRAMES + 1);
        let recent = &trip[recent..];
        let nodes = self.graph.nodes();
        let near =
            |k: &usize| (nodes[*k].pose.translation() - pose.translation()).norm() <= within_m;
        let near = (0..self.keyframes.len())
            .filter(|k| self.is_reference_with_scan(*k) && !recent.contains(k))
            .filter(near)
            .map(|k| self.placed(k))
            .collect();
        self.of_layer_first(self.keyframes[index].layer(), near)
    }

    /// How far a trip may have drifted at its keyframe at `index` since it was tied to the map. Along
    /// a bare corridor closures tie it across only: where that lasts, it is the way since one that
    /// fixed its place in all directions.
    fn drift_at(&self, index: usize) -> Drift {
        let before = match *self.trip_up_to(index) {
            [.., before, _] => Some(before),
            _ => None,
        };
        let drift = Drift {
            now_m: self.keyframes[index].drift_m,
            before_m: before.map_or(0.0, |before| self.keyframes[before].drift_m),
        };
        if drift.now_m > DRIFT_SMALL_M || self.weighting != Weighting::Robust {
            return drift;
        }
        let unfixed_m = self.unfixed_m(index);
        match before {
            Some(before) if unfixed_m > DRIFT_FAR_M => Drift {
                now_m: unfixed_m,
                before_m: unfixed_m - self.step_m(before, index),
            },
            _ => drift,
        }
    }

    /// The way of a trip up to its keyframe at `index` since its start, or since a keyframe that a
    /// closure fixes in all directions, metres.
    fn unfixed_m(&self, index: usize) -> f64 {
        let steps = self.trip_up_to(index).windows(2).rev();
        let mut way_m = 0.0;
        for two in steps {
            way_m += self.step_m(two[0], two[1]);
            if self.is_fixed(two[0]) {
                break;
            }
        }
        way_m
    }

    fn is_fixed(&self, k: usize) -> bool {
        let edges = self.graph.incident(k).iter();
        let mut edges = edges.map(|&edge| &self.graph.edges()[edge]);
        edges.any(|edge| {
            edge.kind == EdgeKind::LoopClosure
                && edge.status == EdgeStatus::Active
                && edge.information.least_xy() >= FIXED_SIGMA_MAX_M.powi(-2)
        })
    }

    fn step_m(&self, from: usize, to: usize) -> f64 {
        let nodes = self.graph.nodes();
        partners::way_m(&nodes[from].pose, &nodes[to].pose)
    }
}
