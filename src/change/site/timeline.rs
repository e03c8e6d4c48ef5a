//! Observations in the order of time: passes, and the states that they show.

use std::iter;
use std::ops::Range;

use crate::change::history::{History, limited};
use crate::change::pass::{Standpoint, passes, weights};

/// A pass is cut where it saw a change: if its evidence before and after is worth this much, in nats, …
const CUT_NATS: f64 = 9.0;
/// … and this share of it is consistent.
const CUT_UNANIMITY: f64 = 0.95;

/// Passes over a place and its history.
pub struct Timeline {
    /// Ranges of observations, in the order of time.
    pub passes: Vec<Range<usize>>,
    /// A state for each pass.
    pub history: History,
}

impl Timeline {
    /// From observations in the order of trip and time. `nats` is the evidence of each for occupied over free.
    /// One that repeats the one before counts less, and a pass at most `nats_per_pass`.
    pub fn of(standpoints: &[Standpoint], nats: &[f64], nats_per_pass: f64) -> Self {
        let mut cut = Vec::new();
        for pass in passes(standpoints) {
            let weights = weights(&standpoints[pass.clone()]);
            let weighted = nats[pass.clone()].iter().zip(weights);
            let weighted: Vec<f64> = weighted.map(|(nats, weight)| nats * weight).collect();
            for part in cut_at_changes(&weighted) {
                let sum: f64 = weighted[part.clone()].iter().sum();
                cut.push((pass.start + part.start..pass.start + part.end, sum));
            }
        }
        cut.sort_by_key(|(pass, _)| (standpoints[pass.start].stamp, pass.start));
        let evidence = cut.iter().map(|(_, sum)| limited(*sum, nats_per_pass));
        Self {
            history: History::of(evidence),
            passes: cut.into_iter().map(|(pass, _)| pass).collect(),
        }
    }
}

/// Cuts a pass where its evidence clearly changes sign. A pass with any unclear part is not cut.
fn cut_at_changes(nats: &[f64]) -> Vec<Range<usize>> {
    let cuts = turns(nats);
    let first = iter::once(0).chain(cuts.iter().copied());
    let last = cuts.iter().copied().chain(iter::once(nats.len()));
    let parts: Vec<Range<usize>> = first.zip(last).map(|(first, last)| first..last).collect();
    match parts.iter().all(|part| is_plain(&nats[part.clone()])) {
        true => parts,
        false => iter::once(0..nats.len()).collect(),
    }
}

/// Where the sum of the evidence turns by [`CUT_NATS`].
fn turns(nats: &[f64]) -> Vec<usize> {
    let mut turns = Vec::new();
    let (mut low, mut high) = ((0.0, 0), (0.0, 0));
    let mut rises = None;
    let mut sum = 0.0;
    for (k, nats) in nats.iter().enumerate() {
        sum += nats;
        let here = (sum, k + 1);
        if rises != Some(true) && sum - low.0 >= CUT_NATS {
            turns.push(low.1);
            (rises, high) = (Some(true), here);
        } else if rises != Some(false) && high.0 - sum >= CUT_NATS {
            turns.push(high.1);
            (rises, low) = (Some(false), here);
        }
        if sum > high.0 {
            high = here;
        }
        if sum < low.0 {
            low = here;
        }
    }
    turns.retain(|at| *at > 0);
    turns
}

fn is_plain(nats: &[f64]) -> bool {
    let (sum, most) = nats.iter().fold((0.0, 0.0), |(sum, most), nats| {
        (sum + nats, most + nats.abs())
    });
    sum.abs() >= CUT_NATS && sum.abs() >= CUT_UNANIMITY * most
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::change::history::State::{Free, Occupied};
    use crate::geometry::Vector2;
    use crate::ids::StampNs;

    /// One view a second, 1 m apart.
    fn timeline(nats: &[f64]) -> Timeline {
        let standpoint = |k: usize| Standpoint {
            trip: 0,
            stamp: StampNs(k as i64 * 1_000_000_000),
            eye: Vector2::new(k as f64, 0.0),
        };
        let standpoints: Vec<Standpoint> = (0..nats.len()).map(standpoint).collect();
        Timeline::of(&standpoints, nats, 10.0)
    }

    fn views(parts: &[(usize, f64)]) -> Vec<f64> {
        let parts = parts.iter();
        parts.flat_map(|&(count, nats)| vec![nats; count]).collect()
    }

    #[test]
    fn a_change_that_a_pass_saw_cuts_it() {
        let seen = timeline(&views(&[(16, -1.5), (16, 1.5), (16, -1.5)]));
        assert_eq!(seen.passes, [0..16, 16..32, 32..48]);
        assert_eq!(seen.history.states, [Free, Occupied, Free]);
    }

    #[test]
    fn a_pass_in_doubt_is_not_cut() {
        // Too little on one side; now this, now that; and a third that says the contrary.
        for nats in [
            views(&[(12, -1.5), (5, 1.5)]),
            views(&[(1, -1.5), (1, 1.5)]).repeat(12),
            views(&[(12, -1.5), (8, 1.5), (4, -1.5), (8, 1.5)]),
        ] {
            assert_eq!(timeline(&nats).passes.len(), 1);
        }
    }
}
