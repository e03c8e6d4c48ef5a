//! Taking an accepted change into a map, and out of it again.

use std::collections::BTreeSet;

use super::partners;
use super::route_map::RouteMap;
use crate::change::Layer;
use crate::geometry::Pose2;
use crate::graph::EdgeStatus;
use crate::ids::{EdgeId, NodeId};
use crate::solver::{SolveOptions, Solver};

impl RouteMap {
    /// Changes whether edges are optimised, and solves the sub-graphs that they belong to, before
    /// or after. Edges that are not there are passed over.
    ///
    /// A part of the map that nothing ties to the rest any more stays where it is.
    pub fn restate_edges(&mut self, changes: &[(EdgeId, EdgeStatus)]) {
        let mut touched = self.edges_around(changes);
        for (edge, status) in changes {
            self.graph.set_edge_status(*edge, *status);
        }
        touched.extend(self.edges_around(changes));
        self.solve_anew(touched);
    }

    /// Solves the sub-graphs of some edges with a solver that remembers nothing: what an earlier
    /// solve left behind goes by places in the graph, and shows in the last bits.
    pub(super) fn solve_anew(&mut self, edges: BTreeSet<EdgeId>) {
        let edges: Vec<EdgeId> = edges.into_iter().collect();
        let options = SolveOptions::default();
        Solver::new().solve_touched(&mut self.graph, &edges, &options);
    }

    /// Changes whether an edge is optimised; nothing moves.
    pub fn set_edge_status(&mut self, edge: EdgeId, status: EdgeStatus) {
        self.graph.set_edge_status(edge, status);
    }

    /// Every edge of the sub-graphs that some edges belong to.
    pub(super) fn edges_around(&self, changes: &[(EdgeId, EdgeStatus)]) -> BTreeSet<EdgeId> {
        let blocks = self.graph.blocks();
        let positions = changes
            .iter()
            .filter_map(|(edge, _)| self.graph.edge_position(*edge));
        let indices: BTreeSet<_> = positions.filter_map(|p| blocks.of_edge(p)).collect();
        let members = indices
            .into_iter()
            .filter_map(|index| blocks.get(index))
            .flat_map(|block| block.edges.iter());
        members.map(|&p| self.graph.edges()[p].id).collect()
    }

    /// Makes nodes references in the place of others: later laps are tied to these and no longer
    /// to those. Of new nodes of one height band that cover each other the first alone becomes one.
    /// Returns what the flags of the nodes that changed had been.
    pub fn hand_over_reference(&mut self, from: &[NodeId], to: &[NodeId]) -> Vec<(NodeId, bool)> {
        let mut before = Vec::new();
        for node in from {
            before.extend(self.set_reference(*node, false));
        }
        let mut covering: Vec<(Layer, Pose2)> = Vec::new();
        for node in to {
            let Some(position) = self.graph.node_position(*node) else {
                continue;
            };
            let (new, layer) = (self.placed(position), self.keyframes[position].layer());
            let of_layer = covering.iter().filter(|(other, _)| *other == layer);
            if !partners::is_covered(&new.pose, of_layer.map(|(_, pose)| *pose)) {
                covering.push((layer, new.pose));
                before.extend(self.set_reference(*node, true));
            }
        }
        before
    }

    /// Changes whether later laps are tied to a node; returns what it was before if that is
    /// something else.
    pub fn set_reference(&mut self, node: NodeId, reference: bool) -> Option<(NodeId, bool)> {
        let position = self.graph.node_position(node)?;
        let keyframe = &mut self.keyframes[position];
        let before = std::mem::replace(&mut keyframe.reference, reference);
        (before != reference).then_some((node, before))
    }

    /// Puts a node where it once was; nothing else moves. Nodes that are not there are passed
    /// over.
    pub fn set_pose(&mut self, node: NodeId, map_from_base: Pose2) {
        self.graph.set_pose(node, map_from_base);
    }
}

#[cfg(test)]
mod tests {
    use super::super::keyframe::Keyframe;
    use super::super::route_map::Weighting;
    use super::super::testing::blind_keyframe;
    use super::*;
    use crate::geometry::Information;
    use crate::graph::{Edge, EdgeKind};
    use crate::ids::{StampNs, TripId};
    use crate::solver::solve;

    fn keyframe(id: i64) -> Keyframe {
        blind_keyframe(id, TripId::new("t").unwrap(), StampNs(id))
    }

    /// Two chains of five nodes a metre apart, tied by closures of which the third is 0.3 m off.
    fn ladder() -> RouteMap {
        let nodes = (1..=10).map(|id| {
            let along = ((id - 1) % 5) as f64;
            (Pose2::new(along, 0.0, 0.0), keyframe(id))
        });
        let edge = |id, from, to, x, kind| Edge {
            id: EdgeId(id),
            from: NodeId(from),
            to: NodeId(to),
            measurement: Pose2::new(x, 0.0, 0.0),
            information: Information::identity(),
            kind,
            status: EdgeStatus::Active,
        };
        let odometry = [1, 2, 3, 4, 6, 7, 8, 9]
            .map(|from| edge(from, from, from + 1, 1.0, EdgeKind::Odometry));
        let closures = (1..=5).map(|k| {
            let off_m = if k == 3 { 0.3 } else { 0.0 };
            edge(10 + k, k, k + 5, off_m, EdgeKind::LoopClosure)
        });
        let edges = odometry.into_iter().chain(closures);
        let (next_node, next_edge) = (NodeId(11), EdgeId(16));
        let mut map =
            RouteMap::restore(Weighting::Robust, nodes, edges, next_node, next_edge).unwrap();
        let first = map.graph().edges()[0].id;
        map.restate_edges(&[(first, EdgeStatus::Active)]);
        map
    }

    #[test]
    fn a_retired_edge_bends_the_map_no_more() {
        let mut map = ladder();
        assert!(map.graph().cost() > 0.01);
        let bent: Vec<_> = map.graph().nodes().to_vec();
        map.restate_edges(&[
            (EdgeId(13), EdgeStatus::Retired),
            (EdgeId(99), EdgeStatus::Retired),
        ]);
        assert!(map.graph().cost() < 1e-12);
        map.restate_edges(&[(EdgeId(13), EdgeStatus::Active)]);
        for (now, then) in map.graph().nodes().iter().zip(&bent) {
            assert!((now.pose.x - then.pose.x).abs() < 1e-6);
        }
    }

    /// Where the sub-graph falls apart, what is left is at its optimum as a whole.
    #[test]
    fn a_sub_graph_that_falls_apart_is_solved_to_the_last_bridge() {
        let mut map = ladder();
        let all_but_one = [12, 13, 14, 15].map(|id| (EdgeId(id), EdgeStatus::Retired));
        map.restate_edges(&all_but_one);
        assert!(map.graph().cost() < 1e-20, "{}", map.graph().cost());
        let mut whole = map.graph().clone();
        solve(&mut whole, &SolveOptions::default());
        assert!((whole.cost() - map.graph().cost()).abs() < 1e-20);
        // The last tie gone, the chain that came later stays where it was.
        let before = map.graph().nodes().to_vec();
        map.restate_edges(&[(EdgeId(11), EdgeStatus::Retired)]);
        assert_eq!(map.graph().nodes(), before);
    }

    #[test]
    fn the_reference_is_handed_over_and_back() {
        let mut map = ladder();
        for id in 1..=5 {
            assert_eq!(
                map.set_reference(NodeId(id), true),
                Some((NodeId(id), false))
            );
        }
        let flags = |map: &RouteMap| -> Vec<i64> {
            let references = map.keyframes().iter().filter(|k| k.reference);
            references.map(|k| k.node.0).collect()
        };
        // Node 7 stands where node 2 stood; so does node 2's twin in the list, once.
        let (old, new) = (
            [NodeId(2), NodeId(9)],
            [NodeId(7), NodeId(2), NodeId(3), NodeId(77)],
        );
        let before = map.hand_over_reference(&old, &new);
        assert_eq!(flags(&map), [1, 3, 4, 5, 7]);
        assert_eq!(before, [(NodeId(2), true), (NodeId(7), false)]);
        for (node, reference) in before {
            map.set_reference(node, reference);
        }
        assert_eq!(flags(&map), [1, 2, 3, 4, 5]);
    }
}
