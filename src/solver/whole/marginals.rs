//! The covariance of relative poses, and the predicted increase of F by a closure that is not inserted.

use nalgebra::{Matrix3, Vector3};

use crate::geometry::Pose2;
use crate::graph::{Edge, PoseGraph};
use crate::ids::NodeId;
use crate::solver::factor::{Frame, fill_batches, square_root};
use crate::solver::least_squares::{DAMPING_MIN, NormalEquations, POSE_SIZE, Problem};

/// One factorisation of a graph's H = Σ JᵀΩJ at its poses, for queries about many pairs of nodes.
pub struct Marginals<'a> {
    graph: &'a PoseGraph,
    component: Vec<usize>,
    equations: NormalEquations,
}

/// The innovation of a measured motion between two nodes, relative to a graph without it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Innovation {
    /// The edge's error r at the graph's poses.
    pub error: Vector3<f64>,
    /// J H⁻¹ Jᵀ: how uncertain the graph is about the error.
    pub covariance: Matrix3<f64>,
    /// rᵀ(Ω⁻¹ + J H⁻¹ Jᵀ)⁻¹ r, the normalised innovation squared: the increase of F when the edge
    /// is inserted into a graph that is at its optimum (exact where errors are linear).
    /// Under no change it is χ² distributed with `degrees_of_freedom`.
    pub nis: f64,
    /// The rank of Ω: a degenerate direction is not measured and must not be tested.
    pub degrees_of_freedom: usize,
}

impl<'a> Marginals<'a> {
    /// Factors a graph at its poses, active edges only; `None` if that cannot be done.
    pub fn of(graph: &'a PoseGraph) -> Option<Self> {
        let problem = Problem::of_graph(graph);
        let mut equations = NormalEquations::new(&problem, false)?;
        let frames: Vec<Frame> = problem.poses.iter().map(|&pose| Frame::of(pose)).collect();
        let mut batches = Vec::new();
        fill_batches(&problem.factors, &mut batches);
        equations.linearise(&batches, &frames);
        equations.factorise(DAMPING_MIN).then(|| Self {
            graph,
            component: problem.components(),
            equations,
        })
    }

    /// The covariance of the relative pose `i_from_j`, in the tangent of the edge error: of
    /// Pose2::edge_error for a measurement that is the graph's own relative pose. `None` if the
    /// nodes are not joined by active edges, or not there. Costs one solve with three columns.
    pub fn relative_covariance(&mut self, i: NodeId, j: NodeId) -> Option<Matrix3<f64>> {
        let (from, to) = (self.graph.node(i)?, self.graph.node(j)?);
        self.error_covariance(i, j, &from.pose.between(&to.pose))
    }

    /// The innovation of an edge that is not among the graph's active edges. `None` if its ends
    /// are not joined by active edges, or not there: then it is a bridge, and F will not increase.
    pub fn innovation(&mut self, edge: &Edge) -> Option<Innovation> {
        let covariance = self.error_covariance(edge.from, edge.to, &edge.measurement)?;
        let error = self.graph.error_of(edge)?;
        // (Ω⁻¹ + P)⁻¹ = S(I + SPS)⁻¹S with S = √Ω, which holds for a singular Ω too.
        let (root, degrees_of_freedom) = square_root(&edge.information);
        let middle = Matrix3::identity() + root * covariance * root;
        let whitened = root * error;
        let nis = whitened.dot(&middle.cholesky()?.solve(&whitened));
        nis.is_finite().then_some(Innovation {
            error,
            covariance,
            nis,
            degrees_of_freedom,
        })
    }

    fn error_covariance(
        &mut self,
        i: NodeId,
        j: NodeId,
        measurement: &Pose2,
    ) -> Option<Matrix3<f64>> {
        let (from, to) = (self.graph.node_position(i)?, self.graph.node_position(j)?);
        if self.component[from] != self.component[to] {
            return None;
        }
        let nodes = self.graph.nodes();
        let frame = |node: usize| Frame::of(nodes[node].pose);
        let at = Frame::local_error(&frame(from), &frame(to), &Frame::of(*measurement));
        let ends = [(from, at.jacobian_from), (to, at.jacobian_to)];
        let free = ends.map(|(node, jacobian)| Some((self.equations.offset(node)?, jacobian)));
        let dimension = self.equations.dimension();
        let mut columns = vec![0.0; dimension * POSE_SIZE];
        for (offset, jacobian) in free.iter().flatten() {
            for column in 0..POSE_SIZE {
                for row in 0..POSE_SIZE {
                    // += : both ends may be one node.
                    columns[column * dimension + offset + row] += jacobian[(column, row)];
                }
            }
        }
        self.equations.solve(&mut columns);
        let mut covariance = Matrix3::zeros();
        for (offset, jacobian) in free.iter().flatten() {
            covariance += jacobian
                * Matrix3::from_fn(|row, column| columns[column * dimension + offset + row]);
        }
        Some((covariance + covariance.transpose()) * 0.5)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Information;
    use crate::graph::{EdgeStatus, Node};
    use crate::ids::EdgeId;
    use crate::solver::testing::{add_closure, random_graph};
    use crate::solver::{SolveOptions, Solver, solve};

    /// Retires a fresh closure, asks for its innovation, and lets it in.
    fn predicted_and_true(seed: u64, scale: f64, information: Information) -> Option<(f64, f64)> {
        let mut graph = random_graph(seed, 40, 8);
        solve(&mut graph, &SolveOptions::default());
        let id = add_closure(&mut graph, seed + 1000);
        let mut edge = *graph.edge(id)?;
        let truth = graph
            .node(edge.from)?
            .pose
            .between(&graph.node(edge.to)?.pose);
        // A small residual: the prediction is exact in its limit.
        let off = truth.between(&edge.measurement).log() * scale;
        edge.measurement = truth.compose(&Pose2::exp(&off));
        edge.id = EdgeId(id.0 + 1);
        edge.information = information;
        graph.set_edge_status(id, EdgeStatus::Retired);
        let innovation = Marginals::of(&graph)?.innovation(&edge)?;
        graph.add_edge(edge).ok()?;
        let options = SolveOptions {
            cost_tolerance: 1e-14,
            ..SolveOptions::default()
        };
        let touched = Solver::new().solve_touched(&mut graph, &[edge.id], &options);
        Some((innovation.nis, touched.delta_f))
    }

    #[test]
    fn the_innovation_predicts_the_increase_of_f() {
        let informations = [
            Information::from_sigmas(0.02, 0.01),
            Information::from_upper([400.0, 30.0, -20.0, 900.0, 10.0, 5000.0]),
            // A corridor: nothing is known along x.
            Information::from_upper([0.0, 0.0, 0.0, 900.0, 0.0, 5000.0]),
        ];
        let mut seen = 0;
        for seed in 0..30 {
            for information in informations {
                if let Some((nis, delta_f)) = predicted_and_true(seed, 0.2, information) {
                    seen += 1;
                    assert!(
                        (nis - delta_f).abs() <= 0.02 * delta_f + 1e-9,
                        "{nis} {delta_f}"
                    );
                }
            }
        }
        assert!(seen > 40);
    }

    #[test]
    fn a_chain_of_measurements_adds_up() {
        let mut graph = PoseGraph::new();
        let mut pose = Pose2::new(1.0, 2.0, 0.5);
        let motion = Pose2::new(1.0, 0.0, 0.0);
        for k in 0..4 {
            graph
                .add_node(Node {
                    id: NodeId(k),
                    pose,
                })
                .unwrap();
            pose = pose.compose(&motion);
        }
        let sigmas = Information::from_sigmas(0.1, 0.02);
        for k in 0..3 {
            let mut edge = crate::graph::Edge {
                id: EdgeId(k),
                from: NodeId(k),
                to: NodeId(k + 1),
                measurement: motion,
                information: sigmas,
                kind: crate::graph::EdgeKind::Odometry,
                status: EdgeStatus::Active,
            };
            edge.id = EdgeId(k);
            graph.add_edge(edge).unwrap();
        }
        graph
            .add_node(Node {
                id: NodeId(9),
                pose,
            })
            .unwrap();
        let mut marginals = Marginals::of(&graph).unwrap();
        let p = marginals.relative_covariance(NodeId(0), NodeId(3)).unwrap();
        assert!((p[(0, 0)] - 0.03).abs() < 1e-9);
        // Three turns act on y with levers of 2, 1 and 0 metres.
        assert!((p[(1, 1)] - (0.03 + 5.0 * 0.0004)).abs() < 1e-9);
        assert!((p[(2, 2)] - 3.0 * 0.0004).abs() < 1e-9);
        let q = marginals.relative_covariance(NodeId(2), NodeId(3)).unwrap();
        assert!((q - Matrix3::from_diagonal(&Vector3::new(0.01, 0.01, 0.0004))).norm() < 1e-9);
        assert_eq!(marginals.relative_covariance(NodeId(0), NodeId(9)), None);
        let same = marginals.relative_covariance(NodeId(2), NodeId(2)).unwrap();
        assert!(same.norm() < 1e-9);
    }
}
