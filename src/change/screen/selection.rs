//! Which observations a site is judged by.

use super::recorded::Recorded;
use super::sites::box_round;
use super::{CandidateSite, ObservationKey, Screen};
use crate::change::nearness::Nearness;
use crate::change::pass::{Standpoint, passes};
use crate::observation::{REACH_M, Visibility};

/// Most observations of a pass that are used: more are redundant.
const SELECTED_MAX: usize = 48;
/// Most of those of which only beams without a return reach the site.
const NO_RETURNS_MAX: usize = 16;
/// Cells this near to a candidate are judged with it, metres.
pub const JUDGED_WITHIN_M: f64 = 0.5;

impl Screen {
    /// The observations that see a part of a site, in no order: of each pass at most `SELECTED_MAX`, evenly
    /// spread, and at most `NO_RETURNS_MAX` of which only beams without a return reach it.
    pub fn observations_of(&self, site: &CandidateSite) -> Vec<ObservationKey> {
        let Some((low, high)) = box_round(&site.cells, REACH_M) else {
            return Vec::new();
        };
        let mut near: Vec<&Recorded> = self.recorded.between(&low, &high).collect();
        near.sort_unstable_by_key(|recorded| (recorded.pass.trip, recorded.stamp, recorded.key));
        let (centre, radius_m) = Nearness::to(&site.cells).circle(JUDGED_WITHIN_M);
        let visibility = |recorded: &&Recorded| {
            let observation = &recorded.observation;
            observation.visibility_of(&centre, radius_m, 0.0)
        };
        let visibilities: Vec<Visibility> = near.iter().map(visibility).collect();
        let mut selected = Vec::new();
        for (visibility, selected_max) in [
            (Visibility::Reached, SELECTED_MAX),
            (Visibility::NoReturns, NO_RETURNS_MAX),
        ] {
            let of_visibility = near.iter().zip(&visibilities);
            let of_visibility = of_visibility.filter(|(_, other)| **other == visibility);
            let of_visibility: Vec<&Recorded> =
                of_visibility.map(|(recorded, _)| *recorded).collect();
            let standpoints: Vec<Standpoint> =
                of_visibility.iter().map(|r| r.standpoint()).collect();
            for pass in passes(&standpoints) {
                let of_pass = &of_visibility[pass];
                let kept = of_pass.len().min(selected_max);
                selected.extend((0..kept).map(|k| of_pass[k * of_pass.len() / kept].key));
            }
        }
        selected
    }
}
