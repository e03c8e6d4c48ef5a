//! One site: a few square metres where something may have changed, judged by every observation
//! of it: [`state_changes`].
//!
//! What is found is a function of the set of observations and their poses, not of the order in
//! which they arrived. The rule and its constants come from recordings; `docs/explanation/detection.md` has
//! what each step is worth.

mod answers;
mod cells;
mod cluster;
mod pass_outcomes;
mod pooled;
mod shift;
mod state_changes;
mod surroundings;
mod timeline;
mod void;

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
    /// The keyframe that it is of, or follows.
    pub node: NodeId,
    /// Which: the keyframe's own (0), or its first, second … intermediate scan.
    pub place: u32,
    /// Number of its trip.
    pub trip: usize,
    /// When it was taken.
    pub stamp: StampNs,
    /// Where the base was, as the map has it.
    pub map_from_base: Pose2,
    /// The scan at its pose, or where it fits what other passes found.
    pub observation: Observation,
    /// How well it fits what other passes found, wherever it looked.
    pub agreement: Agreement,
}

impl Observed {
    /// Moves it to where it fits what other passes found.
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

/// What is judged together.
pub struct Site<'a> {
    /// Centres of the cells that may have changed, map frame, metres.
    pub candidates: &'a [Vector2<f64>],
    /// Centres of all cells in the surroundings that may have changed.
    pub changed_around: &'a [Vector2<f64>],
    /// Those who are asked, in the order of trip and time.
    pub observations: Vec<Observed>,
    /// Accepted changes: in their regions what was observed before them is out of date.
    pub accepted: &'a [AcceptedChange],
    /// Names of the trips that observations number.
    pub trips: &'a [TripId],
    /// How much better a change must explain the passes than none, in nats: [`support_min`].
    pub support_min: f64,
}

#[cfg(test)]
mod tests;
