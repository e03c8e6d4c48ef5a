//! Taking out of a map what should never have been in it.

use std::collections::BTreeSet;

use super::keyframe::Keyframe;
use super::partners::Covering;
use super::route_map::RouteMap;
use crate::change::{Layer, Layers};
use crate::graph::{Edge, EdgeStatus, GraphError};
use crate::ids::{EdgeId, NodeId};

impl RouteMap {
    /// Takes nodes out of the map, with every edge that ends at one of them, and some other edges.
    /// Where a reference goes another node becomes one; what the nodes observed is forgotten. A part of
    /// the map that nothing ties to the rest any more stays where it is.
    ///
    /// # Errors
    /// [`GraphError`] if what is left does not fit together; the map is lost then.
    pub fn take_out(&mut self, nodes: &[NodeId], edges: &[EdgeId]) -> Result<(), GraphError> {
        self.drop_from_graph(nodes, edges)?;
        self.refer_where_none_is();
        self.layers = Layers::default();
        self.settle_screen();
        Ok(())
    }

    /// Takes nodes, every edge that ends at one of them, and some other edges out of the graph, and
    /// solves the sub-graphs that those edges were part of.
    pub(super) fn drop_from_graph(
        &mut self,
        nodes: &[NodeId],
        edges: &[EdgeId],
    ) -> Result<(), GraphError> {
        let leaving: BTreeSet<NodeId> = nodes.iter().copied().collect();
        let named: BTreeSet<EdgeId> = edges.iter().copied().collect();
        let leaves = |edge: &Edge| {
            leaving.contains(&edge.from) || leaving.contains(&edge.to) || named.contains(&edge.id)
        };
        let going = self.graph.edges().iter().filter(|edge| leaves(edge));
        let going: Vec<(EdgeId, EdgeStatus)> = going.map(|edge| (edge.id, edge.status)).collect();
        let around = self.edges_around(&going);

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
        Ok(())
    }

    /// Makes references of the nodes, the oldest first, that no reference of their layer covers.
    fn refer_where_none_is(&mut self) {
        let kind = |keyframe: &Keyframe| (keyframe.scan.is_some(), keyframe.layer());
        let mut references: Vec<((bool, Layer), Covering)> = Vec::new();
        for only_known in [true, false] {
            for (keyframe, node) in self.keyframes.iter_mut().zip(self.graph.nodes()) {
                if keyframe.reference != only_known || keyframe.is_lost() {
                    continue;
                }
                let kind = kind(keyframe);
                let place = references.iter().position(|(other, _)| *other == kind);
                let place = place.unwrap_or_else(|| {
                    references.push((kind, Covering::default()));
                    references.len() - 1
                });
                let like = &mut references[place].1;
                if only_known || !like.covers(&node.pose) {
                    keyframe.reference = true;
                    like.insert(node.pose);
                }
            }
        }
    }
}
