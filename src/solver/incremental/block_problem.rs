//! A biconnected block as a problem, kept while the block grows.

use crate::graph::{BlockIndex, PoseGraph};
use crate::solver::factor::Factor;
use crate::solver::least_squares::{Known, Problem, factor_of_edge};

/// No pose, no factor.
const NONE: u32 = u32::MAX;

/// The problem of the block that was solved last. Its anchor, the first pose, is held.
#[derive(Debug, Default)]
pub(super) struct BlockProblem {
    pub(super) problem: Problem,
    /// By the place of a node in the graph its place among the poses; the same for edges and
    /// factors.
    pose_of_node: Vec<u32>,
    factor_of_edge: Vec<u32>,
}

impl BlockProblem {
    /// Makes it the problem of a block, at the graph's poses; says how much of it is as it was.
    ///
    /// If all that it has is in the block, what is new comes behind it, else it is made
    /// again. Either way the order is that of the graph, however the block has grown.
    pub(super) fn take_in(&mut self, graph: &PoseGraph, index: BlockIndex) -> Option<Known> {
        let block = graph.blocks().get(index)?;
        if !self.is_within(graph, index) {
            self.forget();
        }
        let known = Known {
            poses: self.problem.poses.len(),
            factors: self.problem.factors.len(),
        };
        self.pose_of_node.resize(graph.nodes().len(), NONE);
        self.factor_of_edge.resize(graph.edges().len(), NONE);
        let Problem {
            poses,
            held,
            factors,
            pose_names,
            factor_names,
        } = &mut self.problem;
        if known.poses == 0 {
            pose_names.push(block.anchor);
        }
        let anchor_and_known = pose_names.len();
        let is_new = |node: &usize| self.pose_of_node[*node] == NONE;
        pose_names.extend(block.nodes.iter().copied().filter(is_new));
        pose_names[anchor_and_known..].sort_unstable();
        for (place, &node) in pose_names.iter().enumerate().skip(known.poses) {
            self.pose_of_node[node] = place as u32;
            held.push(place == 0);
        }
        poses.clear();
        poses.extend(pose_names.iter().map(|&node| graph.nodes()[node].pose));
        let is_new = |edge: &usize| self.factor_of_edge[*edge] == NONE;
        factor_names.extend(block.edges.iter().copied().filter(is_new));
        factor_names[known.factors..].sort_unstable();
        for (place, &edge) in factor_names.iter().enumerate().skip(known.factors) {
            self.factor_of_edge[edge] = place as u32;
            let (from, to) = graph.ends()[edge];
            let [from, to] = [from, to].map(|node| self.pose_of_node[node] as usize);
            factors.push(factor_of_edge(&graph.edges()[edge], from, to));
        }
        Some(known)
    }

    /// Whether all of it is in a block, with the same numbers.
    fn is_within(&self, graph: &PoseGraph, index: BlockIndex) -> bool {
        let (blocks, problem) = (graph.blocks(), &self.problem);
        let place = |node: usize| self.pose_of_node.get(node).map(|&place| place as usize);
        let is_same = |(&name, factor): (&usize, &Factor)| {
            let (Some(edge), Some(&(from, to))) = (graph.edges().get(name), graph.ends().get(name))
            else {
                return false;
            };
            blocks.of_edge(name) == Some(index)
                && edge.measurement == factor.measurement.pose
                && edge.information == factor.information
                && (place(from), place(to)) == (Some(factor.from), Some(factor.to))
        };
        let anchor = blocks.get(index).map(|block| &block.anchor);
        problem.pose_names.first() == anchor
            && problem
                .factor_names
                .iter()
                .zip(&problem.factors)
                .all(is_same)
    }

    fn forget(&mut self) {
        for &node in &self.problem.pose_names {
            self.pose_of_node[node] = NONE;
        }
        for &edge in &self.problem.factor_names {
            self.factor_of_edge[edge] = NONE;
        }
        self.problem = Problem::default();
    }
}
