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

/// Multiplications of one factorisation of the map, at most: four times what the usual benchmark graph of ten
/// thousand nodes takes. Closures between nodes at random fill the equations more than any route does.
const FACTORISATION_MAX: f64 = 2e8;
/// Multiplications of all solves of a batch, as they are predicted …
const SOLVES_MAX: f64 = 5e10;
/// … with what every solve takes for each node of the map: one of the size of the usual benchmark
/// graphs is solved closure by closure.
const OPERATIONS_OF_NODE: f64 = 5e3;
/// Multiplications of all solves of a batch, as they are counted while it is solved: closures that
/// contradict each other take many more steps than was predicted.
const BATCH_MAX: f64 = 5e10;

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
    /// One factorisation of the graph would take so many multiplications, and was not tried.
    #[error(
        "its loop closures join nodes so densely that solving the map once would take {operations:.1e} \
         multiplications, and {FACTORISATION_MAX:.1e} are allowed: send fewer closures, or thin them so that \
         each node has a few, to nodes near it"
    )]
    TooDense {
        /// Predicted by the structure of the graph.
        operations: f64,
    },
    /// The batch's solves were broken off after as many multiplications as a batch may take.
    #[error(
        "its loop closures contradict each other, or join nodes so densely, that solving the map with them takes \
         more than the {BATCH_MAX:.1e} multiplications that a batch may take: send fewer closures at once, or thin them"
    )]
    TooCostly,
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
        self.attach_within(given, BATCH_MAX)
    }

    /// The same with so many multiplications for all solves.
    fn attach_within(
        &mut self,
        given: &GivenGraph,
        operations_max: f64,
    ) -> Result<Attached, NotAttached> {
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
        if operations > FACTORISATION_MAX {
            return Err(NotAttached::TooDense { operations });
        }
        self.solver.allow(operations_max);
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
        self.solve_given(&closing)?;
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
        let delta_f = self.solve_given(&inserted)?;
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
        let solves_max = (SOLVES_MAX / of_solve).max(1.0) as usize;
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
    fn solve_given(&mut self, edges: &[EdgeId]) -> Result<f64, NotAttached> {
        let options = SolveOptions::default();
        let solved = self.solver.solve_touched(&mut self.graph, edges, &options);
        if self.interrupt.is_raised() {
            Err(NotAttached::Interrupted)
        } else if self.solver.is_exhausted() {
            Err(NotAttached::TooCostly)
        } else {
            Ok(solved.delta_f)
        }
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
