//! Only the biconnected blocks that some edges belong to, to the exact optimum.

#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, BTreeSet};

use super::attribution::attribute_increase;
use super::block_problem::BlockProblem;
use crate::graph::{BlockIndex, PoseGraph};
use crate::ids::{EdgeId, NodeId};
use crate::solver::interrupt::Interrupt;
use crate::solver::least_squares::{Minimiser, SolveOptions, SolveSummary, factor_of_edge};

/// A solver for one growing graph, which keeps its memory between calls.
#[derive(Default)]
pub struct Solver {
    minimiser: Minimiser,
    /// The problem that was minimised last.
    block: BlockProblem,
}

/// The result of solving the touched blocks.
#[derive(Debug, Clone, PartialEq)]
pub struct TouchedSummary {
    /// Costs and iterations are summed over what was solved of the touched blocks; the termination
    /// is the worst.
    pub summary: SolveSummary,
    /// F now, less F before the touched edges were there (what was solved at the start, without
    /// them). For one new closure in a graph at its optimum this is the paper's
    /// ΔF_n = F(n) − F(n−1), at least 0 but for rounding.
    pub delta_f: f64,
    /// Every node that was moved, those of child blocks included, in the graph's order.
    pub moved: Vec<NodeId>,
}

impl Solver {
    /// A solver with no memory yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// A solver with no memory yet, whose solves stop at the current poses once this is raised.
    pub fn heeding(interrupt: &Interrupt) -> Self {
        Self {
            minimiser: Minimiser::heeding(interrupt),
            block: BlockProblem::default(),
        }
    }

    /// From now on all solves together take about so many multiplications at most, counted by the structure
    /// of what is solved and not by a clock; they end where they are once it has.
    pub fn allow(&mut self, operations_max: f64) {
        self.minimiser.allow(operations_max);
    }

    /// How many multiplications all solves together have taken.
    pub fn operations(&self) -> f64 {
        self.minimiser.operations()
    }

    /// Whether solves have ended early, or would, because they have taken all that was allowed.
    pub fn is_exhausted(&self) -> bool {
        self.minimiser.is_exhausted()
    }

    /// Solves the biconnected blocks that contain the touched edges, from the poses as they are.
    ///
    /// Within a block its node nearest to the component's first node is held, and the child blocks
    /// of its other nodes follow by rigid propagation, so that all other edges keep their errors.
    /// If the rest of the graph was at its optimum, the whole graph is afterwards. Touched edges
    /// that are not active, or not there, are passed over: after retiring an edge its block may
    /// have fallen apart, and the whole graph should be solved.
    ///
    /// Costs as much as the touched blocks and the nodes of their child blocks.
    pub fn solve_touched(
        &mut self,
        graph: &mut PoseGraph,
        touched: &[EdgeId],
        options: &SolveOptions,
    ) -> TouchedSummary {
        self.solve_blocks(graph, touched, options, false).0
    }

    /// Solves as [`Solver::solve_touched`] does, after some closures were added, and returns how
    /// much each of them increased F without those after it: the paper's ΔF, exact where
    /// errors are linear. The sum over a block is exact. Closures that were not solved get 0.
    pub fn solve_closures(
        &mut self,
        graph: &mut PoseGraph,
        closures: &[EdgeId],
        options: &SolveOptions,
    ) -> Vec<f64> {
        let (_, attributed) = self.solve_blocks(graph, closures, options, true);
        let increase = |id: &EdgeId| attributed.get(&graph.edge_position(*id)?).copied();
        let increases = closures.iter().map(|id| increase(id).unwrap_or(0.0));
        increases.collect()
    }

    /// The summary and, if the edges `are_closures`, the increase of F by each.
    fn solve_blocks(
        &mut self,
        graph: &mut PoseGraph,
        touched: &[EdgeId],
        options: &SolveOptions,
        are_closures: bool,
    ) -> (TouchedSummary, BTreeMap<usize, f64>) {
        let positions = touched.iter().filter_map(|&id| graph.edge_position(id));
        let touched: BTreeSet<usize> = positions.collect();
        let mut attributed = BTreeMap::new();
        let mut total = TouchedSummary {
            summary: SolveSummary::nothing(),
            delta_f: 0.0,
            moved: Vec::new(),
        };
        let mut moved = Vec::new();
        for (index, touched) in by_block(graph, &touched) {
            let Some(solved) = self.solve_block(graph, index, &touched, options) else {
                continue;
            };
            if are_closures {
                let equations = self.minimiser.factored(&self.block.problem);
                let of_block =
                    attribute_increase(solved.delta_f, &touched, &self.block.problem, equations);
                attributed.extend(touched.iter().copied().zip(of_block));
            }
            total.delta_f += solved.delta_f;
            total.summary.add(&solved.summary);
            let problem = &self.block.problem;
            let names = problem.pose_names.iter().copied();
            let poses = problem.poses.iter().copied();
            graph.move_with_children(names.zip(poses), &mut moved);
        }
        moved.sort_unstable();
        moved.dedup();
        let nodes = graph.nodes();
        total.moved = moved.into_iter().map(|place| nodes[place].id).collect();
        (total, attributed)
    }

    /// Takes a block over as the problem, and solves it.
    fn solve_block(
        &mut self,
        graph: &PoseGraph,
        index: BlockIndex,
        touched: &[usize],
        options: &SolveOptions,
    ) -> Option<Solved> {
        let known = self.block.take_in(graph, index)?;
        let cost_of_touched = cost_of(graph, touched);
        let problem = &mut self.block.problem;
        let summary = self.minimiser.minimise_more(problem, known, options);
        Some(Solved {
            summary,
            delta_f: summary.final_cost - (summary.initial_cost - cost_of_touched),
        })
    }
}

/// The result of solving a block.
struct Solved {
    summary: SolveSummary,
    delta_f: f64,
}

/// Σ eᵀΩe over some edges at the graph's poses.
fn cost_of(graph: &PoseGraph, edges: &[usize]) -> f64 {
    let cost = |&edge: &usize| {
        let (from, to) = graph.ends()[edge];
        let poses = [from, to].map(|node| graph.nodes()[node].pose);
        factor_of_edge(&graph.edges()[edge], 0, 1).cost(&poses)
    };
    edges.iter().map(cost).sum()
}

/// The blocks that some edges belong to, by the first of these edges, with those edges.
fn by_block(graph: &PoseGraph, touched: &BTreeSet<usize>) -> Vec<(BlockIndex, Vec<usize>)> {
    let mut groups: Vec<(BlockIndex, Vec<usize>)> = Vec::new();
    let mut group_of = BTreeMap::new();
    for &edge in touched {
        let Some(index) = graph.blocks().of_edge(edge) else {
            continue;
        };
        let group = *group_of.entry(index).or_insert(groups.len());
        match groups.get_mut(group) {
            Some((_, edges)) => edges.push(edge),
            None => groups.push((index, vec![edge])),
        }
    }
    groups
}
