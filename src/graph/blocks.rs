//! Biconnected blocks: the parts of a pose graph that can be solved on their own.
//!
//! A minimum of F separates exactly over the blocks: a bridge has no error there, and two blocks
//! that share a cut node do not influence each other's relative poses.

use super::pose_graph::{EdgeStatus, PoseGraph};
use crate::ids::{EdgeId, NodeId};

/// A place in [`Blocks`].
pub type BlockIndex = usize;

/// The biconnected blocks of a graph's active edges (Hopcroft and Tarjan 1973). Two parallel
/// edges make a block; a bridge is a block of its own. Nodes and edges are named by their places
/// in [`PoseGraph::nodes`] and [`PoseGraph::edges`]. Costs one pass over the graph.
#[derive(Debug, Clone, Default)]
pub struct Blocks {
    blocks: Vec<Block>,
    block_of_edge: Vec<Option<BlockIndex>>,
    /// The blocks that hang off a node, away from its component's first node.
    hanging: Vec<Vec<BlockIndex>>,
    /// The block through which a node hangs on its component's first node.
    towards_first: Vec<Option<BlockIndex>>,
}

/// One biconnected block.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Block {
    /// Its node nearest to its component's first node: that node itself, or the cut node on the
    /// way there.
    pub anchor: usize,
    /// Its other nodes, ascending.
    pub nodes: Vec<usize>,
    /// Its edges, ascending.
    pub edges: Vec<usize>,
    /// The smallest edge id in it, a name that lasts while the block grows; `None` for a bridge,
    /// which closes no loop.
    pub subgraph_id: Option<EdgeId>,
}

impl Block {
    /// Whether it is a single edge that closes no loop.
    pub fn is_bridge(&self) -> bool {
        self.edges.len() == 1
    }
}

impl Blocks {
    /// The blocks of a graph.
    pub fn of(graph: &PoseGraph) -> Self {
        let mut search = Search::new(graph);
        for first in 0..graph.nodes().len() {
            if search.discovered[first] == 0 {
                search.explore(first);
            }
        }
        search.found
    }

    /// All blocks. A block comes after those that hang off it.
    pub fn all(&self) -> &[Block] {
        &self.blocks
    }

    /// The block of the edge at a place; `None` if it is not active.
    pub fn of_edge(&self, edge_position: usize) -> Option<BlockIndex> {
        self.block_of_edge.get(edge_position).copied().flatten()
    }

    /// The blocks that hang off the node at a place: it is their anchor.
    pub fn hanging_off(&self, node_position: usize) -> &[BlockIndex] {
        self.hanging.get(node_position).map_or(&[], Vec::as_slice)
    }

    /// All blocks that the node at a place belongs to.
    pub fn at_node(&self, node_position: usize) -> impl Iterator<Item = &Block> {
        let towards_first = self.towards_first.get(node_position).copied().flatten();
        let indices = towards_first
            .into_iter()
            .chain(self.hanging_off(node_position).iter().copied());
        indices.map(|index| &self.blocks[index])
    }

    /// Whether the node at a place belongs to more than one block.
    pub fn is_cut_node(&self, node_position: usize) -> bool {
        self.at_node(node_position).nth(1).is_some()
    }

    /// The name of the sub-graph that the edge at a place belongs to; `None` for bridges and
    /// inactive edges.
    pub fn subgraph_of_edge(&self, edge_position: usize) -> Option<EdgeId> {
        self.blocks[self.of_edge(edge_position)?].subgraph_id
    }

    /// The smallest name among the sub-graphs that a node belongs to; `None` if no loop closes
    /// over it.
    pub fn subgraph_of_node(&self, graph: &PoseGraph, node: NodeId) -> Option<EdgeId> {
        let position = graph.node_position(node)?;
        self.at_node(position).filter_map(|b| b.subgraph_id).min()
    }
}

/// A depth-first search without recursion: routes are chains of thousands of nodes.
struct Search<'a> {
    graph: &'a PoseGraph,
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
    fn new(graph: &'a PoseGraph) -> Self {
        let (nodes, edges) = (graph.nodes().len(), graph.edges().len());
        Self {
            graph,
            discovered: vec![0; nodes],
            low: vec![0; nodes],
            clock: 0,
            open_edges: Vec::new(),
            found: Blocks {
                blocks: Vec::new(),
                block_of_edge: vec![None; edges],
                hanging: vec![Vec::new(); nodes],
                towards_first: vec![None; nodes],
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
            let Some(&edge) = self.graph.incident(node).get(visit.next_incident) else {
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
            let active = self.graph.edges()[edge].status == EdgeStatus::Active;
            if !active || visit.by_edge == Some(edge) {
                continue;
            }
            let (from, to) = self.graph.ends()[edge];
            let other = if from == node { to } else { from };
            if self.discovered[other] == 0 {
                self.open_edges.push(edge);
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
        let index = self.found.blocks.len();
        let start = self.open_edges.iter().rposition(|&edge| edge == by_edge);
        let mut edges = self.open_edges.split_off(start.unwrap_or_default());
        edges.sort_unstable();
        let mut nodes: Vec<usize> = Vec::with_capacity(edges.len() + 1);
        for &edge in &edges {
            self.found.block_of_edge[edge] = Some(index);
            let (from, to) = self.graph.ends()[edge];
            for node in [from, to] {
                // Every node but the anchor hangs on exactly one block.
                if node != parent && self.found.towards_first[node].is_none() {
                    self.found.towards_first[node] = Some(index);
                    nodes.push(node);
                }
            }
        }
        nodes.sort_unstable();
        let ids = edges.iter().map(|&edge| self.graph.edges()[edge].id);
        let subgraph_id = ids.min().filter(|_| edges.len() > 1);
        self.found.hanging[parent].push(index);
        self.found.blocks.push(Block {
            anchor: parent,
            nodes,
            edges,
            subgraph_id,
        });
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::geometry::{Information, Pose2};
    use crate::graph::{Edge, EdgeKind, Node};

    fn graph(nodes: usize, ends: &[(usize, usize)]) -> PoseGraph {
        let mut graph = PoseGraph::new();
        for k in 0..nodes {
            let id = NodeId(k as i64);
            let pose = Pose2::IDENTITY;
            graph.add_node(Node { id, pose }).unwrap();
        }
        for (k, &(from, to)) in ends.iter().enumerate() {
            graph
                .add_edge(Edge {
                    id: EdgeId(100 + k as i64),
                    from: NodeId(from as i64),
                    to: NodeId(to as i64),
                    measurement: Pose2::IDENTITY,
                    information: Information::identity(),
                    kind: EdgeKind::LoopClosure,
                    status: EdgeStatus::Active,
                })
                .unwrap();
        }
        graph
    }

    /// Two triangles that share node 2, a bridge to 5, and a parallel pair 5 = 6.
    #[test]
    fn a_graph_with_everything() {
        let ends = [
            (0, 1),
            (1, 2),
            (2, 0),
            (2, 3),
            (3, 4),
            (4, 2),
            (4, 5),
            (5, 6),
            (6, 5),
        ];
        let mut graph = graph(8, &ends);
        let blocks = Blocks::of(&graph);
        let names: Vec<_> = (0..9).map(|e| blocks.subgraph_of_edge(e)).collect();
        let id = |k: i64| Some(EdgeId(k));
        assert_eq!(
            names,
            [
                id(100),
                id(100),
                id(100),
                id(103),
                id(103),
                id(103),
                None,
                id(107),
                id(107)
            ]
        );
        let cuts: Vec<usize> = (0..8).filter(|&n| blocks.is_cut_node(n)).collect();
        assert_eq!(cuts, [2, 4, 5]);
        let of = |node| blocks.subgraph_of_node(&graph, NodeId(node));
        assert_eq!(
            [of(2), of(4), of(5), of(6)],
            [id(100), id(103), id(107), id(107)]
        );
        assert_eq!(of(7), None);
        let second = &blocks.all()[blocks.of_edge(4).unwrap()];
        assert_eq!((second.anchor, second.nodes.as_slice()), (2, &[3, 4][..]));

        graph.set_edge_status(EdgeId(104), EdgeStatus::Retired);
        let blocks = Blocks::of(&graph);
        assert_eq!(blocks.of_edge(4), None);
        assert!(blocks.all()[blocks.of_edge(3).unwrap()].is_bridge());
    }

    #[test]
    fn a_long_chain_does_not_overflow_the_stack() {
        let ends: Vec<_> = (0..100_000).map(|k| (k, k + 1)).collect();
        let blocks = Blocks::of(&graph(100_001, &ends));
        assert_eq!(blocks.all().len(), 100_000);
    }

    /// Whether two nodes are joined without one node and without one edge.
    fn joined(nodes: usize, ends: &[(usize, usize)], a: usize, b: usize, without: usize) -> bool {
        let mut reached = vec![false; nodes];
        reached[a] = true;
        for _ in 0..nodes {
            for &(from, to) in ends {
                if from != without && to != without && (reached[from] || reached[to]) {
                    reached[from] = true;
                    reached[to] = true;
                }
            }
        }
        reached[b]
    }

    /// Two edges are in one block if they lie on a common simple cycle: by brute force, if no
    /// node's removal parts them (edges that share both ends are parallel).
    fn share_a_block(nodes: usize, ends: &[(usize, usize)], e: usize, f: usize) -> bool {
        let parted_by = |cut: usize| {
            let side = |edge: (usize, usize)| if edge.0 == cut { edge.1 } else { edge.0 };
            !joined(nodes, ends, side(ends[e]), side(ends[f]), cut)
        };
        (0..=nodes).all(|cut| !parted_by(cut)) && !parted_by_an_edge(nodes, ends, e, f)
    }

    /// Whether e or f is a bridge.
    fn parted_by_an_edge(nodes: usize, ends: &[(usize, usize)], e: usize, f: usize) -> bool {
        [e, f].into_iter().any(|bridge| {
            let mut rest = ends.to_vec();
            let (a, b) = rest.remove(bridge);
            !joined(nodes, &rest, a, b, nodes)
        })
    }

    proptest! {
        #[test]
        fn agrees_with_brute_force(
            nodes in 2..9_usize,
            raw in prop::collection::vec((0..9_usize, 0..9_usize), 1..14),
        ) {
            let ends: Vec<(usize, usize)> = raw
                .into_iter()
                .map(|(a, b)| (a % nodes, b % nodes))
                .filter(|(a, b)| a != b)
                .collect();
            let blocks = Blocks::of(&graph(nodes, &ends));
            for e in 0..ends.len() {
                prop_assert!(blocks.of_edge(e).is_some());
                for f in 0..e {
                    let together = blocks.of_edge(e) == blocks.of_edge(f);
                    prop_assert_eq!(together, share_a_block(nodes, &ends, e, f), "{:?} {} {}", ends, e, f);
                }
            }
            for block in blocks.all() {
                prop_assert!(!block.nodes.contains(&block.anchor));
                let mut from_edges: Vec<usize> = block.edges.iter()
                    .flat_map(|&e| [ends[e].0, ends[e].1])
                    .filter(|&n| n != block.anchor)
                    .collect();
                from_edges.sort_unstable();
                from_edges.dedup();
                prop_assert_eq!(&from_edges, &block.nodes);
            }
            // Each component's blocks hang together at its first node.
            for node in 0..nodes {
                let components = (0..nodes).filter(|&n| joined(nodes, &ends, n, node, nodes));
                let first = components.min() == Some(node);
                prop_assert_eq!(first, blocks.towards_first[node].is_none());
            }
        }
    }
}
