//! The whole graph at once.

use super::chordal::chordal_poses;
use super::minimise::Minimiser;
use super::problem::Problem;
use super::summary::{SolveOptions, SolveSummary};
use crate::geometry::Pose2;
use crate::graph::PoseGraph;

/// Moves all nodes to a minimum of F near their poses; each connected component's first node
/// stays. Returns within the budget of iterations, whatever the graph; the cost never rises and
/// finite poses stay finite.
pub fn solve(graph: &mut PoseGraph, options: &SolveOptions) -> SolveSummary {
    let mut problem = Problem::of_graph(graph);
    let summary = Minimiser::default().minimise(&mut problem, options);
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
    let summary = Minimiser::default().minimise(&mut problem, options);
    // Not `>`: a cost that is not a number is no gain either.
    if !(summary.final_cost < initial_cost) {
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
