//! How reliable passes are on a route: how often one contradicts both its neighbours in time.

use super::Screen;
use super::sites::is_near;
use crate::change::false_alerts::support_for_rate;
use crate::geometry::Vector2;

/// Prior of the rate: this many contradicting passes …
const PRIOR_CONTRADICTING: f64 = 4.0;
/// … of this many. A route's own passes are added to these.
const PRIOR_PASSES: f64 = 100.0;
/// Passes that confirm a change at the prior rate.
const CONFIRMING_PASSES: f64 = 2.0;
/// Least weight of a pass, in nats, however noisy the route is.
const NATS_MIN: f64 = 0.5;

/// How often passes contradict both their neighbours in time, in cells that did not change.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Reliability {
    /// Passes over a cell that contradict the one before and the one after.
    pub contradicting: u64,
    /// Passes over a cell with one before and one after.
    pub passes: u64,
}

impl Reliability {
    /// Whether this many passes that show a change confirm it: as much as two passes at the prior rate, more
    /// if fewer false alerts are allowed.
    pub fn confirms(self, passes: usize, false_alerts_per_lap: f64) -> bool {
        let needed = CONFIRMING_PASSES * Self::default().nats_per_pass();
        let needed = needed + support_for_rate(false_alerts_per_lap);
        passes as f64 * self.nats_per_pass() >= needed
    }

    /// log p(a pass shows it | it changed) − log p(a pass shows it | it did not), in nats.
    fn nats_per_pass(self) -> f64 {
        let passes = self.passes as f64 + PRIOR_PASSES;
        let share = (self.contradicting as f64 + PRIOR_CONTRADICTING) / passes;
        ((1.0 - share) / share).ln().max(NATS_MIN)
    }
}

impl Screen {
    /// The reliability over the route's cells outside of regions with known changes.
    pub fn reliability(&self, changed: &[Vec<Vector2<f64>>]) -> Reliability {
        let mut reliability = Reliability::default();
        for cell in self.grid.cells() {
            let (contradicting, passes) = cell.contradictions();
            if contradicting > 0 && changed.iter().any(|region| is_near(cell.key, region)) {
                continue;
            }
            reliability.contradicting += u64::from(contradicting);
            reliability.passes += u64::from(passes);
        }
        reliability
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(contradicting: u64, passes: u64) -> Reliability {
        Reliability {
            contradicting,
            passes,
        }
    }

    #[test]
    fn two_passes_confirm_and_more_are_needed_where_passes_err() {
        let rate = 0.01;
        assert!(!of(0, 0).confirms(1, rate) && of(0, 0).confirms(2, rate));
        assert!(of(40, 1_000).confirms(2, rate));
        assert!(!of(100, 1_000).confirms(2, rate) && of(100, 1_000).confirms(3, rate));
        assert!(of(0, 1_000_000).confirms(1, rate));
    }

    #[test]
    fn fewer_false_alerts_need_more_passes() {
        assert!(!of(0, 0).confirms(2, 0.001) && of(0, 0).confirms(3, 0.001));
        assert!(!of(0, 0).confirms(1, 0.1) && of(0, 0).confirms(2, 0.1));
    }

    #[test]
    fn where_every_pass_errs_no_number_of_passes_is_infinite() {
        assert!(of(1_000, 1_000).confirms(20, 0.01) && !of(1_000, 1_000).confirms(10, 0.01));
    }
}
