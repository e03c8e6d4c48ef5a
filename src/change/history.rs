//! The history of one spot: occupied or free, as all looks at it tell.
//!
//! A spot is a hidden Markov chain of two states over its *visits*. Within a visit looks are not
//! independent (someone stands still, a pose is off), so what one visit can say is limited; two
//! visits, or many views of one, can say more than a change costs.

use std::collections::BTreeMap;

use super::look::Sight;
use crate::ids::{NodeId, StampNs};

/// Probability that a look strikes what stands there: beams pass beside thin things.
const STRUCK_IF_OCCUPIED: f64 = 0.75;
/// Probability that a look strikes where nothing stands: people, noise, a pose that is off.
const STRUCK_IF_FREE: f64 = 0.1;
/// What a look more lets a visit say at most, in nats.
const VISIT_LIMIT_PER_LOOK: f64 = 1.0;
/// What a visit can say at most, in nats.
const VISIT_LIMIT: f64 = 10.0;
/// What a change of state costs, in nats: changes are rare.
const CHANGE_COST: f64 = 4.6;
/// Looks of a trip belong to one visit if they are no more keyframes than this apart from its
/// first.
const VISIT_KEYFRAMES: usize = 24;

/// What one look said.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Seen {
    /// The node.
    pub node: NodeId,
    /// Number of its trip.
    pub trip: usize,
    /// Its place among the looks of its trip.
    pub order: usize,
    /// When.
    pub stamp: StampNs,
    /// Struck or passed.
    pub sight: Sight,
}

/// Whether something stands there.
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

    /// The look that shows it.
    pub fn sight(self) -> Sight {
        match self {
            Self::Free => Sight::Passed,
            Self::Occupied => Sight::Struck,
        }
    }
}

/// A stretch of looks of one trip.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Visit {
    first: StampNs,
    /// Places in the looks, from and to.
    looks: (usize, usize),
    /// log p(looks | occupied) − log p(looks | free), limited.
    occupied_over_free: f64,
}

/// A departure from the state in which the spot was first seen.
#[derive(Debug, Clone, PartialEq)]
pub struct Departure {
    /// The state in which it was first seen.
    pub baseline: State,
    /// The first look that shows the other state.
    pub since: StampNs,
    /// The last look that shows it.
    pub last_seen: StampNs,
    /// The first look that shows the baseline again; `None` while the departure stands.
    pub until: Option<StampNs>,
    /// Nodes whose looks show the other state within it, in the order of time.
    pub nodes: Vec<NodeId>,
    /// Trips of those.
    pub trips: Vec<usize>,
    /// How often a trip came by and saw it.
    pub passes: usize,
    /// log of how much better a history with changes explains the looks than one without,
    /// the cost of the changes included.
    pub support: f64,
}

/// The last departure of a spot from its baseline, if the looks support any. `seen` may be in any
/// order; looks that saw nothing are left out by the caller.
pub fn last_departure(mut seen: Vec<Seen>) -> Option<Departure> {
    seen.sort_by_key(|look| (look.trip, look.order));
    let mut visits = visits(&seen);
    visits.sort_by_key(|visit| (visit.first, visit.looks));
    let (states, support) = most_likely(&visits);
    let baseline = *states.first()?;
    let end = states.iter().rposition(|state| *state != baseline)? + 1;
    let start = states[..end].iter().rposition(|state| *state == baseline)? + 1;
    let showing = baseline.other().sight();
    let within = visits[start..end].iter();
    let mut looks: Vec<&Seen> = within
        .flat_map(|visit| &seen[visit.looks.0..visit.looks.1])
        .filter(|look| look.sight == showing)
        .collect();
    looks.sort_by_key(|look| (look.stamp, look.node));
    let (since, last_seen) = (looks.first()?.stamp, looks.last()?.stamp);
    let back = |visit: &Visit| {
        let looks = &seen[visit.looks.0..visit.looks.1];
        let shows = looks.iter().find(|look| look.sight == baseline.sight());
        shows.map(|look| look.stamp)
    };
    let mut trips: Vec<usize> = looks.iter().map(|look| look.trip).collect();
    trips.sort_unstable();
    trips.dedup();
    Some(Departure {
        baseline,
        since,
        last_seen,
        until: visits[end..].iter().find_map(back),
        nodes: looks.iter().map(|look| look.node).collect(),
        trips,
        passes: passes(&looks),
        support,
    })
}

/// Runs of looks of one trip without a long break; `looks` in the order of time.
fn passes(looks: &[&Seen]) -> usize {
    let mut last_of: BTreeMap<usize, usize> = BTreeMap::new();
    let mut passes = 0;
    for look in looks {
        let last = last_of.insert(look.trip, look.order);
        let goes_on = last.is_some_and(|order| look.order.abs_diff(order) <= VISIT_KEYFRAMES);
        passes += usize::from(!goes_on);
    }
    passes
}

fn visits(seen: &[Seen]) -> Vec<Visit> {
    let mut visits = Vec::new();
    let mut start = 0;
    for end in 1..=seen.len() {
        let first = &seen[start];
        let goes_on = seen.get(end).is_some_and(|look| {
            look.trip == first.trip && look.order < first.order + VISIT_KEYFRAMES
        });
        if !goes_on {
            visits.push(Visit {
                first: first.stamp,
                looks: (start, end),
                occupied_over_free: evidence(&seen[start..end]),
            });
            start = end;
        }
    }
    visits
}

fn evidence(looks: &[Seen]) -> f64 {
    let struck = (STRUCK_IF_OCCUPIED / STRUCK_IF_FREE).ln();
    let passed = ((1.0 - STRUCK_IF_OCCUPIED) / (1.0 - STRUCK_IF_FREE)).ln();
    let sum: f64 = looks
        .iter()
        .map(|look| match look.sight {
            Sight::Struck => struck,
            Sight::Passed => passed,
            Sight::Hidden => 0.0,
        })
        .sum();
    let limit = (VISIT_LIMIT_PER_LOOK * looks.len() as f64).min(VISIT_LIMIT);
    sum.clamp(-limit, limit)
}

/// The most likely states, and by how much they beat the best history without a change.
fn most_likely(visits: &[Visit]) -> (Vec<State>, f64) {
    let mut best = [0.0_f64, 0.0];
    let mut constant = [0.0_f64, 0.0];
    let mut came_from = Vec::with_capacity(visits.len());
    for visit in visits {
        let half = 0.5 * visit.occupied_over_free;
        let gains = [-half, half];
        let from = [0, 1].map(|state: usize| {
            let changed = best[1 - state] - CHANGE_COST;
            if changed > best[state] {
                1 - state
            } else {
                state
            }
        });
        best = [0, 1].map(|state: usize| {
            let changed = best[1 - state] - CHANGE_COST;
            best[state].max(changed) + gains[state]
        });
        constant = [constant[0] + gains[0], constant[1] + gains[1]];
        came_from.push(from);
    }
    let mut state = usize::from(best[1] > best[0]);
    let support = best[state] - constant[0].max(constant[1]);
    let mut states = vec![State::Free; visits.len()];
    for (k, from) in came_from.iter().enumerate().rev() {
        states[k] = if state == 1 {
            State::Occupied
        } else {
            State::Free
        };
        state = from[state];
    }
    (states, support)
}

#[cfg(test)]
mod tests;
