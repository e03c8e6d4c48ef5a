//! Judges a site in seven steps, from its observations to findings.

use std::collections::BTreeSet;

use super::answers::Answers;
use super::cells::{CELL_M, SiteCells};
use super::cluster::{Cluster, clusters};
use super::pooled::{self, Pooled};
use super::surroundings::Surroundings;
use super::{Observed, Site, misplaced, shift};
use crate::change::history::{NO_RETURN_WORTH, State};
use crate::change::region::{centroid, region_round};
use crate::change::screen::{JUDGED_WITHIN_M, SURROUNDINGS_M};
use crate::change::{ChangeKind, Finding, Fit, Tier};
use crate::geometry::Vector2;
use crate::ids::{NodeId, StampNs};

/// Margin of the outline round the cells' centres, metres: half a cell.
const REGION_MARGIN_M: f64 = 0.03;
/// Standard deviation of a pose, metres: a lower bound for that of a location.
const POSE_SIGMA_M: f64 = 0.02;

/// The changes of a site, in the order of their cells. `fit_of` returns how an observation fits other passes,
/// and the pose at which it fits better; it is called only where something may be found.
pub fn state_changes(
    site: &mut Site<'_>,
    mut fit_of: impl FnMut(&Observed) -> Fit,
) -> Vec<Finding> {
    // Most sites end here: nothing to find even with the poses as they are.
    if !may_have_changed(site) {
        return Vec::new();
    }

    // 1. Move misplaced observations to where they fit other passes; drop those that fit nowhere.
    for observed in &mut site.observations {
        let fit = fit_of(observed);
        observed.refit(&fit);
    }

    // 2. Every place with a hit becomes a cell, which each observation hits, misses, or does not know.
    let (cells, mut answers) = answers_about_candidates(site);
    let mut witnesses = answers.witnesses();
    let misplaced = misplaced::misplaced_observations(&site.observations);
    answers.drop_observations(&misplaced);
    witnesses.retain(|&k| !misplaced[k]);
    if !may_be_clear(site, &cells, &mut answers) {
        return Vec::new();
    }
    // No-returns count for lidars that rarely lose a surface of the surroundings.
    let around = SiteCells::of(site, witnesses.iter().copied(), SURROUNDINGS_M, 2);
    let answers_around = Answers::of(site, &around, witnesses.iter().copied());
    answers.weigh_no_returns(site, &answers_around);
    let site = &*site;

    // 3. Find the change in the history of each cell over its passes.
    // 4. Cluster cells that changed alike at the same time.
    let clusters = pooled::separated(&answers, clusters(&cells, &answers));

    let findings = clusters.iter().filter_map(|(cluster, pooled)| {
        // 5. Pool all observations of a cluster: contrast, support and size must be clear.
        if !pooled.is_clear(cluster, site.support_min) {
            return None;
        }
        if !pooled.is_sure() {
            let centres = centres(&cells, cluster);
            let surroundings = Surroundings::of(site, &around, &answers_around, &centres, pooled);
            // 6. Both states must have been seen with the same surroundings.
            if !surroundings.agree() {
                return None;
            }
            // 7. No shift of the map may explain the difference.
            if shift::explains(site, &cells, cluster, pooled, &surroundings) {
                return None;
            }
        }
        Some(finding_of(site, &cells, cluster, pooled))
    });
    findings.collect()
}

fn answers_about_candidates(site: &Site<'_>) -> (SiteCells, Answers) {
    let all = || 0..site.observations.len();
    let cells = SiteCells::of(site, all(), JUDGED_WITHIN_M, 1);
    let answers = Answers::of(site, &cells, all());
    (cells, answers)
}

/// Whether a change may be found, before misplaced observations are moved.
fn may_have_changed(site: &Site<'_>) -> bool {
    let (cells, answers) = answers_about_candidates(site);
    clusters(&cells, &answers).iter().any(|cluster| {
        Pooled::of(&answers, cluster).is_some_and(|pooled| pooled.is_promising(cluster))
    })
}

/// Whether a cluster is clear if no-returns count for nothing, or for as much as they can; the surroundings
/// decide which.
fn may_be_clear(site: &Site<'_>, cells: &SiteCells, answers: &mut Answers) -> bool {
    let is_clear =
        |(cluster, pooled): &(Cluster, Pooled)| pooled.is_clear(cluster, site.support_min);
    [0.0, NO_RETURN_WORTH].into_iter().any(|worth| {
        answers.value_no_returns(worth);
        let clusters = clusters(cells, answers);
        pooled::separated(answers, clusters).iter().any(is_clear)
    })
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
    let observed = |k: usize| &site.observations[k];
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
        sigma_m: POSE_SIGMA_M.hypot(CELL_M / (12.0 * centres.len() as f64).sqrt()),
        region,
        tier,
        counterpart: None,
        shift: None,
        suspect: None,
        bands: Vec::new(),
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
