//! The history of a place over its passes: free or occupied, and when that changed.
//!
//! A hidden Markov chain of two states over passes. Within a pass observations are not independent (someone
//! stands still, a pose is off), so the weight of a pass is limited.

use std::ops::Range;

/// Cost of a change of state, in nats: changes are rare.
pub const CHANGE_COST: f64 = 4.6;
/// log p(hit | occupied) − log p(hit | free) of one cell, and the reverse for a miss, in nats.
pub const NATS_PER_OBSERVATION: f64 = 1.5;
/// Weight of a no-return, in misses, if it counts for the lidar.
pub const NO_RETURN_WORTH: f64 = 0.3;
/// Largest weight of a pass in one cell, in nats.
pub const NATS_PER_PASS: f64 = 10.0;

/// Whether a place is free or occupied.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum State {
    /// Nothing.
    Free,
    /// Something.
    Occupied,
}

impl State {
    /// The other one.
    pub fn other(self) -> Self {
        match self {
            Self::Free => Self::Occupied,
            Self::Occupied => Self::Free,
        }
    }
}

/// The most likely states over the passes.
#[derive(Debug, Clone, PartialEq)]
pub struct History {
    /// The state at each pass.
    pub states: Vec<State>,
    /// How much better it explains the passes than one state throughout, in nats, with the cost of its
    /// changes; 0 without a change.
    pub support: f64,
}

impl History {
    /// From the evidence of each pass, in the order of time: log p(observations | occupied) −
    /// log p(observations | free), limited by the caller.
    pub fn of(passes: impl IntoIterator<Item = f64>) -> Self {
        let (mut free, mut occupied) = (0.0_f64, 0.0_f64);
        let mut always = 0.0;
        // Whether the best way to each state came from the other one.
        let mut switched: Vec<(bool, bool)> = Vec::new();
        for occupied_over_free in passes {
            let half = 0.5 * occupied_over_free;
            let to_free = occupied - CHANGE_COST > free;
            let to_occupied = free - CHANGE_COST > occupied;
            switched.push((to_free, to_occupied));
            (free, occupied) = (
                free.max(occupied - CHANGE_COST) - half,
                occupied.max(free - CHANGE_COST) + half,
            );
            always += half;
        }
        let mut state = if occupied > free {
            State::Occupied
        } else {
            State::Free
        };
        let mut states = vec![state; switched.len()];
        for (at, (to_free, to_occupied)) in states.iter_mut().zip(&switched).rev() {
            *at = state;
            state = match state {
                State::Free if *to_free => State::Occupied,
                State::Occupied if *to_occupied => State::Free,
                same => same,
            };
        }
        Self {
            states,
            support: (free.max(occupied) - always.abs()).max(0.0),
        }
    }

    /// The last run of passes in another state than the first one's; `None` without a change.
    pub fn last_change(&self) -> Option<Range<usize>> {
        let baseline = *self.states.first()?;
        let end = self.states.iter().rposition(|state| *state != baseline)? + 1;
        let before = self.states[..end].iter().rposition(|s| *s == baseline)?;
        Some(before + 1..end)
    }

    /// The state in which the place was first seen.
    pub fn baseline(&self) -> Option<State> {
        self.states.first().copied()
    }
}

/// The evidence of a pass, limited to `limit` in nats.
pub fn limited(sum: f64, limit: f64) -> f64 {
    limit * (sum / limit).tanh()
}

#[cfg(test)]
mod tests;
