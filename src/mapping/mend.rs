//! Segments of a trip that lie in the wrong place, put right where scans prove where they belong.
//!
//! A mismatch says that a segment does not fit the map, perhaps with the shift that would mend it.
//! Its keyframes are then matched anew with what was there before, each by itself and begun where
//! the shift has it. Where several of them, spread over the segment, end in the same place, pass
//! what every closure must pass, and fit there plainly better than where they lie, they are tied
//! there. One match alone moves nothing, and where nothing is proven the map stays as it is.

use std::collections::BTreeSet;

use super::closure::Closure;
use super::evidence::Scope;
use super::route_map::{RouteMap, Weighting};
use crate::change::{ChangeKind, Finding};
use crate::geometry::{Pose2, Vector2};
use crate::graph::{EdgeKind, EdgeStatus, GraphError, PoseGraph};
use crate::ids::{EdgeId, NodeId, TripId};

mod segment;
mod verdict;
mod vote;

use segment::Vote;
use verdict::{Verdict, agreed};

/// Closures that end this far from where the keyframes belong contradict them, metres, …
const CONTRADICTION_M: f64 = 0.1;
/// … or this share of the shift, if that is more.
const CONTRADICTION_SHARE: f64 = 0.5;
/// A step of odometry whose eᵀΩe is more is false: ten standard deviations.
const STEP_COST_MAX: f64 = 100.0;
/// A segment is tied anew so often, each time without what contradicted the time before.
const ROUNDS_MAX: usize = 6;
/// Keyframes must come to lie as near as this to where they were matched, metres.
const ARRIVED_M: f64 = 0.05;

/// A segment that was put right.
#[derive(Debug, Clone, PartialEq)]
pub struct Mending {
    /// What was found to be wrong.
    pub mismatch: Finding,
    /// By which the segment was moved, map frame, metres: the median of its matches.
    pub shift: Vector2<f64>,
    /// The closures that prove it; they are in the graph.
    pub closures: Vec<Closure>,
    /// Closures that held the segment in the wrong place, quarantined now.
    pub quarantined: Vec<EdgeId>,
}

/// What a mending may change, to be put back if it fails.
struct Before {
    graph: PoseGraph,
    next_edge: EdgeId,
}

/// A mismatch is the one that was known before if its shift differs by no more, metres.
const SAME_SHIFT_M: f64 = 0.05;

impl RouteMap {
    /// As [`RouteMap::findings`], once the mismatches among them are mended as far as scans prove
    /// where their segments belong: what a wrong place alone had shown is gone then. What was known
    /// before is not tried again.
    ///
    /// # Errors
    /// [`GraphError`] if an id was used twice; the map is lost then.
    pub fn findings_and_mendings(
        &mut self,
        scope: &Scope<'_>,
        known: &[Finding],
    ) -> Result<(Vec<Finding>, Vec<Mending>), GraphError> {
        let (found, hints) = self.findings_and_hints(scope);
        let is_news = |finding: &&Finding| !known.iter().any(|known| is_same(known, finding));
        let news = found.iter().chain(&hints).filter(is_news);
        let news: Vec<Finding> = news.cloned().collect();
        let mendings = self.mend(&news)?;
        if mendings.is_empty() {
            return Ok((found, mendings));
        }
        let is_mended = |finding: &Finding| mendings.iter().any(|m| m.mismatch == *finding);
        let pending: Vec<Finding> = found.into_iter().filter(|f| !is_mended(f)).collect();
        let again = Scope {
            pending: &pending,
            ..*scope
        };
        Ok((self.findings(&again), mendings))
    }

    /// Puts those segments right that mismatches tell of, and of which the scans prove where they
    /// belong; what nothing proves stays where it is.
    ///
    /// Nodes that move take their observations along. Only a map of robust closures is mended.
    ///
    /// # Errors
    /// [`GraphError`] if an id was used twice; the map is lost then.
    pub fn mend(&mut self, mismatches: &[Finding]) -> Result<Vec<Mending>, GraphError> {
        let mut mended = Vec::new();
        if self.weighting != Weighting::Robust {
            return Ok(mended);
        }
        let is_mismatch = |finding: &&Finding| finding.kind == ChangeKind::MapMismatch;
        for mismatch in mismatches.iter().filter(is_mismatch) {
            mended.extend(self.mend_segment(mismatch)?);
        }
        if !mended.is_empty() {
            self.forget_solves();
        }
        Ok(mended)
    }

    fn mend_segment(&mut self, mismatch: &Finding) -> Result<Option<Mending>, GraphError> {
        let Some(segment) = self.segment_of(mismatch) else {
            return Ok(None);
        };
        let votes = self.votes_of(&segment);
        let Some(verdict) = agreed(votes, &segment) else {
            return Ok(None);
        };
        let verdict = self.followed_outwards(verdict, &segment);
        let before = Before {
            graph: self.graph.clone(),
            next_edge: self.next_edge_id(),
        };
        let mut quarantined = self.holding(&verdict);
        for _ in 0..ROUNDS_MAX {
            let closures = self.tie(&verdict, &quarantined)?;
            let more = self.contradicting(&verdict, &before.graph);
            if more.is_empty() {
                if !self.have_arrived(&verdict.votes) {
                    break;
                }
                self.settle_in(&verdict);
                return Ok(Some(Mending {
                    mismatch: mismatch.clone(),
                    shift: verdict.shift,
                    closures,
                    quarantined,
                }));
            }
            let is_outvoted = more.len() > closures.len();
            quarantined.extend(more);
            self.put_back(&before);
            if is_outvoted {
                break;
            }
        }
        self.put_back(&before);
        Ok(None)
    }

    /// Ties a segment where its keyframes belong, without the edges that held it elsewhere.
    fn tie(
        &mut self,
        verdict: &Verdict,
        quarantined: &[EdgeId],
    ) -> Result<Vec<Closure>, GraphError> {
        let statuses = quarantined
            .iter()
            .map(|edge| (*edge, EdgeStatus::Quarantined));
        self.restate_edges(&statuses.collect::<Vec<_>>());
        for &k in &verdict.places {
            let moved = self.graph.nodes()[k].pose.shifted(&verdict.shift);
            self.graph.set_pose_at(k, moved);
        }
        self.insert_votes(&verdict.votes)
    }

    /// What disagrees with where a segment is now: the step of odometry that does so most, else
    /// closures that fitted before.
    fn contradicting(&self, verdict: &Verdict, before: &PoseGraph) -> Vec<EdgeId> {
        match self.most_strained_step(verdict) {
            Some(step) => vec![step],
            None => self.strained(verdict, before),
        }
    }

    fn put_back(&mut self, before: &Before) {
        self.graph = before.graph.clone();
        self.set_next_edge(before.next_edge);
        self.forget_solves();
    }

    /// The step of odometry into a segment, within it or out of it that least agrees with where the
    /// segment is now, if that is beyond belief.
    fn most_strained_step(&self, verdict: &Verdict) -> Option<EdgeId> {
        let at_segment = verdict.places.iter().flat_map(|&k| self.graph.incident(k));
        let steps: BTreeSet<usize> = at_segment.copied().collect();
        let strained = steps.into_iter().filter_map(|position| {
            let edge = &self.graph.edges()[position];
            let is_step = edge.kind == EdgeKind::Odometry && edge.status == EdgeStatus::Active;
            let error = self.graph.error_of(edge).filter(|_| is_step)?;
            let cost = edge.information.squared_norm(&error);
            (cost > STEP_COST_MAX).then_some((cost, edge.id))
        });
        let worst = strained.max_by(|a, b| a.0.total_cmp(&b.0).then(b.1.cmp(&a.1)));
        worst.map(|(_, edge)| edge)
    }

    /// The closures that tie a segment to older nodes where it does not belong.
    fn holding(&self, verdict: &Verdict) -> Vec<EdgeId> {
        let nodes = self.graph.nodes();
        let moved: BTreeSet<usize> = verdict.places.iter().copied().collect();
        let bound_m = contradiction_m(&verdict.shift);
        let mut holding = Vec::new();
        for &k in &verdict.places {
            for &edge in self.graph.incident(k) {
                let (from, to) = self.graph.ends()[edge];
                let edge = &self.graph.edges()[edge];
                let is_tie = edge.kind == EdgeKind::LoopClosure
                    && edge.status == EdgeStatus::Active
                    && to == k
                    && !moved.contains(&from);
                if !is_tie {
                    continue;
                }
                let tied_at = nodes[from].pose.compose(&edge.measurement).translation();
                let belongs = nodes[k].pose.translation() + verdict.shift;
                if (tied_at - belongs).norm() > bound_m {
                    holding.push(edge.id);
                }
            }
        }
        holding
    }

    fn insert_votes(&mut self, votes: &[Vote]) -> Result<Vec<Closure>, GraphError> {
        let closures = votes.iter().flat_map(|vote| {
            let closures = vote.closures.iter();
            closures.map(|(partner, measurement)| ([*partner, vote.place], measurement))
        });
        self.insert_closures(closures)
    }

    /// Closures of nodes that have moved that fitted before and do not now.
    fn strained(&self, verdict: &Verdict, before: &PoseGraph) -> Vec<EdgeId> {
        let bound_m = contradiction_m(&verdict.shift);
        let off_m = |graph: &PoseGraph, edge| {
            let error = graph.error_of(edge);
            error.map_or(0.0, |error| error.fixed_rows::<2>(0).norm())
        };
        let known = before.edges().iter().zip(self.graph.edges());
        let strained = known.filter(|(then, now)| {
            now.kind == EdgeKind::LoopClosure
                && now.status == EdgeStatus::Active
                && off_m(&self.graph, now) > bound_m
                && off_m(before, then) <= bound_m
        });
        strained.map(|(_, now)| now.id).collect()
    }

    fn have_arrived(&self, votes: &[Vote]) -> bool {
        let nodes = self.graph.nodes();
        votes.iter().all(|vote| {
            let off = nodes[vote.place].pose.translation() - vote.pose.translation();
            off.norm() <= ARRIVED_M
        })
    }

    /// What follows for the keyframes of a segment that lies where it belongs: those that other
    /// references cover are none any more, and the way since the last tie is shorter.
    fn settle_in(&mut self, verdict: &Verdict) {
        let moved: BTreeSet<usize> = verdict.places.iter().copied().collect();
        for &k in &verdict.places {
            let layer = self.keyframes[k].layer();
            let pose = self.graph.nodes()[k].pose;
            let others = (0..self.keyframes.len()).filter(|other| {
                !moved.contains(other)
                    && self.is_reference_with_scan(*other)
                    && self.keyframes[*other].layer() == layer
            });
            let others = others.map(|other| self.graph.nodes()[other].pose);
            if super::partners::is_covered(&pose, others) {
                self.keyframes[k].reference = false;
            }
        }
        for vote in &verdict.votes {
            self.shorten_drift(vote.place);
        }
    }

    /// Counts the way of a trip from a keyframe that is tied now, up to the next that was.
    fn shorten_drift(&mut self, tied: usize) {
        let drift_m = self.keyframes[tied].drift_m;
        let trip = &self.trips[&self.keyframes[tied].trip];
        let since = trip.iter().skip_while(|k| **k != tied);
        let since: Vec<usize> = since
            .copied()
            .take_while(|&k| self.keyframes[k].drift_m >= drift_m)
            .collect();
        for k in since {
            self.keyframes[k].drift_m -= drift_m;
        }
    }

    /// The keyframes of a trip that a mismatch tells of, as places in the order of the drive.
    pub(super) fn places_of(&self, trip: &TripId, mismatch: &Finding) -> Vec<usize> {
        let trip = self.trips.get(trip).map_or(&[][..], Vec::as_slice);
        let is_of_segment = |k: &usize| {
            let keyframe = &self.keyframes[*k];
            (mismatch.since..=mismatch.last_seen).contains(&keyframe.stamp)
                && keyframe.scan.is_some()
                && !keyframe.is_lost()
        };
        trip.iter().copied().filter(is_of_segment).collect()
    }

    /// The nodes of a segment that a mismatch tells of, ascending, and their poses.
    pub(super) fn nodes_of_segment(&self, mismatch: &Finding) -> Vec<(NodeId, Pose2)> {
        let places = mismatch
            .trips
            .iter()
            .flat_map(|trip| self.places_of(trip, mismatch));
        let mut nodes: Vec<(NodeId, Pose2)> = places
            .map(|k| (self.keyframes[k].node, self.graph.nodes()[k].pose))
            .collect();
        nodes.sort_unstable_by_key(|(node, _)| *node);
        nodes
    }
}

fn is_same(a: &Finding, b: &Finding) -> bool {
    let shifts_alike = match (&a.shift, &b.shift) {
        (Some(a), Some(b)) => (a - b).norm() <= SAME_SHIFT_M,
        (a, b) => a.is_some() == b.is_some(),
    };
    shifts_alike
        && (a.kind, &a.trips, a.since, a.last_seen) == (b.kind, &b.trips, b.since, b.last_seen)
}

fn contradiction_m(shift: &Vector2<f64>) -> f64 {
    CONTRADICTION_M.max(CONTRADICTION_SHARE * shift.norm())
}

#[cfg(test)]
mod tests;
