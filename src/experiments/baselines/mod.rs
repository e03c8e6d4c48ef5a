//! Published detectors, as their papers have them.

pub(super) mod map_updating;
#[cfg(test)]
pub(super) mod testing;
