//! What each pass by the place of a change saw of it, with the cells and the sensor model of the detector.

use super::answers::Answers;
use super::cells::SiteCells;
use super::pooled::{CELL_CONTRAST_MIN, NATS_PER_PASS, nats_of};
use super::timeline::Timeline;
use super::{Site, misplaced};
use crate::change::Finding;
use crate::change::history::State;
use crate::change::pass::{Standpoint, goes_on, passes};
use crate::change::screen::SURROUNDINGS_M;
use crate::geometry::distance_to_polygon;
use crate::ids::{NodeId, StampNs};
use crate::model::{ChangeKind, PassOutcome, PassSide};

/// Cells whose centres are this near to a region belong to it, metres: more than rounding.
const REGION_MARGIN_M: f64 = 0.01;
/// Least evidence of a pass, in nats: half of one clear observation …
const SAID_MIN_NATS: f64 = 1.0;
/// … of which this share must remain once both states are set against each other.
const AGREEMENT_MIN: f64 = 0.5;

/// An observation within reach of the place, whatever it saw.
#[derive(Debug, Clone, Copy)]
pub struct Presence {
    /// Its keyframe, or the one that it follows.
    pub node: NodeId,
    /// When, by which trip and from where.
    pub standpoint: Standpoint,
}

/// A pass with what it saw.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PassSeen {
    /// Number of its trip.
    pub trip: usize,
    /// Its first observation …
    pub begins: StampNs,
    /// … and its last.
    pub ends: StampNs,
    /// Before the change or since.
    pub side: PassSide,
    /// What it saw.
    pub outcome: PassOutcome,
    /// The keyframe that shows it best.
    pub node: NodeId,
}

/// The evidence of one observation.
struct View {
    presence: Presence,
    /// For occupied over free.
    nats: f64,
}

/// The passes by a change of state, in the order of trip and time. `sites` are the observations to test, those
/// of each layer in a site of its own with the location of the change as its only candidate; `presences` are
/// all within reach, in the order of trip and time.
///
/// Passes are cut as the detector cuts them. A pass within reach without a hit or a miss could not see the
/// place; leftovers at the ends of a pass that could are not passes.
pub fn pass_outcomes(
    finding: &Finding,
    sites: &[Site<'_>],
    presences: &[Presence],
) -> Vec<PassSeen> {
    let mut views: Vec<View> = sites
        .iter()
        .flat_map(|site| views_of(finding, site))
        .collect();
    views.sort_by_key(|view| order(&view.presence));
    let standpoints = views.iter().map(|view| view.presence.standpoint);
    let standpoints: Vec<Standpoint> = standpoints.collect();
    let nats: Vec<f64> = views.iter().map(|view| view.nats).collect();
    let timeline = Timeline::of(&standpoints, &nats, NATS_PER_PASS);
    let seen = timeline.passes.into_iter();
    let mut seen: Vec<PassSeen> = seen
        .filter_map(|pass| pass_of(finding, &views[pass]))
        .collect();
    seen.extend(unseen(finding, presences, &seen));
    seen.sort_by_key(|pass| (pass.trip, pass.begins, pass.node));
    seen
}

fn order(presence: &Presence) -> (usize, StampNs, NodeId) {
    let Standpoint { trip, stamp, .. } = presence.standpoint;
    (trip, stamp, presence.node)
}

/// The evidence of a site's observations about the cells of the change, without those that have none.
fn views_of(finding: &Finding, site: &Site<'_>) -> Vec<View> {
    let all = || 0..site.observations.len();
    let corners = finding.region.iter();
    let distances = corners.map(|corner| (corner - finding.location).norm());
    let radius_m = distances.fold(0.0, f64::max);
    let cells = SiteCells::of(site, all(), radius_m + REGION_MARGIN_M, 1);
    let mut answers = Answers::of(site, &cells, all());
    let misplaced = misplaced::misplaced_observations(&site.observations);
    answers.drop_observations(&misplaced);
    let witnesses = answers.witnesses();
    let around = SiteCells::of(site, witnesses.iter().copied(), SURROUNDINGS_M, 2);
    let answers_around = Answers::of(site, &around, witnesses.into_iter());
    answers.weigh_no_returns(site, &answers_around);

    let is_inside = |cell: &usize| {
        distance_to_polygon(&cells[*cell].centre, &finding.region) <= REGION_MARGIN_M
    };
    let inside: Vec<usize> = (0..cells.len()).filter(is_inside).collect();
    let changed = inside.iter().copied();
    let changed: Vec<usize> = changed
        .filter(|&c| has_changed(finding, &answers, c))
        .collect();
    // Cells that did not change with the rest dilute the evidence.
    let asked = if changed.is_empty() { inside } else { changed };
    let mut said = vec![(0.0, 0.0); site.observations.len()];
    for answer in asked.iter().flat_map(|&cell| answers.about(cell)) {
        let (hit, miss) = answers.counts(answer);
        let (hits, misses) = &mut said[answer.observation as usize];
        *hits += hit;
        *misses += miss;
    }
    let said = said.into_iter().zip(&site.observations);
    let said = said.filter(|((hits, misses), _)| hits + misses > 0.0);
    let views = said.map(|((hits, misses), observed)| View {
        presence: Presence {
            node: observed.node,
            standpoint: observed.standpoint(),
        },
        nats: nats_of(hits, misses),
    });
    views.collect()
}

fn new_state(finding: &Finding) -> State {
    match finding.kind {
        ChangeKind::Appeared => State::Occupied,
        _ => State::Free,
    }
}

/// Whether a cell shows the change, rather than something beside it that was always there.
fn has_changed(finding: &Finding, answers: &Answers, cell: usize) -> bool {
    let is_over = |stamp: StampNs| finding.until.is_some_and(|until| until <= stamp);
    let mut counts = [(0.0, 0.0); 2];
    for answer in answers.about(cell) {
        let stamp = answers.standpoints[answer.observation as usize].stamp;
        let shows_change = finding.since <= stamp && !is_over(stamp);
        let (hit, miss) = answers.counts(answer);
        let (hits, all) = &mut counts[usize::from(shows_change)];
        *hits += hit;
        *all += hit + miss;
    }
    let [old, new] = counts.map(|(hits, all)| hits / f64::max(all, f64::MIN_POSITIVE));
    let towards = match new_state(finding) {
        State::Occupied => new - old,
        State::Free => old - new,
    };
    towards >= CELL_CONTRAST_MIN
}

/// One pass from its observations in the order of time.
fn pass_of(finding: &Finding, views: &[View]) -> Option<PassSeen> {
    let (first, last) = (views.first()?, views.last()?);
    let (sum, said) = views.iter().fold((0.0, 0.0), |(sum, said), view| {
        (sum + view.nats, said + view.nats.abs())
    });
    let is_clear = said >= SAID_MIN_NATS && f64::abs(sum) >= AGREEMENT_MIN * said;
    let towards = f64::signum(sum);
    let outcome = match (
        is_clear,
        (towards > 0.0) == (new_state(finding) == State::Occupied),
    ) {
        (false, _) => PassOutcome::CouldNotSee,
        (true, true) => PassOutcome::NewState,
        (true, false) => PassOutcome::OldState,
    };
    // The first of equal ones.
    let clearest = views.iter().rev();
    let clearest = clearest.max_by(|a, b| (towards * a.nats).total_cmp(&(towards * b.nats)))?;
    let ends = last.presence.standpoint.stamp;
    Some(PassSeen {
        trip: first.presence.standpoint.trip,
        begins: first.presence.standpoint.stamp,
        ends,
        side: side_of(finding, ends),
        outcome,
        node: clearest.presence.node,
    })
}

/// A pass that contains the first observation of the new state counts as since the change.
fn side_of(finding: &Finding, ends: StampNs) -> PassSide {
    match ends < finding.since {
        true => PassSide::Before,
        false => PassSide::Since,
    }
}

/// The passes within reach without evidence that do not adjoin one with evidence.
fn unseen(finding: &Finding, presences: &[Presence], seen: &[PassSeen]) -> Vec<PassSeen> {
    let standpoints: Vec<Standpoint> = presences.iter().map(|p| p.standpoint).collect();
    let passes = passes(&standpoints);
    let sees = |pass: &std::ops::Range<usize>| {
        let (first, last) = (&standpoints[pass.start], &standpoints[pass.end - 1]);
        let mut of_trip = seen.iter().filter(|other| other.trip == first.trip);
        of_trip.any(|other| other.begins <= last.stamp && first.stamp <= other.ends)
    };
    let sees: Vec<bool> = passes.iter().map(sees).collect();
    let follows = |k: usize| goes_on(&standpoints[passes[k].end - 1], &standpoints[passes[k].end]);
    let is_unseen = |k: &usize| {
        let before = k.checked_sub(1).is_some_and(|j| sees[j] && follows(j));
        let after = sees.get(k + 1) == Some(&true) && follows(*k);
        !(sees[*k] || before || after)
    };
    let unseen = (0..passes.len()).filter(is_unseen);
    let pass_of = |k: usize| {
        let of_pass = &presences[passes[k].clone()];
        let distance_m = |p: &Presence| (p.standpoint.eye - finding.location).norm();
        let nearest = of_pass.iter();
        let nearest = nearest.min_by(|a, b| distance_m(a).total_cmp(&distance_m(b)))?;
        let (first, last) = (of_pass.first()?.standpoint, of_pass.last()?.standpoint);
        Some(PassSeen {
            trip: first.trip,
            begins: first.stamp,
            ends: last.stamp,
            side: side_of(finding, last.stamp),
            outcome: PassOutcome::CouldNotSee,
            node: nearest.node,
        })
    };
    unseen.filter_map(pass_of).collect()
}
