//! The walk of given nodes and edges into the map.

use super::given::{End, GivenEdge, GivenGraph};
use super::keyframe::Keyframe;
use super::partners::Covering;
use super::route_map::RouteMap;
use crate::geometry::Information;
use crate::graph::{Edge, EdgeKind, EdgeStatus, GraphError};
use crate::ids::{EdgeId, NodeId};
use crate::solver::{SolveOptions, operations_to_solve};

/// No wheel and no lidar knows a motion better than to a millimetre, m⁻² …
const INFORMATION_XY_MAX: f64 = 1e6;
/// … and a tenth of a milliradian, rad⁻².
const INFORMATION_THETA_MAX: f64 = 1e8;

/// Multiplications of one factorisation, at most: a hundred times what the usual benchmark graph of ten
/// thousand nodes takes. Closures between nodes at random fill the equations more than any route does.
const OPERATIONS_MAX: f64 = 5e9;
/// Multiplications that solving a batch's closures may take …
const OPERATIONS_OF_BATCH_MAX: f64 = 5e10;
/// … with what every solve takes for each node of the map: one of the size of the usual benchmark
/// graphs is solved closure by closure.
const OPERATIONS_OF_NODE: f64 = 5e3;

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
    /// The graph could not be solved in a reasonable time.
    #[error(
        "its loop closures tie nodes to so many others, all over the map, that solving the graph \
         would take too long: send fewer of them, between nodes that are near each other"
    )]
    TooDense,
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
        let operations = self.operations_with(given, &nodes);
        if operations > OPERATIONS_MAX {
            return Err(NotAttached::TooDense);
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
        let together = self.solved_together(closures.len(), operations);
        for closures in closures.chunks(together) {
            self.close_given(given, closures, &nodes, &mut edges)?;
        }
        self.refer_to_given(first);
        self.forget_solves();
        let edges = edges.into_iter().flatten().collect();
        Ok(Attached { nodes, edges })
    }

    /// Inserts closures and solves; `edges` then says what each added to F.
    fn close_given(
        &mut self,
        given: &GivenGraph,
        closures: &[usize],
        nodes: &[NodeId],
        edges: &mut [Option<(EdgeId, Option<f64>)>],
    ) -> Result<(), NotAttached> {
        let inserted = closures
            .iter()
            .map(|&k| self.insert_given(&given.edges[k], nodes));
        let inserted: Vec<EdgeId> = inserted.collect::<Result<_, _>>()?;
        let delta_f = self.solve_given(&inserted);
        if self.interrupt.is_raised() {
            return Err(NotAttached::Interrupted);
        }
        for ((&k, &edge), share) in closures.iter().zip(&inserted).zip(self.shares(&inserted)) {
            edges[k] = Some((edge, Some(share * delta_f)));
        }
        Ok(())
    }

    fn insert_given(&mut self, given: &GivenEdge, nodes: &[NodeId]) -> Result<EdgeId, GraphError> {
        let edge = Edge {
            id: self.take_edge_id(),
            from: given.from.among(nodes),
            to: given.to.among(nodes),
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
    fn solved_together(&self, closures: usize, operations: f64) -> usize {
        let of_solve = operations + OPERATIONS_OF_NODE * self.keyframes.len() as f64;
        let solves_max = (OPERATIONS_OF_BATCH_MAX / of_solve).max(1.0) as usize;
        closures.div_ceil(solves_max).max(1)
    }

    /// What factoring the whole map takes once given edges are in it.
    fn operations_with(&self, given: &GivenGraph, nodes: &[NodeId]) -> f64 {
        let place = |end: End| self.graph.node_position(end.among(nodes));
        let given = given
            .edges
            .iter()
            .filter_map(|edge| Some((place(edge.from)?, place(edge.to)?)));
        let known = self.graph.ends().iter().zip(self.graph.edges());
        let known = known.filter(|(_, edge)| edge.status == EdgeStatus::Active);
        let pairs = known.map(|(ends, _)| *ends).chain(given);
        let pairs: Vec<(u32, u32)> = pairs.map(|(a, b)| (a as u32, b as u32)).collect();
        operations_to_solve(self.keyframes.len(), &pairs).unwrap_or(f64::INFINITY)
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
