//! Which nodes a route's map can do without, and how they leave it.
//!
//! A route that is driven for ever must not grow for ever: what later laps are judged by are the
//! reference nodes and the newest drives.

use std::collections::{BTreeSet, VecDeque};

use super::keyframe::Keyframe;
use super::route_map::RouteMap;
use crate::graph::{Edge, EdgeStatus, GraphError, PoseGraph};
use crate::ids::{EdgeId, NodeId, StampNs, TripId};

/// So many of the newest stretches stay in a map. What is decided about a change is decided within
/// a few laps by the references and these; every closure's solve costs as much as there are.
pub const ACTIVE_STRETCHES: usize = 10;
/// What a trip needs of itself to go on: its newest nodes.
pub const TRIP_TAIL: usize = 32;
/// A trip that goes on for longer counts as several stretches: ten minutes, nanoseconds.
const STRETCH_NS: i64 = 600_000_000_000;
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
    /// these stay: references, the map's first node, those that `stay` names, and those without
    /// which a reference would hang on nothing.
    pub fn settled_nodes(&self, stay: &Stay<'_>) -> Vec<NodeId> {
        let nodes = self.graph.nodes();
        let mut leaving = vec![false; nodes.len()];
        for k in self.settled_places(stay.stretches) {
            let keyframe = &self.keyframes[k];
            leaving[k] = k > 0 && !keyframe.reference && !stay.nodes.contains(&keyframe.node);
        }
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

    fn settled_places(&self, stretches_max: usize) -> Vec<usize> {
        let stretches = self.stretches();
        let mut begins: Vec<StampNs> = stretches.iter().map(|stretch| stretch.first).collect();
        begins.sort_unstable_by(|a, b| b.cmp(a));
        let Some(horizon) = stretches_max.checked_sub(1).and_then(|k| begins.get(k)) else {
            return Vec::new();
        };
        let settled = stretches.iter().filter(|s| s.last < *horizon);
        settled.flat_map(|s| s.places.iter().copied()).collect()
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

    /// Takes nodes out of the map, with every edge that ends at one of them, and solves the
    /// sub-graphs that those edges were part of. Nodes that are not there are passed over.
    ///
    /// # Errors
    /// [`GraphError`] if what is left does not fit together; the map is lost then.
    pub fn release(&mut self, leaving: &[NodeId]) -> Result<(), GraphError> {
        let leaving: BTreeSet<NodeId> = leaving.iter().copied().collect();
        let leaves = |edge: &Edge| leaving.contains(&edge.from) || leaving.contains(&edge.to);
        let edges = self.graph.edges().iter().filter(|edge| leaves(edge));
        let leaving_edges: Vec<(EdgeId, EdgeStatus)> = edges.map(|e| (e.id, e.status)).collect();
        let around = self.edges_around(&leaving_edges);

        let keyframes = std::mem::take(&mut self.keyframes);
        let graph = std::mem::take(&mut self.graph);
        self.trips.clear();
        for (keyframe, node) in keyframes.into_iter().zip(graph.nodes()) {
            if !leaving.contains(&node.id) {
                self.insert_keyframe(node.pose, keyframe)?;
            }
        }
        for edge in graph.edges().iter().filter(|edge| !leaves(edge)) {
            self.graph.add_edge(*edge)?;
        }
        self.solve_anew(around);
        self.settle_screen();
        Ok(())
    }

    /// About how much memory the map takes, bytes.
    pub fn size_bytes(&self) -> usize {
        let keyframes: usize = self.keyframes.iter().map(Keyframe::size_bytes).sum();
        let edges = self.graph.edges().len() * EDGE_BYTES;
        keyframes + edges + self.screen.size_bytes()
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
