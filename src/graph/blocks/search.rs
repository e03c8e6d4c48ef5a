//! Finding all blocks at once.

use super::{Block, BlockIndex, Blocks};
use crate::graph::edge::Edge;
use crate::model::EdgeStatus;

impl Blocks {
    /// The blocks of a graph's edges, given with the places of their ends and, for each node, the
    /// places of the edges at it. None is known to be at its optimum.
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
    /// 1, 2, … in the order of discovery; 0 where the search has not been.
    discovered: Vec<usize>,
    /// The earliest discovery that a node's subtree reaches by one edge back.
    low: Vec<usize>,
    clock: usize,
    open_edges: Vec<usize>,
    found: Blocks,
}

struct Visit {
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
                hanging: vec![Vec::new(); nodes],
                towards_first: vec![None; nodes],
                earlier: (0..nodes).collect(),
                ..Blocks::default()
            },
        }
    }

    fn discover(&mut self, node: usize, by_edge: Option<usize>) -> Visit {
        self.clock += 1;
        self.discovered[node] = self.clock;
        self.low[node] = self.clock;
        Visit {
            node,
            by_edge,
            next_incident: 0,
        }
    }

    fn explore(&mut self, first: usize) {
        let mut path = vec![self.discover(first, None)];
        while let Some(visit) = path.last_mut() {
            let node = visit.node;
            let Some(&edge) = self.incident[node].get(visit.next_incident) else {
                let by_edge = visit.by_edge;
                path.pop();
                if let (Some(parent), Some(by_edge)) = (path.last(), by_edge) {
                    self.leave(parent.node, node, by_edge);
                }
                continue;
            };
            visit.next_incident += 1;
            // The tree edge is passed over by its place, so that a parallel one counts as a way
            // back.
            let active = self.edges[edge].status == EdgeStatus::Active;
            if !active || visit.by_edge == Some(edge) {
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

    /// Back from a child to its parent; a block ends here if the child's subtree reaches no
    /// further than the parent.
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
                // Every node but the anchor hangs on exactly one block.
                if node != parent && self.found.towards_first[node].is_none() {
                    self.found.towards_first[node] = Some(index);
                    nodes.push(node);
                }
            }
        }
        nodes.shrink_to_fit();
        self.found.hanging[parent].push(index);
        self.found.blocks.push(Block {
            anchor: parent,
            nodes,
            edges,
            smallest_edge,
        });
    }
}
