//! From flagged closures to places that contradict the map.
//!
//! One closure proves little: at any rate of false alarms some are flagged in an unchanged world. A place is
//! reported by several closures of one pass, or of consecutive passes, and
//! it ends with the first pass whose closures are all unsuspicious.

use std::collections::BTreeSet;

use super::region::region_round;
use super::{ChangeKind, Finding, Tier};
use crate::geometry::Vector2;
use crate::ids::{EdgeId, NodeId, StampNs, TripId};

/// Flagged closures this near to each other belong to one place, metres.
const SAME_PLACE_M: f64 = 3.0;
/// Closures this near to a flagged one show whether the place still contradicts, metres.
const AT_PLACE_M: f64 = 1.0;
/// Closures of a trip at least this many nodes apart belong to two passes. Flagged closures of one pass belong
/// to one place: a bias common to neighbours is absorbed between them, and shows where a vehicle enters the
/// place and where it leaves it.
const PASS_NODES: u32 = 12;
/// Fewer flagged closures are no finding.
const FLAGGED_MIN: usize = 2;
/// A pass agrees with the map if none of its closures is less likely than this: that none is flagged is not
/// enough.
const USUAL_P_MIN: f64 = 0.01;
/// Radius of the region round each flagged closure, metres: residuals do not say what differs.
const REGION_RADIUS_M: f64 = 0.5;

/// A closure that was tested.
#[derive(Debug, Clone, PartialEq)]
pub struct JudgedClosure {
    /// The closure.
    pub edge: EdgeId,
    /// Its nodes, the newer one last.
    pub nodes: [NodeId; 2],
    /// Halfway between them, map frame, metres.
    pub place: Vector2<f64>,
    /// Stamp of its newer node.
    pub stamp: StampNs,
    /// The trip of its newer node, and that node's place in it.
    pub trip: (TripId, u32),
    /// The probability of such a residual without a change.
    pub p_value: f64,
    /// Whether that is below the stated rate of false alarms.
    pub flagged: bool,
}

/// The places that contradict the map, in the order in which each was first flagged. A place
/// that contradicts, agrees, and contradicts again has two findings, the first one ended.
pub fn residual_runs(closures: &[JudgedClosure]) -> Vec<Finding> {
    let mut in_order: Vec<&JudgedClosure> = closures.iter().collect();
    in_order.sort_by_key(|closure| (closure.stamp, closure.edge));
    let flagged: Vec<&JudgedClosure> = in_order.iter().copied().filter(|c| c.flagged).collect();
    let mut findings: Vec<Finding> = places_of(&flagged)
        .iter()
        .flat_map(|place| findings_at(place, &in_order))
        .collect();
    findings.sort_by_key(|finding| (finding.since, finding.edges.first().copied()));
    findings
}

/// Flagged closures by place: any two of one place are joined by steps of at most [`SAME_PLACE_M`], or
/// within a pass.
fn places_of<'a>(flagged: &[&'a JudgedClosure]) -> Vec<Vec<&'a JudgedClosure>> {
    let mut places: Vec<Vec<&JudgedClosure>> = Vec::new();
    for closure in flagged {
        let is_near = |place: &Vec<&JudgedClosure>| {
            is_within(closure, place, SAME_PLACE_M) || place.iter().any(|c| same_pass(c, closure))
        };
        let (near, mut apart): (Vec<_>, Vec<_>) = places.into_iter().partition(is_near);
        let mut joined: Vec<&JudgedClosure> = near.into_iter().flatten().collect();
        joined.push(closure);
        apart.push(joined);
        places = apart;
    }
    places
}

fn is_within(closure: &JudgedClosure, others: &[&JudgedClosure], distance_m: f64) -> bool {
    let mut others = others.iter();
    others.any(|other| (other.place - closure.place).norm() <= distance_m)
}

fn same_pass(a: &JudgedClosure, b: &JudgedClosure) -> bool {
    a.trip.0 == b.trip.0 && a.trip.1.abs_diff(b.trip.1) < PASS_NODES
}

/// The closures of one pass.
type Pass<'a> = Vec<&'a JudgedClosure>;

fn findings_at(place: &[&JudgedClosure], in_order: &[&JudgedClosure]) -> Vec<Finding> {
    let here = in_order.iter().copied();
    let here = here.filter(|closure| is_within(closure, place, AT_PLACE_M));
    let passes = passes_of(here);
    let flagged_in = |pass: &Pass<'_>| pass.iter().filter(|closure| closure.flagged).count();
    let mut findings = Vec::new();
    let mut episode: Vec<&Pass<'_>> = Vec::new();
    for pass in &passes {
        let flagged = flagged_in(pass);
        let flagged_last = episode.last().map_or(0, |last| flagged_in(last));
        if flagged > 0 {
            episode.push(pass);
        } else if 2 * pass.len() >= flagged_last && pass.iter().all(|c| c.p_value >= USUAL_P_MIN) {
            let until = pass.iter().map(|closure| closure.stamp).min();
            findings.extend(finding_of(&episode, until, in_order.len()));
            episode.clear();
        }
    }
    findings.extend(finding_of(&episode, None, in_order.len()));
    findings
}

/// Passes in the order of their first closures.
fn passes_of<'a>(here: impl Iterator<Item = &'a JudgedClosure>) -> Vec<Pass<'a>> {
    let mut passes: Vec<Pass<'_>> = Vec::new();
    for closure in here {
        let goes_on = |pass: &&mut Pass<'_>| same_pass(pass[pass.len() - 1], closure);
        match passes.iter_mut().rev().find(goes_on) {
            Some(pass) => pass.push(closure),
            None => passes.push(vec![closure]),
        }
    }
    passes
}

fn finding_of(episode: &[&Pass<'_>], until: Option<StampNs>, tested: usize) -> Option<Finding> {
    let closures = episode.iter().flat_map(|pass| pass.iter());
    let flagged: Vec<&JudgedClosure> = closures.copied().filter(|c| c.flagged).collect();
    if flagged.len() < FLAGGED_MIN {
        return None;
    }
    let places: Vec<Vector2<f64>> = flagged.iter().map(|closure| closure.place).collect();
    let location = places.iter().sum::<Vector2<f64>>() / places.len() as f64;
    let spread_m = places.iter().map(|place| (place - location).norm_squared());
    let spread_m = (spread_m.sum::<f64>() / places.len() as f64).sqrt();
    let edges: BTreeSet<EdgeId> = flagged.iter().map(|closure| closure.edge).collect();
    let nodes: BTreeSet<NodeId> = flagged.iter().flat_map(|closure| closure.nodes).collect();
    let trips: BTreeSet<&TripId> = flagged.iter().map(|closure| &closure.trip.0).collect();
    let least = flagged
        .iter()
        .map(|closure| closure.p_value)
        .fold(1.0, f64::min);
    Some(Finding {
        tier: Tier::Confirmed,
        counterpart: None,
        shift: None,
        suspect: None,
        bands: Vec::new(),
        kind: ChangeKind::Residual,
        location,
        sigma_m: spread_m.max(REGION_RADIUS_M),
        region: region_round(&places, REGION_RADIUS_M),
        edges: edges.into_iter().collect(),
        nodes: nodes.into_iter().collect(),
        trips: trips.into_iter().cloned().collect(),
        views: flagged.len(),
        laps: episode.len(),
        // As likely as the least likely of all that were tested is not to be chance.
        confidence: (1.0 - least * tested as f64).clamp(0.0, 1.0),
        since: flagged.iter().map(|closure| closure.stamp).min()?,
        last_seen: flagged.iter().map(|closure| closure.stamp).max()?,
        until,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Nodes of a lap, a metre apart.
    const LAP: u32 = 40;

    /// Laps along x, of which some closures are flagged: (lap, place).
    fn laps(count: u32, flagged: impl Fn(u32, u32) -> bool) -> Vec<JudgedClosure> {
        let closure = |lap: u32, at: u32| {
            let k = i64::from(lap * LAP + at);
            let flagged = flagged(lap, at);
            JudgedClosure {
                edge: EdgeId(k),
                nodes: [NodeId(i64::from(at)), NodeId(1_000 + k)],
                place: Vector2::new(f64::from(at), 0.1 * f64::from(lap % 2)),
                stamp: StampNs(k),
                trip: (TripId::new("t").unwrap(), lap * LAP + at),
                p_value: if flagged { 1e-6 } else { 0.5 },
                flagged,
            }
        };
        let laps = (0..count).flat_map(|lap| (0..LAP).map(move |at| (lap, at)));
        laps.map(|(lap, at)| closure(lap, at)).collect()
    }

    #[test]
    fn one_place_is_one_finding_however_often_it_is_passed() {
        let found = residual_runs(&laps(6, |lap, at| lap >= 3 && (20..24).contains(&at)));
        assert_eq!(found.len(), 1);
        let finding = &found[0];
        assert_eq!((finding.views, finding.laps, finding.until), (12, 3, None));
        assert_eq!(finding.since, StampNs(i64::from(3 * LAP + 20)));
        assert_eq!(finding.last_seen, StampNs(i64::from(5 * LAP + 23)));
        assert!((finding.location.x - 21.5).abs() < 1e-12 && finding.sigma_m > 1.0);
        assert!(finding.region.iter().all(|c| (19.0..=24.0).contains(&c.x)));
        assert_eq!(finding.edges.len(), 12);
        assert!(finding.nodes.windows(2).all(|pair| pair[0] < pair[1]));
    }

    #[test]
    fn entering_and_leaving_a_place_is_one_finding() {
        let ends = |at: u32| at == 20 || at == 26;
        assert_eq!(
            residual_runs(&laps(4, |lap, at| lap == 3 && ends(at))).len(),
            1
        );
    }

    #[test]
    fn two_places_are_two_findings() {
        let flagged = |lap, at| lap >= 3 && ((5..8).contains(&at) || (25..28).contains(&at));
        let found = residual_runs(&laps(5, flagged));
        assert_eq!(found.iter().map(|f| f.views).collect::<Vec<_>>(), [6, 6]);
    }

    #[test]
    fn a_lap_that_agrees_ends_it_and_a_later_one_begins_anew() {
        let flagged = |lap, at| [3, 4, 7].contains(&lap) && (20..23).contains(&at);
        let found = residual_runs(&laps(9, flagged));
        let spans: Vec<_> = found.iter().map(|f| (f.laps, f.until)).collect();
        let agrees = |lap: u32| Some(StampNs(i64::from(lap * LAP + 19)));
        assert_eq!(spans, [(2, agrees(5)), (1, agrees(8))]);
    }

    #[test]
    fn a_lap_that_is_neither_usual_nor_reported_ends_nothing() {
        let mut closures = laps(6, |lap, at| [3, 5].contains(&lap) && (20..23).contains(&at));
        closures[(4 * LAP + 21) as usize].p_value = 5e-3;
        let found = residual_runs(&closures);
        assert_eq!(found.len(), 1);
        assert_eq!((found[0].laps, found[0].until), (2, None));
    }

    #[test]
    fn single_closures_now_and_then_are_none() {
        // One in each third lap at the same place: a pass in between agrees.
        assert!(residual_runs(&laps(12, |lap, at| lap % 3 == 0 && at == 20)).is_empty());
        assert!(residual_runs(&laps(6, |lap, at| lap == 3 && (at == 5 || at == 25))).is_empty());
        assert!(residual_runs(&[]).is_empty());
    }

    #[test]
    fn single_closures_of_passes_one_after_the_other_are_one() {
        let found = residual_runs(&laps(6, |lap, at| (3..5).contains(&lap) && at == 20));
        assert_eq!(found.len(), 1);
        assert_eq!((found[0].views, found[0].laps), (2, 2));
    }

    #[test]
    fn the_order_of_arrival_does_not_matter() {
        let flagged = laps(6, |lap, at| lap >= 3 && (20..24).contains(&at));
        let mut backwards = flagged.clone();
        backwards.reverse();
        assert_eq!(residual_runs(&flagged), residual_runs(&backwards));
    }
}
