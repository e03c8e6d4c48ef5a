//! Nodes and edges, with indices by their ids.

use std::collections::BTreeMap;
use std::sync::OnceLock;

use super::blocks::{Block, Blocks};
use super::edge::{Edge, Node};
use crate::geometry::Pose2;
use crate::ids::{EdgeId, NodeId};
use crate::model::EdgeStatus;

/// Why a node or an edge was refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum GraphError {
    /// The id is taken.
    #[error("node {0} is in the graph already")]
    DuplicateNode(NodeId),
    /// The id is taken.
    #[error("edge {0} is in the graph already")]
    DuplicateEdge(EdgeId),
    /// An edge's end is missing.
    #[error("edge {edge} ends at node {node}, which is not in the graph")]
    UnknownNode {
        /// The edge.
        edge: EdgeId,
        /// The missing end.
        node: NodeId,
    },
    /// An edge from a node to itself.
    #[error("edge {0} joins a node to itself")]
    SelfLoop(EdgeId),
}

/// A pose graph. Nodes and edges keep the order in which they were added.
#[derive(Debug, Clone, Default)]
pub struct PoseGraph {
    nodes: Vec<Node>,
    edges: Vec<Edge>,
    ends: Vec<(usize, usize)>,
    incident: Vec<Vec<usize>>,
    node_index: BTreeMap<NodeId, usize>,
    edge_index: BTreeMap<EdgeId, usize>,
    /// Computed on first use, then updated until an edge leaves.
    blocks: OnceLock<Blocks>,
}

impl PoseGraph {
    /// An empty graph.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a node.
    ///
    /// # Errors
    /// [`GraphError::DuplicateNode`].
    pub fn add_node(&mut self, node: Node) -> Result<(), GraphError> {
        if self.node_index.contains_key(&node.id) {
            return Err(GraphError::DuplicateNode(node.id));
        }
        self.node_index.insert(node.id, self.nodes.len());
        self.nodes.push(node);
        self.incident.push(Vec::new());
        if let Some(blocks) = self.blocks.get_mut() {
            blocks.add_node();
        }
        Ok(())
    }

    /// Adds an edge between two existing nodes.
    ///
    /// # Errors
    /// [`GraphError`]; the graph is unchanged then.
    pub fn add_edge(&mut self, edge: Edge) -> Result<(), GraphError> {
        if self.edge_index.contains_key(&edge.id) {
            return Err(GraphError::DuplicateEdge(edge.id));
        }
        if edge.from == edge.to {
            return Err(GraphError::SelfLoop(edge.id));
        }
        let end = |node| {
            self.node_index
                .get(&node)
                .copied()
                .ok_or(GraphError::UnknownNode {
                    edge: edge.id,
                    node,
                })
        };
        let (from, to) = (end(edge.from)?, end(edge.to)?);
        let index = self.edges.len();
        self.edge_index.insert(edge.id, index);
        self.edges.push(edge);
        self.ends.push((from, to));
        self.incident[from].push(index);
        self.incident[to].push(index);
        if let Some(blocks) = self.blocks.get_mut() {
            match edge.status {
                EdgeStatus::Active => blocks.add_edge(index, edge.id, (from, to)),
                EdgeStatus::Retired | EdgeStatus::Quarantined => blocks.cover_edge(index),
            }
        }
        Ok(())
    }

    /// All nodes, in the order in which they were added.
    pub fn nodes(&self) -> &[Node] {
        &self.nodes
    }

    /// All edges, in the order in which they were added.
    pub fn edges(&self) -> &[Edge] {
        &self.edges
    }

    /// A node.
    pub fn node(&self, id: NodeId) -> Option<&Node> {
        self.node_index.get(&id).map(|&k| &self.nodes[k])
    }

    /// A node's index in [`PoseGraph::nodes`].
    pub fn node_position(&self, id: NodeId) -> Option<usize> {
        self.node_index.get(&id).copied()
    }

    /// An edge.
    pub fn edge(&self, id: EdgeId) -> Option<&Edge> {
        self.edge_index.get(&id).map(|&k| &self.edges[k])
    }

    /// An edge's index in [`PoseGraph::edges`].
    pub fn edge_position(&self, id: EdgeId) -> Option<usize> {
        self.edge_index.get(&id).copied()
    }

    /// For each edge of [`PoseGraph::edges`], the indices of its ends `(from, to)` in
    /// [`PoseGraph::nodes`].
    pub fn ends(&self) -> &[(usize, usize)] {
        &self.ends
    }

    /// The indices in [`PoseGraph::edges`] of the edges at a node, given by its index in [`PoseGraph::nodes`],
    /// in the order in which they were added; empty past the end.
    pub fn incident(&self, node_position: usize) -> &[usize] {
        self.incident.get(node_position).map_or(&[], Vec::as_slice)
    }

    /// The edges at a node, in the order in which they were added.
    pub fn edges_at(&self, id: NodeId) -> impl Iterator<Item = &Edge> {
        let indices = self
            .node_index
            .get(&id)
            .map(|&k| self.incident[k].as_slice());
        indices.unwrap_or_default().iter().map(|&k| &self.edges[k])
    }

    /// The biconnected blocks of the active edges. Costs one pass over the graph on first use and after an edge
    /// has left, else almost nothing: see [`Blocks`].
    pub fn blocks(&self) -> &Blocks {
        self.blocks.get_or_init(|| self.find_blocks())
    }

    /// The blocks, computed by one pass over the graph.
    pub fn find_blocks(&self) -> Blocks {
        Blocks::of(&self.edges, &self.ends, &self.incident)
    }

    /// The smallest id among the sub-graphs of a node; `None` if it is in no loop.
    pub fn subgraph_of_node(&self, node: NodeId) -> Option<EdgeId> {
        let at = self.blocks().at_node(self.node_position(node)?);
        at.filter_map(Block::subgraph_id).min()
    }

    /// Moves a node; does nothing if there is no such node.
    pub fn set_pose(&mut self, id: NodeId, pose: Pose2) {
        if let Some(&k) = self.node_index.get(&id) {
            self.set_pose_at(k, pose);
        }
    }

    /// Moves the node at an index in [`PoseGraph::nodes`]; does nothing past the end.
    pub fn set_pose_at(&mut self, node_position: usize, pose: Pose2) {
        if let Some(node) = self.nodes.get_mut(node_position) {
            node.pose = pose;
        }
    }

    /// Sets whether an edge is optimised; does nothing if there is no such edge.
    pub fn set_edge_status(&mut self, id: EdgeId, status: EdgeStatus) {
        let Some(&k) = self.edge_index.get(&id) else {
            return;
        };
        let before = std::mem::replace(&mut self.edges[k].status, status);
        match (before, status) {
            (EdgeStatus::Active, EdgeStatus::Active) => {}
            (EdgeStatus::Active, _) => self.blocks = OnceLock::new(),
            (_, EdgeStatus::Active) => {
                if let Some(blocks) = self.blocks.get_mut() {
                    blocks.add_edge(k, id, self.ends[k]);
                }
            }
            _ => {}
        }
    }

    /// The nodes to move, and the blocks with their children.
    pub(super) fn nodes_with_blocks(&mut self) -> (&mut [Node], Option<&Blocks>) {
        (&mut self.nodes, self.blocks.get())
    }

    /// The error of an edge at the current poses, whatever its status.
    pub fn error_of(&self, edge: &Edge) -> Option<nalgebra::Vector3<f64>> {
        let (from, to) = (self.node(edge.from)?, self.node(edge.to)?);
        Some(Pose2::edge_error(&from.pose, &to.pose, &edge.measurement))
    }

    /// F = Σ eᵀΩe over the active edges at the current poses (paper, equation 2; no factor ½).
    pub fn cost(&self) -> f64 {
        let with_ends = self.edges.iter().zip(&self.ends);
        with_ends
            .filter(|(edge, _)| edge.status == EdgeStatus::Active)
            .map(|(edge, &(from, to))| {
                let (from, to) = (&self.nodes[from].pose, &self.nodes[to].pose);
                let error = Pose2::edge_error(from, to, &edge.measurement);
                edge.information.squared_norm(&error)
            })
            .sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Information;
    use crate::graph::EdgeKind;

    fn edge(id: i64, from: i64, to: i64) -> Edge {
        Edge {
            id: EdgeId(id),
            from: NodeId(from),
            to: NodeId(to),
            measurement: Pose2::new(1.0, 0.0, 0.0),
            information: Information::identity(),
            kind: EdgeKind::Odometry,
            status: EdgeStatus::Active,
        }
    }

    #[test]
    fn what_does_not_fit_is_refused_and_changes_nothing() {
        let mut graph = PoseGraph::new();
        for id in [3, 1] {
            let pose = Pose2::new(id as f64, 0.0, 0.0);
            graph
                .add_node(Node {
                    id: NodeId(id),
                    pose,
                })
                .unwrap();
        }
        let again = Node {
            id: NodeId(3),
            pose: Pose2::IDENTITY,
        };
        assert_eq!(
            graph.add_node(again),
            Err(GraphError::DuplicateNode(NodeId(3)))
        );
        graph.add_edge(edge(7, 1, 3)).unwrap();
        assert_eq!(
            graph.add_edge(edge(7, 3, 1)),
            Err(GraphError::DuplicateEdge(EdgeId(7)))
        );
        assert_eq!(
            graph.add_edge(edge(8, 1, 1)),
            Err(GraphError::SelfLoop(EdgeId(8)))
        );
        let unknown = GraphError::UnknownNode {
            edge: EdgeId(8),
            node: NodeId(9),
        };
        assert_eq!(graph.add_edge(edge(8, 1, 9)), Err(unknown));
        assert_eq!(graph.edges().len(), 1);
        assert_eq!(graph.edges_at(NodeId(3)).count(), 1);
        assert!((graph.cost() - 1.0).abs() < 1e-12);
        graph.set_edge_status(EdgeId(7), EdgeStatus::Retired);
        assert_eq!(graph.cost(), 0.0);
    }
}
