//! The walk of given nodes and edges into the map.

use super::given::{End, GivenEdge, GivenGraph};
use super::keyframe::Keyframe;
use super::partners;
use super::route_map::RouteMap;
use crate::graph::{Edge, EdgeKind, EdgeStatus, GraphError};
use crate::ids::{EdgeId, NodeId};
use crate::solver::SolveOptions;

/// What became of given nodes and edges, in the order in which they were given.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Attached {
    /// The new nodes.
    pub nodes: Vec<NodeId>,
    /// The new edges, with what each loop closure added to the optimum F when it was inserted
    /// (paper: ΔF); `None` for odometry.
    pub edges: Vec<(EdgeId, Option<f64>)>,
}

impl RouteMap {
    /// Adds nodes and edges that were measured elsewhere; the solver remembers nothing of what was
    /// before.
    ///
    /// New nodes begin where the edges from the map lead. First come odometry, and of the closures
    /// those that nodes hang on, which add nothing to F; then the other closures one after the
    /// other, the sub-graph solved after each. Nodes become references where no other node without
    /// a scan covers their place.
    ///
    /// # Errors
    /// [`GraphError`] for an edge to a node that is not in the map, or from a node to itself; the
    /// map is lost then. Nodes that nothing ties to the map ([`RouteMap::untied`]) are put where
    /// they take themselves to be.
    pub fn attach(&mut self, given: &GivenGraph) -> Result<Attached, GraphError> {
        let placing = self.place(given);
        let first = self.keyframes.len();
        let mut nodes = Vec::with_capacity(given.nodes.len());
        for (node, pose) in given.nodes.iter().zip(&placing.poses) {
            let id = self.take_node_id();
            let (trip, odom_from_base) = (node.trip.clone(), node.pose);
            let keyframe = Keyframe::without_scan(id, trip, node.stamp, odom_from_base);
            self.insert_keyframe(pose.unwrap_or(node.pose), keyframe)?;
            nodes.push(id);
        }
        let mut edges: Vec<Option<(EdgeId, Option<f64>)>> = vec![None; given.edges.len()];
        let is_first = |k: &usize| placing.places[*k] || given.edges[*k].kind == EdgeKind::Odometry;
        let (at_first, closures): (Vec<usize>, Vec<usize>) =
            (0..given.edges.len()).partition(is_first);
        let mut closing = Vec::new();
        for k in at_first {
            let edge = self.insert_given(&given.edges[k], &nodes)?;
            if !placing.places[k] {
                closing.push(edge);
            }
            let is_closure = given.edges[k].kind == EdgeKind::LoopClosure;
            edges[k] = Some((edge, is_closure.then_some(0.0)));
        }
        self.solve_given(&closing);
        for k in closures {
            let edge = self.insert_given(&given.edges[k], &nodes)?;
            edges[k] = Some((edge, Some(self.solve_given(&[edge]))));
        }
        self.refer_to_given(first);
        self.forget_solves();
        let edges = edges.into_iter().flatten().collect();
        Ok(Attached { nodes, edges })
    }

    fn insert_given(&mut self, given: &GivenEdge, nodes: &[NodeId]) -> Result<EdgeId, GraphError> {
        let id_of = |end: End| match end {
            End::New(place) => nodes[place],
            End::Known(id) => id,
        };
        let edge = Edge {
            id: self.take_edge_id(),
            from: id_of(given.from),
            to: id_of(given.to),
            measurement: given.measurement,
            information: self.weighting.information(given.information),
            kind: given.kind,
            status: EdgeStatus::Active,
        };
        self.graph.add_edge(edge)?;
        Ok(edge.id)
    }

    /// Solves the sub-graphs that new edges belong to; returns what they add to F.
    fn solve_given(&mut self, edges: &[EdgeId]) -> f64 {
        let options = SolveOptions::default();
        let solved = self.solver.solve_touched(&mut self.graph, edges, &options);
        solved.delta_f
    }

    /// Decides which of the nodes from a place on are references.
    fn refer_to_given(&mut self, first: usize) {
        for k in first..self.keyframes.len() {
            let pose = self.graph.nodes()[k].pose;
            let others = self.keyframes[..k].iter().zip(self.graph.nodes());
            let given = others.filter(|(other, _)| other.reference && other.scan.is_none());
            let covered = partners::is_covered(&pose, given.map(|(_, node)| node.pose));
            self.keyframes[k].reference = !covered;
        }
    }
}

#[cfg(test)]
mod tests;
