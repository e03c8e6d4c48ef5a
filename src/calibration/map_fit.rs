//! Whether a trip's scans fit the map that other vehicles have made.

use serde::{Deserialize, Serialize};

/// Fewer keyframes near those of other vehicles say nothing.
const NEAR_MIN: u32 = 40;
/// A trip fits with a loop closure at one of so many keyframes near others. Nearly all have one where
/// vehicle and map are sound, and most in a hall that has been rearranged.
const NEAR_PER_CLOSED_MAX: u32 = 20;

/// How many of a trip's keyframes had to fit other vehicles' keyframes, and how many do.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct MapFit {
    /// Keyframes beside a reference keyframe of another vehicle.
    pub near: u32,
    /// Those of them that have a loop closure with one.
    pub closed: u32,
}

impl MapFit {
    /// Whether there were enough keyframes that had to fit, and hardly any does.
    pub fn fails(&self) -> bool {
        self.near >= NEAR_MIN && self.closed < self.near / NEAR_PER_CLOSED_MAX
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_trip_fails_by_many_keyframes_alone() {
        let fails = |near, closed| MapFit { near, closed }.fails();
        assert!(fails(40, 0) && fails(400, 19));
        assert!(!fails(39, 0) && !fails(400, 20) && !fails(0, 0));
    }
}
