//! Only the biconnected blocks that some edges belong to, to the exact optimum.

use super::minimise::Minimiser;
use super::problem::{Factor, Problem};
use super::summary::{SolveOptions, SolveSummary, Termination};
use crate::geometry::Pose2;
use crate::graph::{Block, BlockIndex, Blocks, PoseGraph};
use crate::ids::{EdgeId, NodeId};

/// A solver that is called again and again on one growing graph, and keeps its memory.
pub struct Solver {
    minimiser: Minimiser,
}

/// What a solve of the touched blocks did.
#[derive(Debug, Clone, PartialEq)]
pub struct TouchedSummary {
    /// Costs and iterations are summed over the touched blocks; the termination is the worst.
    pub summary: SolveSummary,
    /// F now, less F before the touched edges were there (the blocks' cost at the start without
    /// them). For one new closure in a graph at its optimum this is the paper's
    /// ΔF_n = F(n) − F(n−1), at least 0 but for rounding.
    pub delta_f: f64,
    /// Every node whose pose is another now, carried ones included, in the graph's order.
    pub moved: Vec<NodeId>,
}

impl Default for Solver {
    fn default() -> Self {
        Self::new()
    }
}

impl Solver {
    /// A solver with no memory yet.
    pub fn new() -> Self {
        Self {
            minimiser: Minimiser::for_growing(),
        }
    }

    /// Solves the biconnected blocks that contain the touched edges, from the poses as they are.
    ///
    /// Within a block its node nearest to the component's first node is held, and whatever
    /// hangs off its other nodes is carried along rigidly, so that all other edges keep their
    /// errors. If the rest of the graph was at its optimum, the whole graph is afterwards.
    /// Touched edges that are not active, or not there, are passed over: after retiring an edge
    /// its block may have fallen apart, and the whole graph wants solving.
    pub fn solve_touched(
        &mut self,
        graph: &mut PoseGraph,
        touched: &[EdgeId],
        options: &SolveOptions,
    ) -> TouchedSummary {
        let blocks = Blocks::of(graph);
        let positions = touched.iter().filter_map(|&id| graph.edge_position(id));
        let mut touched: Vec<usize> = positions.collect();
        touched.sort_unstable();
        touched.dedup();
        let mut indices: Vec<BlockIndex> =
            touched.iter().filter_map(|&e| blocks.of_edge(e)).collect();
        indices.sort_unstable();
        indices.dedup();

        let before: Vec<Pose2> = graph.nodes().iter().map(|node| node.pose).collect();
        let mut total = TouchedSummary {
            summary: SolveSummary::nothing(),
            delta_f: 0.0,
            moved: Vec::new(),
        };
        for index in indices {
            let block = &blocks.all()[index];
            let (mut problem, nodes) = block_problem(graph, block);
            let of_touched =
                |(k, _): &(usize, &Factor)| touched.binary_search(&block.edges[*k]).is_ok();
            let factors = problem.factors.iter().enumerate();
            let cost_of_touched: f64 = factors
                .filter(of_touched)
                .map(|(_, factor)| factor.cost(&problem.poses))
                .sum();
            let summary = self.minimiser.minimise(&mut problem, options);
            total.delta_f += summary.final_cost - (summary.initial_cost - cost_of_touched);
            total.summary.add(&summary);
            if summary.moved {
                carry(graph, &blocks, &nodes, &problem.poses);
            }
        }
        let nodes = graph.nodes().iter().zip(&before);
        total.moved = nodes
            .filter(|(node, before)| node.pose != **before)
            .map(|(node, _)| node.id)
            .collect();
        total
    }
}

/// A block as a problem, its anchor held, and the places of its poses in the graph.
fn block_problem(graph: &PoseGraph, block: &Block) -> (Problem, Vec<usize>) {
    let mut nodes = Vec::with_capacity(block.nodes.len() + 1);
    nodes.push(block.anchor);
    nodes.extend_from_slice(&block.nodes);
    let mut local = vec![0; graph.nodes().len()];
    for (k, &node) in nodes.iter().enumerate() {
        local[node] = k;
    }
    let factors = block.edges.iter().map(|&edge| {
        let (from, to) = graph.ends()[edge];
        Factor::of_edge(&graph.edges()[edge], local[from], local[to])
    });
    let problem = Problem {
        poses: nodes.iter().map(|&n| graph.nodes()[n].pose).collect(),
        held: (0..nodes.len()).map(|k| k == 0).collect(),
        factors: factors.collect(),
        pose_names: nodes.clone(),
        factor_names: block.edges.clone(),
    };
    (problem, nodes)
}

/// Moves a block's nodes, and with each node what hangs off it.
fn carry(graph: &mut PoseGraph, blocks: &Blocks, nodes: &[usize], poses: &[Pose2]) {
    let mut open: Vec<BlockIndex> = Vec::new();
    // The anchor, first among the nodes, was held.
    for (&node, pose) in nodes.iter().zip(poses).skip(1) {
        let before = graph.nodes()[node].pose;
        if before == *pose {
            continue;
        }
        graph.set_pose_at(node, *pose);
        open.extend_from_slice(blocks.hanging_off(node));
        while let Some(index) = open.pop() {
            for &carried in &blocks.all()[index].nodes {
                let relative = before.between(&graph.nodes()[carried].pose);
                graph.set_pose_at(carried, pose.compose(&relative));
                open.extend_from_slice(blocks.hanging_off(carried));
            }
        }
    }
}

impl SolveSummary {
    fn nothing() -> Self {
        Self {
            initial_cost: 0.0,
            final_cost: 0.0,
            iterations: 0,
            termination: Termination::NothingToSolve,
            moved: false,
        }
    }

    fn add(&mut self, other: &Self) {
        self.initial_cost += other.initial_cost;
        self.final_cost += other.final_cost;
        self.iterations += other.iterations;
        self.moved |= other.moved;
        let nothing = self.termination == Termination::NothingToSolve;
        if nothing || !other.termination.is_converged() {
            self.termination = other.termination;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::solve;
    use super::super::testing::{add_closure, random_graph};
    use super::*;
    use crate::geometry::wrap_angle;
    use crate::graph::EdgeStatus;
    use proptest::prelude::*;

    fn distance(a: &PoseGraph, b: &PoseGraph) -> f64 {
        let pairs = a.nodes().iter().zip(b.nodes());
        pairs
            .map(|(a, b)| {
                let angle = wrap_angle(a.pose.theta - b.pose.theta);
                (a.pose.x - b.pose.x)
                    .abs()
                    .max((a.pose.y - b.pose.y).abs())
                    .max(angle.abs())
            })
            .fold(0.0, f64::max)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(60))]

        #[test]
        fn agrees_with_the_whole_solve(seed in 0..100_000_u64, closures in 0..12_usize) {
            let tight = SolveOptions { cost_tolerance: 1e-14, ..SolveOptions::default() };
            let mut graph = random_graph(seed, 40, closures);
            solve(&mut graph, &tight);
            let mut solver = Solver::new();
            for k in 0..3 {
                let before = graph.cost();
                let id = add_closure(&mut graph, seed.wrapping_mul(31).wrapping_add(k));
                let mut whole = graph.clone();
                let summary = solve(&mut whole, &tight);
                let touched = solver.solve_touched(&mut graph, &[id], &tight);
                prop_assert!(summary.termination.is_converged());
                prop_assert!(touched.summary.termination.is_converged());
                let (a, b) = (graph.cost(), whole.cost());
                prop_assert!((a - b).abs() <= 1e-9 * b + 1e-12, "{} {}", a, b);
                prop_assert!(distance(&graph, &whole) < 1e-6);
                prop_assert!((touched.delta_f - (a - before)).abs() < 1e-8 * (1.0 + a));
                prop_assert!(touched.delta_f > -1e-9 * (1.0 + a));
            }
        }
    }

    #[test]
    fn edges_outside_the_block_keep_their_errors() {
        let mut graph = random_graph(7, 60, 9);
        // Not at its optimum on purpose: whatever hangs off must be carried, not improved.
        let blocks = Blocks::of(&graph);
        let largest = blocks
            .all()
            .iter()
            .max_by_key(|b| b.edges.len())
            .unwrap()
            .clone();
        let errors: Vec<_> = graph
            .edges()
            .iter()
            .map(|e| graph.error_of(e).unwrap())
            .collect();
        let touched = [graph.edges()[largest.edges[0]].id];
        let summary = Solver::new().solve_touched(&mut graph, &touched, &SolveOptions::default());
        assert!(summary.summary.moved && !summary.moved.is_empty());
        for (k, edge) in graph.edges().iter().enumerate() {
            if !largest.edges.contains(&k) {
                assert!((graph.error_of(edge).unwrap() - errors[k]).norm() < 1e-10);
            }
        }
    }

    /// What a solver remembers may make it faster, but must not show in what it finds.
    #[test]
    fn memories_of_another_graph_do_no_harm() {
        let tight = SolveOptions {
            cost_tolerance: 1e-14,
            ..SolveOptions::default()
        };
        let mut solver = Solver::new();
        for seed in 0..30 {
            let mut graph = random_graph(seed, 40, 6);
            if seed % 3 == 0 {
                graph.set_edge_status(graph.edges()[12].id, EdgeStatus::Retired);
            }
            for round in 0..3 {
                let id = add_closure(&mut graph, 7 * seed + round);
                let mut other = graph.clone();
                let all: Vec<_> = graph.edges().iter().map(|edge| edge.id).collect();
                solver.solve_touched(&mut graph, &all, &tight);
                Solver::new().solve_touched(&mut other, &all, &tight);
                let (a, b) = (graph.cost(), other.cost());
                assert!((a - b).abs() <= 1e-9 * b + 1e-12, "{seed} {id:?} {a} {b}");
                assert!(distance(&graph, &other) < 1e-6);
            }
        }
    }

    #[test]
    fn touched_edges_that_take_no_part_are_passed_over() {
        let mut graph = random_graph(3, 10, 2);
        let id = graph.edges()[0].id;
        graph.set_edge_status(id, EdgeStatus::Retired);
        let touched =
            Solver::new().solve_touched(&mut graph, &[id, EdgeId(999)], &SolveOptions::default());
        assert_eq!(touched.summary.termination, Termination::NothingToSolve);
        assert!(touched.moved.is_empty());
    }
}
