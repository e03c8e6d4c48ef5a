//! Maps that are wrong on purpose, to see what comes of it.

use std::collections::BTreeSet;

use super::route_map::{RouteMap, Weighting};
use crate::geometry::{Pose2, Vector2};
use crate::graph::{Edge, EdgeKind, GraphError};
use crate::ids::NodeId;

impl RouteMap {
    /// The map with some nodes moved by a vector (map frame, metres), and with all edges between
    /// them and others in agreement with that; without the closures among those edges unless
    /// `keeps_closures`. What was observed moves along and counts as known.
    ///
    /// # Errors
    /// [`GraphError`] if the map does not fit together; it does.
    pub fn falsified(
        &self,
        moved: &BTreeSet<NodeId>,
        by: &Vector2<f64>,
        keeps_closures: bool,
    ) -> Result<Self, GraphError> {
        let pose_of = |node: NodeId| -> Option<Pose2> {
            let pose = self.graph.node(node)?.pose;
            match moved.contains(&node) {
                true => Some(pose.shifted(by)),
                false => Some(pose),
            }
        };
        let nodes = self.keyframes.iter().filter_map(|keyframe| {
            let pose = pose_of(keyframe.node)?;
            Some((pose, keyframe.clone()))
        });
        let nodes: Vec<_> = nodes.collect();
        let edges = self.graph.edges().iter().filter_map(|edge| {
            let crosses = moved.contains(&edge.from) != moved.contains(&edge.to);
            match (crosses, edge.kind) {
                (false, _) => Some(*edge),
                (true, EdgeKind::LoopClosure) if !keeps_closures => None,
                (true, _) => Some(Edge {
                    measurement: pose_of(edge.from)?.between(&pose_of(edge.to)?),
                    ..*edge
                }),
            }
        });
        let edges: Vec<Edge> = edges.collect();
        let (next_node, next_edge) = (self.next_node_id(), self.next_edge_id());
        Self::restore(Weighting::Robust, nodes, edges, next_node, next_edge)
    }
}
