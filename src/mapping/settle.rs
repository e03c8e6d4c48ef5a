//! Which nodes a route's map can do without, and how they leave it.
//!
//! A route that is driven for ever must not grow for ever: what later laps are judged by are the
//! reference nodes, of every place the first drives over it, and the newest drives.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use super::keyframe::Keyframe;
use super::route_map::RouteMap;
use crate::change::Layer;
use crate::geometry::Vector2;
use crate::graph::{EdgeStatus, GraphError, PoseGraph};
use crate::ids::{NodeId, StampNs, TripId};

/// So many of the newest stretches stay in a map. What is decided about a change is decided within
/// a few laps by the references and these; every closure's solve costs as much as there are.
pub const ACTIVE_STRETCHES: usize = 10;
/// What a trip needs of itself to go on: its newest nodes.
pub const TRIP_TAIL: usize = 32;
/// A trip that goes on for longer counts as several stretches: ten minutes, nanoseconds.
const STRETCH_NS: i64 = 600_000_000_000;
/// Of every place the nodes of so many stretches stay, the oldest: a change is a contradiction to
/// what was there before, and one drive alone may have seen too little of it or err.
pub const FIRST_STRETCHES: usize = 3;
/// Nodes nearer to each other than this are at one place, metres.
const SAME_PLACE_M: f64 = 1.5;
/// Nodes leave together once they are at least one in so many: each leave-taking rebuilds the map.
const LEAVING_ONE_IN: usize = 16;

/// What stays in a map although its drive has settled, beside references and what holds them
/// together.
#[derive(Debug, Clone, Copy)]
pub struct Stay<'a> {
    /// So many of the newest stretches.
    pub stretches: usize,
    /// A trip that is going on: its last [`TRIP_TAIL`] nodes.
    pub trip: &'a TripId,
    /// Nodes that something names.
    pub nodes: &'a BTreeSet<NodeId>,
    /// Of every place the nodes of so many stretches, the oldest.
    pub first_stretches: usize,
}

/// A part of a trip.
struct Stretch {
    first: StampNs,
    last: StampNs,
    places: Vec<usize>,
}

impl RouteMap {
    /// The nodes that can leave the map, ascending; none if they would be too few to be worth it.
    ///
    /// A stretch of a trip has settled once `stay.stretches` others began after its last scan.
    /// This rests on stamps alone, not on the order of arrival and not on a clock. Of its nodes
    /// these stay: references, the map's first node, those that `stay` names, those of the first
    /// stretches that were at their place, and those without which a reference would hang on
    /// nothing.
    pub fn settled_nodes(&self, stay: &Stay<'_>) -> Vec<NodeId> {
        let nodes = self.graph.nodes();
        let mut leaving = vec![false; nodes.len()];
        let settled = self.settled_stretches(stay.stretches);
        for &k in settled.iter().flat_map(|stretch| &stretch.places) {
            let keyframe = &self.keyframes[k];
            leaving[k] = k > 0 && !keyframe.reference && !stay.nodes.contains(&keyframe.node);
        }
        self.keep_first(&settled, stay.first_stretches, &mut leaving);
        let going_on = self.trips.get(stay.trip).map_or(&[][..], Vec::as_slice);
        for &k in going_on.iter().rev().take(TRIP_TAIL) {
            leaving[k] = false;
        }
        keep_what_ties(&self.graph, &mut leaving);
        let ids = nodes.iter().zip(&leaving).filter(|(_, leaves)| **leaves);
        let ids: Vec<NodeId> = ids.map(|(node, _)| node.id).collect();
        if ids.len() * LEAVING_ONE_IN < nodes.len() {
            return Vec::new();
        }
        ids
    }

    /// Takes back from the leaving nodes of settled stretches those of the first ones at each
    /// place, for each height band.
    fn keep_first(&self, settled: &[Stretch], first_stretches: usize, leaving: &mut [bool]) {
        let mut in_order: Vec<&Stretch> = settled.iter().collect();
        in_order.sort_by_key(|stretch| (stretch.first, self.keyframes[stretch.places[0]].node));
        let mut kept: BTreeMap<Layer, KeptPlaces> = BTreeMap::new();
        for (number, stretch) in in_order.iter().enumerate() {
            for &k in &stretch.places {
                let at = self.graph.nodes()[k].pose.translation();
                let has_scan = self.keyframes[k].scan.is_some();
                let kept = kept.entry(self.keyframes[k].layer()).or_default();
                leaving[k] &= !has_scan || kept.stretches_near(&at, number) >= first_stretches;
                if has_scan && !leaving[k] {
                    kept.insert(&at, number);
                }
            }
        }
    }

    fn settled_stretches(&self, stretches_max: usize) -> Vec<Stretch> {
        let stretches = self.stretches();
        let mut begins: Vec<StampNs> = stretches.iter().map(|stretch| stretch.first).collect();
        begins.sort_unstable_by(|a, b| b.cmp(a));
        let Some(horizon) = stretches_max.checked_sub(1).and_then(|k| begins.get(k)) else {
            return Vec::new();
        };
        let horizon = *horizon;
        stretches.into_iter().filter(|s| s.last < horizon).collect()
    }

    fn stretches(&self) -> Vec<Stretch> {
        let span = |k: &usize| {
            let keyframe = &self.keyframes[*k];
            let since_ns = keyframe.stamp.0.saturating_add(phase_ns(&keyframe.trip));
            since_ns.div_euclid(STRETCH_NS)
        };
        let stretch = |places: &[usize]| {
            let stamps = || places.iter().map(|&k| self.keyframes[k].stamp);
            Some(Stretch {
                first: stamps().min()?,
                last: stamps().max()?,
                places: places.to_vec(),
            })
        };
        let trips = self.trips.values();
        trips
            .flat_map(|trip| trip.chunk_by(|a, b| span(a) == span(b)))
            .filter_map(stretch)
            .collect()
    }

    /// Takes settled nodes out of the map, with every edge that ends at one of them, and solves the
    /// sub-graphs that those edges were part of. Nodes that are not there are passed over.
    ///
    /// # Errors
    /// [`GraphError`] if what is left does not fit together; the map is lost then.
    pub fn release(&mut self, leaving: &[NodeId]) -> Result<(), GraphError> {
        self.drop_from_graph(leaving, &[])?;
        self.settle_screen();
        Ok(())
    }

    /// About how much memory the map takes, bytes.
    pub fn size_bytes(&self) -> usize {
        let keyframes: usize = self.keyframes.iter().map(Keyframe::size_bytes).sum();
        let edges = self.graph.edges().len() * EDGE_BYTES;
        keyframes + edges + self.layers.size_bytes()
    }
}

/// Where nodes of settled stretches stay.
#[derive(Default)]
struct KeptPlaces {
    /// By squares of [`SAME_PLACE_M`].
    squares: BTreeMap<(i64, i64), Vec<KeptPlace>>,
}

struct KeptPlace {
    at: Vector2<f64>,
    /// Number of its stretch.
    stretch: usize,
}

impl KeptPlaces {
    fn insert(&mut self, at: &Vector2<f64>, stretch: usize) {
        let square = self.squares.entry(Self::square_of(at)).or_default();
        square.push(KeptPlace { at: *at, stretch });
    }

    /// Stretches other than `stretch` with a node at a place.
    fn stretches_near(&self, at: &Vector2<f64>, stretch: usize) -> usize {
        let (x, y) = Self::square_of(at);
        let columns = x - 1..=x + 1;
        let squares = columns.flat_map(|x| self.squares.range((x, y - 1)..=(x, y + 1)));
        let near = squares.flat_map(|(_, there)| there);
        let near =
            near.filter(|kept| kept.stretch != stretch && (kept.at - at).norm() <= SAME_PLACE_M);
        near.map(|kept| kept.stretch).collect::<BTreeSet<_>>().len()
    }

    fn square_of(at: &Vector2<f64>) -> (i64, i64) {
        let square = |v: f64| (v / SAME_PLACE_M).floor() as i64;
        (square(at.x), square(at.y))
    }
}

/// When a trip's stretches begin, nanoseconds after a full stretch of the clock: a fleet's do not
/// begin all at once, so that nobody's leaves who is only waiting for its next batch.
fn phase_ns(trip: &TripId) -> i64 {
    let mix = |sum: u64, byte: u8| (sum ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
    let mixed = trip.as_str().bytes().fold(0xcbf2_9ce4_8422_2325, mix);
    (mixed % STRETCH_NS.unsigned_abs()).cast_signed()
}

/// An edge in the graph, in its indices, and a share of the solver's memory.
const EDGE_BYTES: usize = 640;

/// Takes back from the leaving nodes those without which nodes that stay would fall apart: the
/// fewest on the way from each to the first one of its component that stays.
fn keep_what_ties(graph: &PoseGraph, leaving: &mut [bool]) {
    let wanted = leaving.to_vec();
    let mut reached: Vec<Option<(usize, usize)>> = vec![None; wanted.len()];
    let firsts = (0..wanted.len()).filter(|&k| !wanted[k]);
    for first in firsts {
        if reached[first].is_none() {
            explore(graph, &wanted, first, &mut reached);
        }
    }
    for k in (0..wanted.len()).filter(|&k| !wanted[k]) {
        let mut at = k;
        while let Some((_, before)) = reached[at]
            && before != at
        {
            at = before;
            if !wanted[at] || !std::mem::replace(&mut leaving[at], false) {
                break;
            }
        }
    }
}

/// Finds the cheapest ways from a node over active edges, where only leaving nodes cost something.
/// `reached` has the cost and the node before on the way.
fn explore(
    graph: &PoseGraph,
    leaving: &[bool],
    first: usize,
    reached: &mut [Option<(usize, usize)>],
) {
    let mut done = BTreeSet::new();
    let mut open = VecDeque::from([first]);
    reached[first] = Some((0, first));
    while let Some(at) = open.pop_front() {
        let Some((cost, _)) = reached[at].filter(|_| done.insert(at)) else {
            continue;
        };
        for &edge in graph.incident(at) {
            if graph.edges()[edge].status != EdgeStatus::Active {
                continue;
            }
            let (from, to) = graph.ends()[edge];
            let next = if from == at { to } else { from };
            let cost = cost + usize::from(leaving[next]);
            if reached[next].is_none_or(|(before, _)| cost < before) {
                reached[next] = Some((cost, at));
                match leaving[next] {
                    true => open.push_back(next),
                    false => open.push_front(next),
                }
            }
        }
    }
}

#[cfg(test)]
mod tests;
