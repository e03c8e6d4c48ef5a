//! The marginal covariances of all poses of a graph at once.

use nalgebra::Matrix3;

use crate::graph::{EdgeKind, PoseGraph};
use crate::solver::factor::{Frame, fill_batches, square_root};
use crate::solver::least_squares::{DAMPING_MIN, NormalEquations, Problem};

/// The marginal covariances of a graph's poses, from H = Σ JᵀΩJ at its poses, active edges only.
///
/// They are as correct as the edges' information matrices, and ignore errors that edges have in common.
#[derive(Debug, Clone)]
pub struct PoseErrors {
    /// By a node's place in [`PoseGraph::nodes`]: the covariance of (x, y, θ) in the map frame
    /// (m², m·rad, rad²), with its component's first node held; zero for that node itself.
    pub covariances: Vec<Matrix3<f64>>,
    /// By a node's place: the place of its component's first node.
    pub first_of_component: Vec<usize>,
    /// Of every active loop closure, in the order of the graph's edges.
    pub closures: Vec<ClosureError>,
}

/// The agreement of a loop closure with the rest of its graph.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ClosureError {
    /// Its place in [`PoseGraph::edges`].
    pub edge: usize,
    /// eᵀΩe at the graph's poses.
    pub squared_error: f64,
    /// What `squared_error` is on average if Ω is right: how much of the closure the rest of the
    /// graph would know without it, from 0 (a bridge) to the rank of Ω.
    pub redundancy: f64,
    /// J H⁻¹ Jᵀ: the covariance of the relative pose of its ends, in the tangent of its error.
    pub covariance: Matrix3<f64>,
}

impl PoseErrors {
    /// Computes them at a graph's poses; `None` if its equations cannot be factored. Costs about three
    /// factorisations of the whole graph.
    pub fn of(graph: &PoseGraph) -> Option<Self> {
        let problem = Problem::of_graph(graph);
        let mut equations = NormalEquations::new(&problem, false)?;
        let frames: Vec<Frame> = problem.poses.iter().map(|&pose| Frame::of(pose)).collect();
        let mut batches = Vec::new();
        fill_batches(&problem.factors, &mut batches);
        equations.linearise(&batches, &frames);
        if !equations.factorise(DAMPING_MIN) {
            return None;
        }
        let inverse = equations.inverse();
        let covariances = frames.iter().enumerate().map(|(pose, frame)| {
            let own = inverse.of_pose(pose);
            let turn = Matrix3::new(
                frame.cos, -frame.sin, 0.0, //
                frame.sin, frame.cos, 0.0, //
                0.0, 0.0, 1.0,
            );
            turn * own * turn.transpose()
        });
        let of_factor = |(k, &edge): (usize, &usize)| {
            if graph.edges()[edge].kind != EdgeKind::LoopClosure {
                return None;
            }
            let factor = &problem.factors[k];
            let (from, to) = (&frames[factor.from], &frames[factor.to]);
            let at = Frame::local_error(from, to, &factor.measurement);
            let (j_from, j_to) = (at.jacobian_from, at.jacobian_to);
            let across = j_from * inverse.of_factor(k) * j_to.transpose();
            let covariance = j_from * inverse.of_pose(factor.from) * j_from.transpose()
                + j_to * inverse.of_pose(factor.to) * j_to.transpose()
                + across
                + across.transpose();
            let (_, rank) = square_root(&factor.information);
            let known = (factor.information.matrix() * covariance).trace();
            Some(ClosureError {
                edge,
                squared_error: factor.information.squared_norm(&at.error),
                redundancy: (rank as f64 - known).max(0.0),
                covariance,
            })
        };
        Some(Self {
            covariances: covariances.collect(),
            first_of_component: problem.components(),
            closures: problem
                .factor_names
                .iter()
                .enumerate()
                .filter_map(of_factor)
                .collect(),
        })
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::DMatrix;
    use proptest::prelude::*;

    use super::*;
    use crate::graph::EdgeStatus;
    use crate::solver::testing::{add_closure, random_graph};
    use crate::solver::{Marginals, SolveOptions, solve};

    /// H⁻¹ of all nodes by a dense inverse, in the poses' own frames; what is held gets none.
    fn dense_inverse(graph: &PoseGraph) -> DMatrix<f64> {
        let nodes = graph.nodes();
        let mut h = DMatrix::<f64>::zeros(3 * nodes.len(), 3 * nodes.len());
        let edges = graph.edges().iter().zip(graph.ends());
        for (edge, &(from, to)) in edges.filter(|(edge, _)| edge.status == EdgeStatus::Active) {
            let frame = |k: usize| Frame::of(nodes[k].pose);
            let measured = Frame::of(edge.measurement);
            let at = Frame::local_error(&frame(from), &frame(to), &measured);
            let ends = [(from, at.jacobian_from), (to, at.jacobian_to)];
            for (a, j_a) in &ends {
                for (b, j_b) in &ends {
                    let mut block = h.view_mut((3 * a, 3 * b), (3, 3));
                    block += j_a.transpose() * edge.information.matrix() * j_b;
                }
            }
        }
        for (node, first) in Problem::of_graph(graph).components().iter().enumerate() {
            if node == *first {
                for k in 3 * node..3 * node + 3 {
                    h.row_mut(k).fill(0.0);
                    h.column_mut(k).fill(0.0);
                    h[(k, k)] = 1.0;
                }
            }
        }
        h.try_inverse().unwrap()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(40))]

        #[test]
        fn covariances_are_those_of_the_dense_inverse(
            seed in 0..1_000_000_u64, nodes in 2..40_usize, closures in 0..30_usize,
        ) {
            let mut graph = random_graph(seed, nodes, if nodes < 10 { 0 } else { closures });
            solve(&mut graph, &SolveOptions::default());
            let errors = PoseErrors::of(&graph).unwrap();
            let dense = dense_inverse(&graph);
            for (k, node) in graph.nodes().iter().enumerate() {
                if errors.first_of_component[k] == k {
                    prop_assert_eq!(errors.covariances[k], Matrix3::zeros());
                    continue;
                }
                let own = dense.fixed_view::<3, 3>(3 * k, 3 * k).into_owned();
                let (sin, cos) = node.pose.theta.sin_cos();
                let turn = Matrix3::new(cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0);
                let expected = turn * own * turn.transpose();
                let gap = (errors.covariances[k] - expected).norm();
                prop_assert!(gap <= 1e-7 * expected.norm(), "{} {}", gap, expected);
            }
        }

        #[test]
        fn another_closure_makes_no_pose_less_certain(
            seed in 0..1_000_000_u64, nodes in 10..60_usize, closures in 0..12_usize,
        ) {
            let mut graph = random_graph(seed, nodes, closures);
            let tied = add_closure(&mut graph, seed + 1);
            graph.set_edge_status(tied, EdgeStatus::Retired);
            // At the same poses: derivatives are the same with and without it.
            let before = PoseErrors::of(&graph).unwrap();
            graph.set_edge_status(tied, EdgeStatus::Active);
            let after = PoseErrors::of(&graph).unwrap();
            for (k, first) in before.first_of_component.iter().enumerate() {
                // A tie between two components moves the frame of one of them.
                if after.first_of_component[k] != *first {
                    continue;
                }
                let gain = before.covariances[k] - after.covariances[k];
                let least = gain.symmetric_eigenvalues().min();
                prop_assert!(least >= -1e-9 * before.covariances[k].norm(), "{}", least);
            }
        }
    }

    #[test]
    fn closures_are_as_uncertain_as_the_marginals_say() {
        for seed in 0..20 {
            let mut graph = random_graph(seed, 40, 8);
            solve(&mut graph, &SolveOptions::default());
            let errors = PoseErrors::of(&graph).unwrap();
            let mut redundancy = 0.0;
            for closure in &errors.closures {
                let mut edge = graph.edges()[closure.edge];
                redundancy += closure.redundancy;
                edge.information = crate::geometry::Information::identity();
                let innovation = Marginals::of(&graph).unwrap().innovation(&edge).unwrap();
                let gap = (innovation.covariance - closure.covariance).norm();
                assert!(gap < 1e-9 * innovation.covariance.norm(), "{gap}");
            }
            // All edges together are redundant by their number less that of what they fix.
            let count = errors.closures.len() as f64;
            assert!(redundancy > 0.0 && redundancy < 3.0 * count);
        }
    }
}
