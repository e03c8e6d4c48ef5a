//! Medians.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Of at least one value; sorts them.
pub(super) fn median(values: &mut [f64]) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    0.5 * (values[(values.len() - 1) / 2] + values[values.len() / 2])
}

/// The median of numbers that are not negative, as they come. Their bits are ordered as they are.
#[derive(Default)]
pub(super) struct RunningMedian {
    /// The lower half, the middle one included.
    low: BinaryHeap<u64>,
    high: BinaryHeap<Reverse<u64>>,
}

impl RunningMedian {
    pub(super) fn insert(&mut self, value: f64) {
        self.low.push(value.abs().to_bits());
        self.high.extend(self.low.pop().map(Reverse));
        if self.high.len() > self.low.len() {
            self.low.extend(self.high.pop().map(|Reverse(bits)| bits));
        }
    }

    /// 0 of none.
    pub(super) fn get(&self) -> f64 {
        let low = self.low.peek().copied().unwrap_or_default();
        let high = self.high.peek().map_or(low, |Reverse(bits)| *bits);
        let above = if self.low.len() > self.high.len() {
            low
        } else {
            high
        };
        0.5 * (f64::from_bits(low) + f64::from_bits(above))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_running_median_is_that_of_all_so_far(
            values in prop::collection::vec(prop_oneof![Just(0.0), Just(-0.0), 0.0..9.0_f64], 1..60),
        ) {
            let mut running = RunningMedian::default();
            for n in 1..=values.len() {
                running.insert(values[n - 1]);
                let mut sorted = values[..n].to_vec();
                sorted.sort_by(f64::total_cmp);
                let middle = 0.5 * (sorted[(n - 1) / 2] + sorted[n / 2]);
                prop_assert_eq!(running.get(), middle);
            }
        }
    }
}
