//! A part of a block around some of its nodes.

use std::collections::{HashMap, VecDeque};

use crate::geometry::Pose2;
use crate::graph::{BlockIndex, PoseGraph};
use crate::solver::least_squares::{Problem, factor_of_edge};

/// The nodes of a block that are nearest to some seeds by number of edges, and the ring of nodes
/// around them.
pub(super) struct Region {
    /// Places of nodes in the graph: those inside in the order in which they were reached, then
    /// the ring.
    pub(super) nodes: Vec<usize>,
    inside: usize,
    /// Places of the block's edges with an end inside, ascending.
    pub(super) edges: Vec<usize>,
    /// For each node of the region its place in `nodes`.
    places: HashMap<usize, usize>,
}

impl Region {
    /// At most `size` nodes inside, seeds among them. Costs as much as the region is large.
    pub(super) fn around(
        graph: &PoseGraph,
        block: BlockIndex,
        seeds: &[usize],
        size: usize,
    ) -> Self {
        let mut region = Self {
            nodes: Vec::with_capacity(2 * size),
            inside: 0,
            edges: Vec::new(),
            places: HashMap::with_capacity(2 * size),
        };
        let mut waiting: VecDeque<usize> = seeds.iter().copied().collect();
        while region.nodes.len() < size {
            let Some(node) = waiting.pop_front() else {
                break;
            };
            if !region.take_in(node) {
                continue;
            }
            for edge in edges_in_block(graph, block, node) {
                region.edges.push(edge);
                let (from, to) = graph.ends()[edge];
                waiting.push_back(if from == node { to } else { from });
            }
        }
        region.inside = region.nodes.len();
        region.edges.sort_unstable();
        region.edges.dedup();
        for k in 0..region.edges.len() {
            let (from, to) = graph.ends()[region.edges[k]];
            region.take_in(from);
            region.take_in(to);
        }
        region
    }

    /// Whether the node was not yet there.
    fn take_in(&mut self, node: usize) -> bool {
        let place = self.nodes.len();
        let new = *self.places.entry(node).or_insert(place) == place;
        if new {
            self.nodes.push(node);
        }
        new
    }

    /// Least squares inside, with the ring and the block's anchor held. The poses are
    /// the graph's.
    pub(super) fn problem(&self, graph: &PoseGraph, anchor: usize) -> Problem {
        let pose = |&node: &usize| graph.nodes()[node].pose;
        let held = |(place, &node): (usize, &usize)| place >= self.inside || node == anchor;
        let factor = |&edge: &usize| {
            let (from, to) = graph.ends()[edge];
            factor_of_edge(&graph.edges()[edge], self.places[&from], self.places[&to])
        };
        Problem {
            poses: self.nodes.iter().map(pose).collect(),
            held: self.nodes.iter().enumerate().map(held).collect(),
            factors: self.edges.iter().map(factor).collect(),
            pose_names: self.nodes.clone(),
            factor_names: self.edges.clone(),
        }
    }

    /// The poses inside, to start a larger region with.
    pub(super) fn inside<'a>(&self, poses: &'a [Pose2]) -> &'a [Pose2] {
        &poses[..self.inside]
    }

    /// The nodes of the ring, with their places in the region, and their edges to the outside and
    /// to each other.
    pub(super) fn edges_out(
        &self,
        graph: &PoseGraph,
        block: BlockIndex,
    ) -> impl Iterator<Item = (usize, usize)> {
        let ring = self.nodes.iter().enumerate().skip(self.inside);
        ring.flat_map(move |(place, &node)| {
            let edges = edges_in_block(graph, block, node);
            edges
                .filter(|edge| self.edges.binary_search(edge).is_err())
                .map(move |edge| (place, edge))
        })
    }
}

fn edges_in_block(
    graph: &PoseGraph,
    block: BlockIndex,
    node: usize,
) -> impl Iterator<Item = usize> {
    let blocks = graph.blocks();
    let incident = graph.incident(node).iter().copied();
    incident.filter(move |&edge| blocks.of_edge(edge) == Some(block))
}
