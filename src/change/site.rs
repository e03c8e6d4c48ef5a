//! One site: a few square metres where something may have changed, judged by every observation
//! of it.
//!
//! What is found is a function of the set of observations and their poses, not of the order in
//! which they arrived. The rule and its constants come from recordings; `docs/DETECTION.md` has
//! what each step is worth.

mod answers;
mod cells;
mod cluster;
mod nearness;
mod pooled;
mod shift;
mod surroundings;
mod timeline;
mod void;

use std::collections::BTreeSet;

use self::answers::Answers;
use self::cells::SiteCells;
use self::cluster::{Cluster, clusters};
use self::nearness::Nearness;
use self::pooled::Pooled;
pub use self::pooled::support_min;
use self::surroundings::Surroundings;
use super::history::State;
use super::pass::{Standpoint, passes};
use super::region::{centroid, region_round};
use super::screen::SURROUNDINGS_M;
use super::{AcceptedChange, Agreement, ChangeKind, Finding, Tier};
use crate::geometry::{Pose2, Vector2};
use crate::ids::{NodeId, StampNs, TripId};
use crate::observation::{Observation, Sight};

/// Cells this near to a candidate are judged with it, metres.
const JUDGED_WITHIN_M: f64 = 0.5;
/// Observations of a pass that are asked, at most: more say the same again.
const ASKED_MAX: usize = 48;
const NO_RETURNS_MAX: usize = 16;
/// How far the outline stays away from the cells' centres, metres: half a cell.
const REGION_MARGIN_M: f64 = 0.03;
/// What is known of a pose, metres: no location is better.
const POSE_SIGMA_M: f64 = 0.02;

/// An observation of a map.
#[derive(Debug, Clone)]
pub struct Observed {
    /// The keyframe that it is of, or follows.
    pub node: NodeId,
    /// Which: the keyframe's own (0), or its first, second … intermediate scan.
    pub place: u32,
    /// Number of its trip.
    pub trip: usize,
    /// When it was taken.
    pub stamp: StampNs,
    /// Where the base was, as the map has it.
    pub map_from_base: Pose2,
    /// The scan at its pose, or where it fits what other passes found.
    pub observation: Observation,
    /// How well it fits what other passes found, wherever it looked.
    pub agreement: Agreement,
}

impl Observed {
    fn standpoint(&self) -> Standpoint {
        Standpoint {
            trip: self.trip,
            stamp: self.stamp,
            eye: self.observation.eye(),
        }
    }
}

/// What is judged together.
pub struct Site<'a> {
    /// Centres of the cells that may have changed, map frame, metres.
    pub candidates: &'a [Vector2<f64>],
    /// Centres of all cells in the surroundings that may have changed.
    pub changed_around: &'a [Vector2<f64>],
    /// Those who are asked ([`asked_about`]), in the order of trip and time.
    pub observations: &'a [&'a Observed],
    /// Accepted changes: in their regions what was observed before them is out of date.
    pub accepted: &'a [AcceptedChange],
    /// Names of the trips that observations number.
    pub trips: &'a [TripId],
    /// How much better a change must explain the passes than none, in nats: [`support_min`].
    pub support_min: f64,
}

/// The changes of a site, in the order of their places.
pub fn state_changes(site: &Site<'_>) -> Vec<Finding> {
    // 1. Whatever any observation hit becomes a cell, and of those that may have changed every
    //    observation says hit, miss or unknown.
    let all = || 0..site.observations.len();
    let cells = SiteCells::of(site, all(), JUDGED_WITHIN_M, 1);
    let mut answers = Answers::of(site, &cells, all());
    let is_promising = |cluster: &Cluster| {
        Pooled::of(&answers, cluster).is_some_and(|pooled| pooled.is_promising(cluster))
    };
    if !clusters(&cells, &answers).iter().any(is_promising) {
        return Vec::new();
    }
    // 2. Observations that do not fit what other passes found have a wrong pose: they say nothing.
    let mut witnesses = answers.witnesses();
    let void = void::void_observations(site.observations);
    answers.drop_void(&void);
    witnesses.retain(|&k| !void[k]);
    let around = SiteCells::of(site, witnesses.iter().copied(), SURROUNDINGS_M, 2);
    let answers_around = Answers::of(site, &around, witnesses.iter().copied());
    answers.weigh_no_returns(site, &answers_around);
    // 3. The history of each cell over its passes; 4. cells that changed alike at one time.
    let clusters = pooled::settled(&answers, clusters(&cells, &answers));
    let findings = clusters.iter().filter_map(|(cluster, pooled)| {
        // 5. What all observations of a cluster say together.
        if !pooled.is_clear(cluster, site.support_min) {
            return None;
        }
        // 6. The surroundings must be the same to those who saw the old state and to those who
        //    saw the new; 7. and no shift may explain the difference.
        let surroundings = Surroundings::of(
            site,
            &around,
            &answers_around,
            &centres(&cells, cluster),
            pooled,
        );
        if !pooled.is_sure()
            && (!surroundings.agree()
                || shift::explains(site, &cells, cluster, pooled, &surroundings))
        {
            return None;
        }
        Some(finding_of(site, &cells, cluster, pooled))
    });
    findings.collect()
}

/// Of observations in the order of trip and time: those that see some of a site's candidates, at
/// most [`ASKED_MAX`] of each pass, evenly chosen; and at most [`NO_RETURNS_MAX`] of which only
/// beams without a return went there.
pub fn asked_about(candidates: &[Vector2<f64>], observations: &[Observed]) -> Vec<usize> {
    let (centre, radius_m) = Nearness::to(candidates).circle(JUDGED_WITHIN_M);
    let sights = observations.iter().map(|observed| {
        let observation = &observed.observation;
        observation.sight_of(&centre, radius_m, 0.0)
    });
    let sights: Vec<Sight> = sights.collect();
    let mut asked = Vec::new();
    let most = [
        (Sight::Clear, ASKED_MAX),
        (Sight::NoReturns, NO_RETURNS_MAX),
    ];
    for (sight, asked_max) in most {
        let of_sight = (0..observations.len()).filter(|&k| sights[k] == sight);
        let of_sight: Vec<usize> = of_sight.collect();
        let standpoints = of_sight.iter().map(|&k| observations[k].standpoint());
        let standpoints: Vec<Standpoint> = standpoints.collect();
        for pass in passes(&standpoints) {
            let of_pass = &of_sight[pass];
            let kept = of_pass.len().min(asked_max);
            asked.extend((0..kept).map(|k| of_pass[k * of_pass.len() / kept]));
        }
    }
    asked.sort_unstable();
    asked
}

fn centres(cells: &SiteCells, cluster: &Cluster) -> Vec<Vector2<f64>> {
    cluster.cells.iter().map(|&c| cells[c].centre).collect()
}

fn finding_of(site: &Site<'_>, cells: &SiteCells, cluster: &Cluster, pooled: &Pooled) -> Finding {
    let centres = centres(cells, cluster);
    let region = region_round(&centres, REGION_MARGIN_M);
    let new_state = pooled.baseline.other();
    let showing = || {
        pooled
            .views
            .iter()
            .filter(|view| view.in_change && view.shows(new_state))
    };
    let observed = |k: usize| site.observations[k];
    let stamps = || showing().map(|view| observed(view.observation).stamp);
    let nodes: BTreeSet<NodeId> = pooled
        .views
        .iter()
        .map(|view| observed(view.observation).node)
        .collect();
    let trips: BTreeSet<usize> = showing().map(|v| observed(v.observation).trip).collect();
    let after = pooled.views.iter().filter(|view| view.after_change);
    let back = after.filter(|view| view.shows(pooled.baseline));
    let until = back.map(|view| observed(view.observation).stamp).min();
    let tier = if pooled.passes_in_change >= 2 {
        Tier::Confirmed
    } else {
        Tier::Tentative
    };
    Finding {
        kind: match pooled.baseline {
            State::Free => ChangeKind::Appeared,
            State::Occupied => ChangeKind::Disappeared,
        },
        location: centroid(&region),
        sigma_m: POSE_SIGMA_M.hypot(cells::CELL_M / (12.0 * centres.len() as f64).sqrt()),
        region,
        tier,
        counterpart: None,
        shift: None,
        edges: Vec::new(),
        nodes: nodes.into_iter().collect(),
        trips: trips.iter().map(|&trip| site.trips[trip].clone()).collect(),
        views: showing().count(),
        laps: pooled.passes_in_change,
        confidence: 1.0 / (1.0 + (-pooled.support).exp()),
        since: stamps().min().unwrap_or(StampNs(i64::MAX)),
        last_seen: stamps().max().unwrap_or(StampNs(0)),
        until: until.filter(|_| !pooled.stands),
    }
}

#[cfg(test)]
mod tests;
