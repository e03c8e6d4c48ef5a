//! An allocator of ranges of different lengths in one slice.

use std::ops::Range;

/// Hands out ranges of a slice that grows; what is given back is used again.
#[derive(Debug, Default)]
pub(super) struct Arena {
    /// Ascending, and never two that touch.
    holes: Vec<Range<usize>>,
    end: usize,
}

impl Arena {
    /// How long the slice has to be.
    pub(super) fn end(&self) -> usize {
        self.end
    }

    /// The start of the first range that is long enough.
    pub(super) fn take(&mut self, length: usize) -> usize {
        if let Some(at) = self.holes.iter().position(|hole| hole.len() >= length) {
            let hole = &mut self.holes[at];
            let start = hole.start;
            hole.start += length;
            if hole.start == hole.end {
                self.holes.remove(at);
            }
            return start;
        }
        // A hole at the end can be made longer.
        let start = match self.holes.last() {
            Some(hole) if hole.end == self.end => hole.start,
            _ => self.end,
        };
        if start < self.end {
            self.holes.pop();
        }
        self.end = start + length;
        start
    }

    /// Gives back a range that was taken.
    pub(super) fn give_back(&mut self, range: Range<usize>) {
        if range.start == range.end {
            return;
        }
        let at = self.holes.partition_point(|hole| hole.start < range.start);
        let joins_before = at > 0 && self.holes[at - 1].end == range.start;
        let joins_after = self
            .holes
            .get(at)
            .is_some_and(|hole| hole.start == range.end);
        match (joins_before, joins_after) {
            (true, true) => self.holes[at - 1].end = self.holes.remove(at).end,
            (true, false) => self.holes[at - 1].end = range.end,
            (false, true) => self.holes[at].start = range.start,
            (false, false) => self.holes.insert(at, range),
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn ranges_in_use_never_overlap(steps in prop::collection::vec((0..40_usize, any::<bool>()), 1..80)) {
            let mut arena = Arena::default();
            let mut used: Vec<Range<usize>> = Vec::new();
            for (number, gives_back) in steps {
                if gives_back && !used.is_empty() {
                    arena.give_back(used.swap_remove(number % used.len()));
                } else {
                    let start = arena.take(number);
                    used.push(start..start + number);
                }
                let mut sorted = used.clone();
                sorted.retain(|range| range.start < range.end);
                sorted.sort_by_key(|range| range.start);
                prop_assert!(sorted.windows(2).all(|two| two[0].end <= two[1].start));
                prop_assert!(sorted.last().is_none_or(|last| last.end <= arena.end()));
                // Holes and what is in use make up the whole.
                let holes: usize = arena.holes.iter().map(|hole| hole.len()).sum();
                let lengths: usize = used.iter().map(|range| range.len()).sum();
                prop_assert_eq!(holes + lengths, arena.end());
            }
        }
    }
}
