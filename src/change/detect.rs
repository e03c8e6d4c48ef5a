//! From suspicions to findings: one pair of scans only suspects, all looks at a place decide.

use std::collections::{BTreeMap, BTreeSet};

use super::history::{Departure, Seen, State, last_departure};
use super::look::{Look, Sight};
use super::region::{centroid, region_round};
use super::{AcceptedChange, ChangeKind, Finding, Tier};
use crate::geometry::{Vector2, distance_to_polygon};
use crate::ids::{EdgeId, NodeId, StampNs, TripId};

/// Suspicions are gathered in squares of this size, metres.
const CELL_M: f64 = 0.2;
/// Scans whose points must have raised a suspicion at a spot or beside it.
const SUSPECTING_NODES_MIN: usize = 2;
/// Views of the new state that a spot needs.
const VIEWS_MIN: usize = 3;
/// How much better a history with a change must explain the looks, in nats.
const SUPPORT_MIN: f64 = 5.0;
/// Views that an alert needs, over all its spots.
const FINDING_VIEWS_MIN: usize = 4;
/// Changed spots of one kind belong together if so many cells lie from one to the next.
const GROUP_REACH: i32 = 3;
/// Closures that must have suspected a finding: one pose that is off suspects alone.
const FINDING_EDGES_MIN: usize = 5;
/// How far the outline stays away from the points, metres.
const REGION_MARGIN_M: f64 = 0.05;
/// What is known of a pose, metres: no location is better.
const POSE_SIGMA_M: f64 = 0.02;

/// A point of one scan in another's free space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Suspicion {
    /// The closure between the two scans.
    pub edge: EdgeId,
    /// The node whose point it is.
    pub node: NodeId,
    /// Where, map frame.
    pub spot: Vector2<f64>,
    /// When the two scans were taken, the older one first.
    pub taken: (StampNs, StampNs),
    /// Whether it is new: only spots near new suspicions are decided anew.
    pub fresh: bool,
}

/// Everything that decides.
pub struct Evidence<'a> {
    /// Every scan of the map, vehicles under suspicion left out.
    pub looks: &'a [Look<'a>],
    /// Names of the trips that looks number.
    pub trips: &'a [TripId],
    /// Every suspicion known.
    pub suspicions: &'a [Suspicion],
    /// Accepted changes.
    pub accepted: &'a [AcceptedChange],
    /// Places that are decided anew without a new suspicion.
    pub watched: &'a [Vec<Vector2<f64>>],
}

type CellKey = (i32, i32);

#[derive(Default)]
struct Cell {
    spots: Vec<Vector2<f64>>,
    edges: BTreeMap<EdgeId, (StampNs, StampNs)>,
    nodes: BTreeSet<NodeId>,
    fresh: bool,
}

/// A spot that changed.
struct Changed {
    departure: Departure,
    kind: ChangeKind,
}

/// What the looks say about the suspected spots, in the order of their places.
pub fn detect(evidence: &Evidence<'_>) -> Vec<Finding> {
    let cells = gather(evidence.suspicions);
    let mut changed: BTreeMap<CellKey, Changed> = BTreeMap::new();
    for (key, cell) in &cells {
        if is_due(*key, cell, &cells, evidence)
            && let Some(found) = decide(cell, evidence)
        {
            changed.insert(*key, found);
        }
    }
    let groups = group(&changed);
    let findings = groups.iter().filter_map(|group| {
        let finding = finding_of(group, &changed, &cells, evidence.trips);
        let is_backed = |finding: &Finding| {
            finding.views >= FINDING_VIEWS_MIN && finding.edges.len() >= FINDING_EDGES_MIN
        };
        Some(finding).filter(is_backed)
    });
    findings.collect()
}

fn gather(suspicions: &[Suspicion]) -> BTreeMap<CellKey, Cell> {
    let mut cells: BTreeMap<CellKey, Cell> = BTreeMap::new();
    for suspicion in suspicions {
        let cell = cells.entry(key_of(&suspicion.spot)).or_default();
        cell.spots.push(suspicion.spot);
        cell.edges.insert(suspicion.edge, suspicion.taken);
        cell.nodes.insert(suspicion.node);
        cell.fresh |= suspicion.fresh;
    }
    cells
}

fn key_of(spot: &Vector2<f64>) -> CellKey {
    let cell = |v: f64| (v / CELL_M).floor() as i32;
    (cell(spot.x), cell(spot.y))
}

fn around(key: CellKey, reach: i32) -> impl Iterator<Item = CellKey> {
    (-reach..=reach).flat_map(move |dx| (-reach..=reach).map(move |dy| (key.0 + dx, key.1 + dy)))
}

fn is_due(
    key: CellKey,
    cell: &Cell,
    cells: &BTreeMap<CellKey, Cell>,
    evidence: &Evidence<'_>,
) -> bool {
    let near: Vec<&Cell> = around(key, 1).filter_map(|k| cells.get(&k)).collect();
    let watched = || {
        let spot = mean(&cell.spots);
        let mut watched = evidence.watched.iter();
        watched.any(|region| distance_to_polygon(&spot, region) <= REGION_MARGIN_M)
    };
    if !near.iter().any(|cell| cell.fresh) && !watched() {
        return false;
    }
    let nodes: BTreeSet<NodeId> = near.iter().flat_map(|c| c.nodes.iter().copied()).collect();
    nodes.len() >= SUSPECTING_NODES_MIN
}

fn decide(cell: &Cell, evidence: &Evidence<'_>) -> Option<Changed> {
    let spot = mean(&cell.spots);
    let is_outdated = |look: &Look<'_>| {
        let mut accepted = evidence.accepted.iter();
        accepted.any(|change| change.outdates(look.stamp, &spot))
    };
    let reaching = evidence.looks.iter().filter(|look| look.reaches(&spot));
    let seen = reaching.filter_map(|look| {
        let sight = look.sight(&spot);
        (sight != Sight::Hidden && !is_outdated(look)).then_some(Seen {
            node: look.node,
            trip: look.trip,
            order: look.order,
            stamp: look.stamp,
            sight,
        })
    });
    let departure = last_departure(seen.collect())?;
    let kind = match departure.baseline {
        State::Free => ChangeKind::Appeared,
        State::Occupied => ChangeKind::Disappeared,
    };
    (departure.support >= SUPPORT_MIN && departure.nodes.len() >= VIEWS_MIN)
        .then_some(Changed { departure, kind })
}

fn mean(spots: &[Vector2<f64>]) -> Vector2<f64> {
    let sum: Vector2<f64> = spots.iter().sum();
    sum / spots.len().max(1) as f64
}

/// Changed spots of one kind that touch.
fn group(changed: &BTreeMap<CellKey, Changed>) -> Vec<Vec<CellKey>> {
    let mut left: BTreeSet<CellKey> = changed.keys().copied().collect();
    let mut groups = Vec::new();
    while let Some(first) = left.pop_first() {
        let kind = changed[&first].kind;
        let mut group = vec![first];
        let mut next = 0;
        while next < group.len() {
            for key in around(group[next], GROUP_REACH) {
                if left.contains(&key) && changed[&key].kind == kind {
                    left.remove(&key);
                    group.push(key);
                }
            }
            next += 1;
        }
        groups.push(group);
    }
    groups
}

fn finding_of(
    group: &[CellKey],
    changed: &BTreeMap<CellKey, Changed>,
    cells: &BTreeMap<CellKey, Cell>,
    trip_names: &[TripId],
) -> Finding {
    let departures = || group.iter().map(|key| &changed[key].departure);
    let spots: Vec<Vector2<f64>> = group
        .iter()
        .flat_map(|key| cells[key].spots.iter().copied())
        .collect();
    let region = region_round(&spots, REGION_MARGIN_M);
    let views: BTreeSet<NodeId> = departures().flat_map(|d| d.nodes.iter().copied()).collect();
    let since = departures()
        .map(|d| d.since)
        .min()
        .unwrap_or(StampNs(i64::MAX));
    let edges: BTreeSet<EdgeId> = group
        .iter()
        .flat_map(|key| &cells[key].edges)
        .filter(|(_, (older, newer))| *older < since && since <= *newer)
        .map(|(edge, _)| *edge)
        .collect();
    let suspecting = group
        .iter()
        .flat_map(|key| cells[key].nodes.iter().copied());
    let nodes: BTreeSet<NodeId> = suspecting.chain(views.iter().copied()).collect();
    let trips: BTreeSet<usize> = departures().flat_map(|d| d.trips.iter().copied()).collect();
    let support = departures().map(|d| d.support).fold(0.0, f64::max);
    let stands = departures().any(|d| d.until.is_none());
    Finding {
        tier: Tier::Confirmed,
        counterpart: None,
        kind: changed[&group[0]].kind,
        location: centroid(&region),
        sigma_m: POSE_SIGMA_M.hypot(CELL_M / (group.len() as f64).sqrt() / 12_f64.sqrt()),
        region,
        edges: edges.into_iter().collect(),
        nodes: nodes.into_iter().collect(),
        trips: trips
            .into_iter()
            .map(|trip| trip_names[trip].clone())
            .collect(),
        views: views.len(),
        laps: departures().map(|d| d.passes).max().unwrap_or_default(),
        confidence: 1.0 / (1.0 + (-support).exp()),
        since,
        last_seen: departures()
            .map(|d| d.last_seen)
            .max()
            .unwrap_or(StampNs(0)),
        until: departures()
            .filter_map(|d| d.until)
            .max()
            .filter(|_| !stands),
    }
}

#[cfg(test)]
mod tests;
