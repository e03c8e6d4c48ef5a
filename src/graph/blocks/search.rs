//! Finds all blocks by one depth-first search.

use super::{Block, BlockIndex, Blocks};
use crate::graph::edge::Edge;
use crate::model::EdgeStatus;

impl Blocks {
    /// The blocks of a graph's edges, given with the indices of their ends and, for each node, the indices of
    /// its edges.
    pub(in crate::graph) fn of(
        edges: &[Edge],
        ends: &[(usize, usize)],
        incident: &[Vec<usize>],
    ) -> Self {
        let mut search = Search::new(edges, ends, incident);
        for first in 0..incident.len() {
            if search.discovered[first] == 0 {
                search.explore(first);
            }
        }
        search.found
    }
}

/// A depth-first search without recursion: routes are chains of thousands of nodes.
struct Search<'a> {
    edges: &'a [Edge],
    ends: &'a [(usize, usize)],
    incident: &'a [Vec<usize>],
    /// 1, 2, … in the order of discovery; 0 if not discovered.
    discovered: Vec<usize>,
    /// The earliest discovery that a node's subtree reaches by one back edge.
    low: Vec<usize>,
    clock: usize,
    open_edges: Vec<usize>,
    found: Blocks,
}

struct Frame {
    node: usize,
    /// The tree edge by which the node was reached.
    by_edge: Option<usize>,
    next_incident: usize,
}

impl<'a> Search<'a> {
    fn new(edges: &'a [Edge], ends: &'a [(usize, usize)], incident: &'a [Vec<usize>]) -> Self {
        let nodes = incident.len();
        Self {
            edges,
            ends,
            incident,
            discovered: vec![0; nodes],
            low: vec![0; nodes],
            clock: 0,
            open_edges: Vec::new(),
            found: Blocks {
                block_of_edge: vec![None; edges.len()],
                children: vec![Vec::new(); nodes],
                towards_first: vec![None; nodes],
                earlier: (0..nodes).collect(),
                ..Blocks::default()
            },
        }
    }

    fn discover(&mut self, node: usize, by_edge: Option<usize>) -> Frame {
        self.clock += 1;
        self.discovered[node] = self.clock;
        self.low[node] = self.clock;
        Frame {
            node,
            by_edge,
            next_incident: 0,
        }
    }

    fn explore(&mut self, first: usize) {
        let mut path = vec![self.discover(first, None)];
        while let Some(frame) = path.last_mut() {
            let node = frame.node;
            let Some(&edge) = self.incident[node].get(frame.next_incident) else {
                let by_edge = frame.by_edge;
                path.pop();
                if let (Some(parent), Some(by_edge)) = (path.last(), by_edge) {
                    self.leave(parent.node, node, by_edge);
                }
                continue;
            };
            frame.next_incident += 1;
            // The tree edge is skipped by its index: a parallel edge counts as a back edge.
            let active = self.edges[edge].status == EdgeStatus::Active;
            if !active || frame.by_edge == Some(edge) {
                continue;
            }
            let (from, to) = self.ends[edge];
            let other = if from == node { to } else { from };
            if self.discovered[other] == 0 {
                self.open_edges.push(edge);
                self.found.earlier[other] = first;
                path.push(self.discover(other, Some(edge)));
            } else if self.discovered[other] < self.discovered[node] {
                self.open_edges.push(edge);
                self.low[node] = self.low[node].min(self.discovered[other]);
            }
        }
    }

    /// Returns from a child to its parent; a block ends here if the child's subtree reaches no further back than
    /// the parent.
    fn leave(&mut self, parent: usize, child: usize, by_edge: usize) {
        self.low[parent] = self.low[parent].min(self.low[child]);
        if self.low[child] < self.discovered[parent] {
            return;
        }
        let index: BlockIndex = self.found.blocks.len();
        let start = self.open_edges.iter().rposition(|&edge| edge == by_edge);
        let edges = self.open_edges.split_off(start.unwrap_or_default());
        let mut nodes: Vec<usize> = Vec::with_capacity(edges.len());
        let mut smallest_edge = self.edges[by_edge].id;
        for &edge in &edges {
            smallest_edge = smallest_edge.min(self.edges[edge].id);
            self.found.block_of_edge[edge] = Some(index);
            let (from, to) = self.ends[edge];
            for node in [from, to] {
                // Every node but the anchor is a child in exactly one block.
                if node != parent && self.found.towards_first[node].is_none() {
                    self.found.towards_first[node] = Some(index);
                    nodes.push(node);
                }
            }
        }
        nodes.shrink_to_fit();
        self.found.children[parent].push(index);
        self.found.blocks.push(Block {
            anchor: parent,
            nodes,
            edges,
            smallest_edge,
        });
    }
}
