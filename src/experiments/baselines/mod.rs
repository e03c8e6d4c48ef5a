//! Published detectors, as their papers have them.

pub(super) mod map_updating;
pub(super) mod paper_rule;
#[cfg(test)]
pub(super) mod testing;
