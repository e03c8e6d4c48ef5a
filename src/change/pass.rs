//! Passes: uninterrupted segments of one trip in which a place is within reach.

use std::ops::Range;

use crate::geometry::Vector2;
use crate::ids::StampNs;

/// A pass ends when the place was out of reach for longer, seconds, …
const GAP_S: f64 = 30.0;
/// … and one that stays is cut after this, seconds.
const LENGTH_S: f64 = 120.0;

/// An observation weighs fully if the lidar moved by this much since the one before, metres …
const MOVED_M: f64 = 0.1;
/// … or waited for this long, seconds; …
const WAITED_S: f64 = 0.5;
/// … but never less than this: two equal views of one place are not quite one.
const WEIGHT_MIN: f64 = 0.1;

/// Trip, time and position of an observation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Standpoint {
    /// Number of the trip.
    pub trip: usize,
    /// Its stamp.
    pub stamp: StampNs,
    /// Position of the lidar, map frame, metres.
    pub eye: Vector2<f64>,
}

/// Cuts standpoints, in the order of trip and time, into passes.
pub fn passes(standpoints: &[Standpoint]) -> Vec<Range<usize>> {
    let mut passes = Vec::new();
    let mut first = 0;
    for k in 1..=standpoints.len() {
        let is_same = standpoints.get(k).is_some_and(|next| {
            goes_on(&standpoints[k - 1], next)
                && seconds_between(&standpoints[first], next) <= LENGTH_S
        });
        if !is_same {
            passes.push(first..k);
            first = k;
        }
    }
    passes
}

/// Whether a trip stayed within reach from one standpoint to the next: only the greatest length of a pass may
/// separate them.
pub fn goes_on(last: &Standpoint, next: &Standpoint) -> bool {
    next.trip == last.trip && seconds_between(last, next) <= GAP_S
}

/// The weight of each observation of a pass, in (0, 1]: a vehicle that stands still sees the same again.
pub fn weights(pass: &[Standpoint]) -> Vec<f64> {
    let mut weights = Vec::with_capacity(pass.len());
    for (k, standpoint) in pass.iter().enumerate() {
        weights.push(match k.checked_sub(1).map(|before| &pass[before]) {
            None => 1.0,
            Some(before) => {
                let moved = (standpoint.eye - before.eye).norm() / MOVED_M;
                let waited = seconds_between(before, standpoint) / WAITED_S;
                moved.max(waited).clamp(WEIGHT_MIN, 1.0)
            }
        });
    }
    weights
}

fn seconds_between(a: &Standpoint, b: &Standpoint) -> f64 {
    (b.stamp.0 - a.stamp.0) as f64 / 1e9
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(trip: usize, seconds: f64, x: f64) -> Standpoint {
        Standpoint {
            trip,
            stamp: StampNs((seconds * 1e9) as i64),
            eye: Vector2::new(x, 0.0),
        }
    }

    #[test]
    fn trips_gaps_and_long_stays_end_a_pass() {
        let standpoints = [
            at(0, 0.0, 0.0),
            at(0, 29.0, 0.0),
            at(0, 60.0, 0.0),
            at(1, 61.0, 0.0),
        ];
        assert_eq!(passes(&standpoints), [0..2, 2..3, 3..4]);
        let stays: Vec<_> = (0..14).map(|k| at(0, 10.0 * f64::from(k), 0.0)).collect();
        assert_eq!(passes(&stays), [0..13, 13..14]);
        assert!(passes(&[]).is_empty());
    }

    #[test]
    fn a_view_weighs_by_what_is_new_of_it() {
        let pass = [
            at(0, 0.0, 0.0),
            at(0, 0.1, 0.05),
            at(0, 0.2, 1.0),
            at(0, 0.2, 1.0),
            at(0, 9.0, 1.0),
        ];
        let expected = [1.0, 0.5, 1.0, 0.1, 1.0];
        for (weight, expected) in weights(&pass).iter().zip(expected) {
            assert!((weight - expected).abs() < 1e-9, "{weight} {expected}");
        }
    }
}
