//! Which outcomes of ray tests are possible in an area, from its beams alone: areas that an observation cannot
//! see are skipped whole.

use super::{NEAREST_M, Observation, bearing_tolerance_rad, floor, is_range};
use crate::geometry::Vector2;
use crate::scan::NO_RETURN_TICK;

/// Which outcomes an observation may have in an area.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Visibility {
    /// Beams reached it: cells may be hit or missed.
    Reached,
    /// No beam reached it, but some gave no return.
    NoReturns,
    /// All beams ended before it, or it is out of reach: every cell is unknown.
    Hidden,
}

impl Observation {
    /// Which outcomes are possible for cells (of this half width) in a circle.
    pub fn visibility_of(
        &self,
        centre: &Vector2<f64>,
        radius_m: f64,
        half_width_m: f64,
    ) -> Visibility {
        let towards = centre - self.eye;
        let range_m = towards.norm();
        let nearest_m = range_m - radius_m;
        if nearest_m > self.reach_m {
            return Visibility::Hidden;
        }
        if nearest_m < NEAREST_M {
            return Visibility::Reached;
        }
        let half_rad = (radius_m / range_m).asin() + bearing_tolerance_rad(nearest_m, half_width_m);
        let half = (half_rad * self.beams_per_rad).max(1.0) + 1.0;
        let bearing = self.bearing(&self.lidar_from_map.turn(&towards));
        let hit_from_m = nearest_m - self.hit_within_m(range_m + radius_m, half_width_m);
        let (mut longest, mut no_return) = (0, false);
        for part in self
            .parts(floor(bearing - half), floor(bearing + half) + 1)
            .into_iter()
            .flatten()
        {
            for &tick in &self.scan.ticks()[part] {
                longest = longest.max(if is_range(tick) { tick } else { 0 });
                no_return |= tick == NO_RETURN_TICK;
            }
        }
        if f64::from(longest) * self.scan.tick_m() >= hit_from_m {
            Visibility::Reached
        } else if no_return {
            Visibility::NoReturns
        } else {
            Visibility::Hidden
        }
    }
}
