//! One site: a few square metres where something may have changed, judged by all observations of it. Begin
//! with [`state_changes`].
//!
//! Findings are a function of the set of observations and their poses, not of the order of arrival. The rule
//! and its constants come from recordings; `docs/explanation/detection.md` measures the worth of each step.

mod answers;
mod cells;
mod cluster;
mod misplaced;
mod pass_outcomes;
mod pooled;
mod shift;
mod state_changes;
mod surroundings;
mod timeline;

pub use self::pass_outcomes::{PassSeen, Presence, pass_outcomes};
pub use self::pooled::support_min;
pub use self::state_changes::state_changes;
use super::pass::Standpoint;
use super::{AcceptedChange, Agreement, Fit};
use crate::geometry::{Pose2, Vector2};
use crate::ids::{NodeId, StampNs, TripId};
use crate::observation::Observation;

/// An observation of a map.
#[derive(Debug, Clone)]
pub struct Observed {
    /// Its keyframe, or the one that it follows.
    pub node: NodeId,
    /// Which: the keyframe's own (0), or its first, second … intermediate scan.
    pub place: u32,
    /// Number of its trip.
    pub trip: usize,
    /// When it was taken.
    pub stamp: StampNs,
    /// Pose of the base in the map.
    pub map_from_base: Pose2,
    /// The scan at this pose, or at the one where it fits other passes.
    pub observation: Observation,
    /// How well it fits other passes over its whole range.
    pub agreement: Agreement,
}

impl Observed {
    /// Moves it to where it fits other passes.
    pub fn refit(&mut self, fit: &Fit) {
        if fit.map_from_base != self.map_from_base {
            self.observation =
                Observation::new(&self.observation.scan().clone(), &fit.map_from_base);
        }
        self.agreement = fit.agreement;
    }

    /// When, by which trip and from where.
    pub fn standpoint(&self) -> Standpoint {
        Standpoint {
            trip: self.trip,
            stamp: self.stamp,
            eye: self.observation.eye(),
        }
    }
}

/// A site to judge.
pub struct Site<'a> {
    /// Centres of the candidate cells, map frame, metres.
    pub candidates: &'a [Vector2<f64>],
    /// Centres of all candidate cells in the surroundings, map frame, metres.
    pub changed_around: &'a [Vector2<f64>],
    /// The observations, in the order of trip and time.
    pub observations: Vec<Observed>,
    /// Accepted changes: in their regions earlier observations do not count.
    pub accepted: &'a [AcceptedChange],
    /// The trips by the number that observations have.
    pub trips: &'a [TripId],
    /// Least support of a change, in nats: [`support_min`].
    pub support_min: f64,
}

#[cfg(test)]
mod tests;
