//! The walk of given nodes and edges into the map.

use super::given::{End, GivenEdge, GivenGraph};
use super::keyframe::Keyframe;
use super::partners::Covering;
use super::route_map::RouteMap;
use crate::geometry::Information;
use crate::graph::{Edge, EdgeKind, EdgeStatus, GraphError};
use crate::ids::{EdgeId, NodeId};
use crate::solver::SolveOptions;

/// No wheel and no lidar knows a motion better than to a millimetre, m⁻² …
const INFORMATION_XY_MAX: f64 = 1e6;
/// … and a tenth of a milliradian, rad⁻².
const INFORMATION_THETA_MAX: f64 = 1e8;

/// Nodes times solves that a batch's closures may cost: one of the size of the usual benchmark graphs
/// is solved closure by closure.
const NODES_SOLVED_MAX: usize = 10_000_000;

/// What became of given nodes and edges, in the order in which they were given.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Attached {
    /// The new nodes.
    pub nodes: Vec<NodeId>,
    /// The new edges, with what each loop closure added to the optimum F when it was inserted
    /// (paper: ΔF); `None` for odometry.
    pub edges: Vec<(EdgeId, Option<f64>)>,
}

/// Why given nodes and edges were not added; the map is lost then.
#[derive(Debug, thiserror::Error)]
pub enum NotAttached {
    /// An edge to a node that is not in the map, or from a node to itself.
    #[error(transparent)]
    Graph(#[from] GraphError),
    /// Nobody waits for it any more.
    #[error("it was interrupted")]
    Interrupted,
}

impl RouteMap {
    /// Adds nodes and edges that were measured elsewhere; the solver remembers nothing of what was
    /// before.
    ///
    /// New nodes begin where the edges from the map lead. First come odometry, and of the closures
    /// those that nodes hang on, which add nothing to F; then the other closures one after the
    /// other, the sub-graph solved after each; of a batch with very many, several together, which
    /// share what they add to F by their errors. Nodes become references where no other node without
    /// a scan covers their place.
    ///
    /// # Errors
    /// [`NotAttached`]. Nodes that nothing ties to the map ([`RouteMap::untied`]) are put where
    /// they take themselves to be.
    pub fn attach(&mut self, given: &GivenGraph) -> Result<Attached, NotAttached> {
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
        self.close_given(given, &closures, &nodes, &mut edges)?;
        self.refer_to_given(first);
        self.forget_solves();
        let edges = edges.into_iter().flatten().collect();
        Ok(Attached { nodes, edges })
    }

    /// Inserts closures, of which `edges` then says what each added to F.
    fn close_given(
        &mut self,
        given: &GivenGraph,
        closures: &[usize],
        nodes: &[NodeId],
        edges: &mut [Option<(EdgeId, Option<f64>)>],
    ) -> Result<(), NotAttached> {
        for together in closures.chunks(self.solved_together(closures.len())) {
            if self.interrupt.is_raised() {
                return Err(NotAttached::Interrupted);
            }
            let inserted = together
                .iter()
                .map(|&k| self.insert_given(&given.edges[k], nodes));
            let inserted: Vec<EdgeId> = inserted.collect::<Result<_, _>>()?;
            let delta_f = self.solve_given(&inserted);
            for ((&k, &edge), share) in together.iter().zip(&inserted).zip(self.shares(&inserted)) {
                edges[k] = Some((edge, Some(share * delta_f)));
            }
        }
        Ok(())
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
            information: self.weighting.information(believed(&given.information)),
            kind: given.kind,
            status: EdgeStatus::Active,
        };
        self.graph.add_edge(edge)?;
        Ok(edge.id)
    }

    /// How many of a batch's closures are inserted before each solve: one, so that each has its ΔF,
    /// as long as that keeps within what a batch may cost.
    fn solved_together(&self, closures: usize) -> usize {
        let solves_max = (NODES_SOLVED_MAX / self.keyframes.len().max(1)).max(1);
        closures.div_ceil(solves_max).max(1)
    }

    /// The parts that edges have in the squared error of all of them.
    fn shares(&self, edges: &[EdgeId]) -> Vec<f64> {
        let squared = edges.iter().map(|id| {
            let edge = self.graph.edge(*id);
            let error = edge.and_then(|edge| Some((edge, self.graph.error_of(edge)?)));
            error.map_or(0.0, |(edge, error)| edge.information.squared_norm(&error))
        });
        let squared: Vec<f64> = squared.collect();
        let total: f64 = squared.iter().sum();
        match total > 0.0 {
            true => squared.iter().map(|part| part / total).collect(),
            false => vec![1.0 / edges.len().max(1) as f64; edges.len()],
        }
    }

    /// Solves the sub-graphs that new edges belong to; returns what they add to F.
    fn solve_given(&mut self, edges: &[EdgeId]) -> f64 {
        let options = SolveOptions::default();
        let solved = self.solver.solve_touched(&mut self.graph, edges, &options);
        solved.delta_f
    }

    /// Decides which of the nodes from a place on are references.
    fn refer_to_given(&mut self, first: usize) {
        let mut given = Covering::default();
        for (k, keyframe) in self.keyframes.iter_mut().enumerate() {
            let pose = self.graph.nodes()[k].pose;
            if k >= first {
                keyframe.reference = !given.covers(&pose);
            }
            if keyframe.reference && keyframe.scan.is_none() {
                given.insert(pose);
            }
        }
    }
}

/// As much of what a sender says of its own measurement as anybody can know.
fn believed(information: &Information) -> Information {
    information.bounded(INFORMATION_XY_MAX, INFORMATION_THETA_MAX)
}

#[cfg(test)]
mod tests;
