//! Which observations are asked about a site.

use super::recorded::Recorded;
use super::sites::box_round;
use super::{CandidateSite, ObservationKey, Screen};
use crate::change::nearness::Nearness;
use crate::change::pass::{Standpoint, passes};
use crate::observation::{REACH_M, Visibility};

/// Observations of a pass that are asked, at most: more say the same again.
const ASKED_MAX: usize = 48;
/// Of those of which only beams without a return went there.
const NO_RETURNS_MAX: usize = 16;
/// Cells this near to a candidate are judged with it, metres.
pub const JUDGED_WITHIN_M: f64 = 0.5;

impl Screen {
    /// Those that see some of a site, in no order: at most `ASKED_MAX` of each pass, evenly
    /// chosen; and at most `NO_RETURNS_MAX` of which only beams without a return went there.
    pub fn asked_about(&self, site: &CandidateSite) -> Vec<ObservationKey> {
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
        let mut asked = Vec::new();
        for (visibility, asked_max) in [
            (Visibility::Reached, ASKED_MAX),
            (Visibility::NoReturns, NO_RETURNS_MAX),
        ] {
            let such = near.iter().zip(&visibilities);
            let such = such.filter(|(_, other)| **other == visibility);
            let such: Vec<&Recorded> = such.map(|(recorded, _)| *recorded).collect();
            let standpoints: Vec<Standpoint> = such.iter().map(|r| r.standpoint()).collect();
            for pass in passes(&standpoints) {
                let of_pass = &such[pass];
                let kept = of_pass.len().min(asked_max);
                asked.extend((0..kept).map(|k| of_pass[k * of_pass.len() / kept].key));
            }
        }
        asked
    }
}
