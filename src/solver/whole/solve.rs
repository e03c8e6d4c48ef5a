//! The whole graph at once.

use super::chordal::chordal_poses;
use crate::geometry::Pose2;
use crate::graph::PoseGraph;
use crate::solver::least_squares::{Minimiser, Problem, SolveOptions, SolveSummary};

/// Moves all nodes to a minimum of F near their poses; each connected component's first node
/// stays. Returns within the budget of iterations, whatever the graph; the cost never rises and
/// finite poses stay finite.
pub fn solve(graph: &mut PoseGraph, options: &SolveOptions) -> SolveSummary {
    let mut problem = Problem::of_graph(graph);
    let summary = Minimiser::minimise_once(&mut problem, options);
    publish(graph, &problem.poses);
    summary
}

/// As [`solve`], but from a chordal start, which needs no guess and reaches the global minimum
/// where descent from odometry often does not. If that start cannot be had, or ends above the
/// cost of the poses as they are, the descent is from those.
pub fn solve_from_chordal(graph: &mut PoseGraph, options: &SolveOptions) -> SolveSummary {
    let mut problem = Problem::of_graph(graph);
    let initial_cost = problem.cost_at(&problem.poses);
    let Some(start) = chordal_poses(&problem) else {
        return solve(graph, options);
    };
    problem.poses = start;
    let summary = Minimiser::minimise_once(&mut problem, options);
    // A cost that is not a number is no gain either.
    let gains = summary.final_cost < initial_cost;
    if !gains {
        return solve(graph, options);
    }
    publish(graph, &problem.poses);
    SolveSummary {
        initial_cost,
        moved: true,
        ..summary
    }
}

pub(super) fn publish(graph: &mut PoseGraph, poses: &[Pose2]) {
    for (position, pose) in poses.iter().enumerate() {
        graph.set_pose_at(position, *pose);
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::geometry::Information;
    use crate::graph::{Edge, EdgeKind, EdgeStatus, Node};
    use crate::ids::{EdgeId, NodeId};
    use crate::solver::testing::random_graph;
    use crate::solver::{Termination, solve_robust, start_along_odometry};

    fn chain(poses: &[Pose2], motion: Pose2, information: Information) -> PoseGraph {
        let mut graph = PoseGraph::new();
        for (k, &pose) in poses.iter().enumerate() {
            let id = NodeId(k as i64);
            graph.add_node(Node { id, pose }).unwrap();
        }
        for k in 1..poses.len() as i64 {
            graph
                .add_edge(Edge {
                    id: EdgeId(k),
                    from: NodeId(k - 1),
                    to: NodeId(k),
                    measurement: motion,
                    information,
                    kind: EdgeKind::Odometry,
                    status: EdgeStatus::Active,
                })
                .unwrap();
        }
        graph
    }

    fn both(graph: &PoseGraph, check: impl Fn(&PoseGraph, &SolveSummary)) {
        for solver in [solve, solve_from_chordal] {
            let mut graph = graph.clone();
            let summary = solver(&mut graph, &SolveOptions::default());
            check(&graph, &summary);
        }
    }

    #[test]
    fn nothing_to_solve_is_said_so() {
        let information = Information::identity();
        let lonely = chain(&[Pose2::new(1.0, 2.0, 3.0)], Pose2::IDENTITY, information);
        for graph in [PoseGraph::new(), lonely] {
            both(&graph, |after, summary| {
                assert_eq!(summary.termination, Termination::NothingToSolve);
                assert_eq!((summary.final_cost, summary.moved), (0.0, false));
                assert_eq!(after.nodes(), graph.nodes());
            });
        }
    }

    #[test]
    fn every_component_is_held_by_its_first_node() {
        let graph = random_graph(11, 40, 10);
        both(&graph, |after, summary| {
            assert!(summary.termination.is_converged() && summary.moved);
            let gap = 32;
            for first in [0, gap] {
                assert_eq!(after.nodes()[first], graph.nodes()[first]);
            }
            assert_ne!(after.nodes()[gap + 1], graph.nodes()[gap + 1]);
        });
    }

    /// A closure that knows nothing along x says nothing there, however wrong it is; a chain that
    /// knows nothing along x is solved in the other directions.
    #[test]
    fn a_corridor_is_solved_in_the_directions_that_are_known() {
        let corridor = Information::from_upper([0.0, 0.0, 0.0, 400.0, 0.0, 900.0]);
        let poses = [0.0, 1.1, 1.9, 3.2].map(|x| Pose2::new(x, 0.1 * x, 0.02 * x));
        let motion = Pose2::new(1.0, 0.0, 0.0);
        let mut graph = chain(&poses, motion, Information::from_sigmas(0.1, 0.1));
        let closure = Edge {
            id: EdgeId(9),
            from: NodeId(0),
            to: NodeId(3),
            measurement: Pose2::new(-50.0, 0.0, 0.0),
            information: corridor,
            kind: EdgeKind::LoopClosure,
            status: EdgeStatus::Active,
        };
        graph.add_edge(closure).unwrap();
        both(&graph, |after, summary| {
            assert!(summary.termination.is_converged(), "{summary:?}");
            let last = after.nodes()[3].pose;
            assert!((last.x - 3.0).abs() < 1e-6 && last.y.abs() < 1e-6 && last.theta.abs() < 1e-6);
        });
        both(&chain(&poses, motion, corridor), |after, summary| {
            assert!(summary.termination.is_converged(), "{summary:?}");
            assert!(summary.final_cost < 1e-12 * summary.initial_cost);
            let known = |node: &Node| node.pose.y.abs() < 1e-6 && node.pose.theta.abs() < 1e-6;
            assert!(
                after
                    .nodes()
                    .iter()
                    .all(|node| node.pose.is_finite() && known(node))
            );
        });
    }

    #[test]
    fn information_of_zero_moves_nothing() {
        let zero = Information::from_upper([0.0; 6]);
        let poses = [0.0, 1.0, 2.5].map(|x| Pose2::new(x, 0.0, 0.3));
        let graph = chain(&poses, Pose2::new(1.0, 0.0, 0.0), zero);
        both(&graph, |after, summary| {
            assert_eq!(summary.final_cost, 0.0);
            assert!(after.nodes().iter().all(|node| node.pose.is_finite()));
        });
    }

    #[test]
    fn a_start_that_is_not_finite_is_refused() {
        let poses = [Pose2::IDENTITY, Pose2::new(f64::NAN, 0.0, 0.0)];
        let graph = chain(&poses, Pose2::IDENTITY, Information::identity());
        let summary = solve(&mut graph.clone(), &SolveOptions::default());
        assert_eq!(
            (summary.termination, summary.moved),
            (Termination::NotFinite, false)
        );
    }

    #[test]
    fn the_budget_is_kept() {
        let mut graph = random_graph(4, 40, 10);
        let options = SolveOptions {
            iterations_max: 1,
            ..SolveOptions::default()
        };
        let summary = solve(&mut graph, &options);
        assert_eq!(
            (summary.iterations, summary.termination),
            (1, Termination::IterationLimit)
        );
        assert!(summary.final_cost < summary.initial_cost);
    }

    #[test]
    fn all_starts_lead_to_one_optimum() {
        for seed in 0..20 {
            let mut given = random_graph(seed, 50, 15);
            let mut odometry = given.clone();
            start_along_odometry(&mut odometry);
            let mut chordal = odometry.clone();
            let options = SolveOptions::default();
            let costs = [
                solve(&mut given, &options).final_cost,
                solve(&mut odometry, &options).final_cost,
                solve_from_chordal(&mut chordal, &options).final_cost,
            ];
            assert!((given.cost() / costs[0] - 1.0).abs() < 1e-12);
            assert!((costs[1] / costs[0] - 1.0).abs() < 1e-9, "{seed} {costs:?}");
            assert!((costs[2] / costs[0] - 1.0).abs() < 1e-9, "{seed} {costs:?}");
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(150))]

        /// Singular, hugely different and plainly indefinite information, wild poses: always an
        /// answer, never a worse cost, never a pose that is not finite.
        #[test]
        fn wild_graphs_are_survived(
            poses in prop::collection::vec((-1e4..1e4_f64, -1e4..1e4_f64, -3.0..3.0_f64), 1..12),
            edges in prop::collection::vec(
                (0..12_usize, 0..12_usize, -3.0..3.0_f64, 0..6_usize, -10..10_i32), 0..20),
        ) {
            let poses: Vec<Pose2> = poses.iter().map(|&(x, y, t)| Pose2::new(x, y, t)).collect();
            let mut graph = chain(&poses, Pose2::IDENTITY, Information::identity());
            for (k, &(a, b, turn, kind, exponent)) in edges.iter().enumerate() {
                let (a, b) = (a % poses.len(), b % poses.len());
                let upper = [
                    [1.0, 0.0, 0.0, 1.0, 0.0, 1.0],
                    [0.0, 0.0, 0.0, 1.0, 0.0, 1.0],
                    [0.0; 6],
                    [1.0, 1.0, 0.0, 1.0, 0.0, 0.0],
                    [1.0, 2.0, 0.0, 1.0, 0.0, 1.0],
                    [0.0, 0.0, 0.0, 0.0, 0.0, 1.0],
                ][kind].map(|v: f64| v * 10f64.powi(exponent));
                let _ = graph.add_edge(Edge {
                    id: EdgeId(1000 + k as i64),
                    from: NodeId(a as i64),
                    to: NodeId(b as i64),
                    measurement: Pose2::new(turn * 1e3, -turn, turn),
                    information: Information::from_upper(upper),
                    kind: EdgeKind::LoopClosure,
                    status: EdgeStatus::Active,
                });
            }
            both(&graph, |after, summary| {
                assert!(summary.iterations <= SolveOptions::default().iterations_max);
                assert!(summary.final_cost <= summary.initial_cost);
                assert!(after.nodes().iter().all(|node| node.pose.is_finite()));
                let cost = after.cost();
                // Where F has no minimum, poses flee until rounding is all that is left of an error.
                let extent = |node: &Node| node.pose.x.abs().max(node.pose.y.abs());
                let fled = after.nodes().iter().any(|node| extent(node) > 1e7);
                let gap = (cost - summary.final_cost).abs();
                assert!(fled || gap <= 1e-9 * (1.0 + cost.abs()), "{cost} {summary:?}");
            });
            let mut robust = graph.clone();
            solve_robust(&mut robust, &SolveOptions::default());
            prop_assert!(robust.nodes().iter().all(|node| node.pose.is_finite()));
        }
    }
}
