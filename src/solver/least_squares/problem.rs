//! A pose graph by places instead of ids: what the minimiser works on.

use crate::geometry::Pose2;
use crate::graph::{Edge, EdgeStatus, PoseGraph};
use crate::solver::factor::{Factor, Frame, dispatch};
use crate::solver::linear::approximate_minimum_degree;

/// An edge between the poses at two places.
pub(crate) fn factor_of_edge(edge: &Edge, from: usize, to: usize) -> Factor {
    Factor {
        from,
        to,
        measurement: Frame::of(edge.measurement),
        information: edge.information,
        weight: 1.0,
    }
}

/// Poses, some of them held, and the factors between them.
#[derive(Debug, Clone, Default)]
pub(crate) struct Problem {
    pub(crate) poses: Vec<Pose2>,
    pub(crate) held: Vec<bool>,
    pub(crate) factors: Vec<Factor>,
    /// For each pose the place of its node in the graph, by which it is known again in a later
    /// problem.
    pub(crate) pose_names: Vec<usize>,
    /// The same for each factor and its edge.
    pub(crate) factor_names: Vec<usize>,
}

/// How many poses and factors of a problem that grows were there before.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Known {
    pub(crate) poses: usize,
    pub(crate) factors: usize,
}

impl Problem {
    /// All nodes and active edges of a graph; each component's first node is held.
    pub(crate) fn of_graph(graph: &PoseGraph) -> Self {
        let edges = graph.edges().iter().enumerate();
        let active = edges.filter(|(_, edge)| edge.status == EdgeStatus::Active);
        let factor_names: Vec<usize> = active.map(|(position, _)| position).collect();
        let factor = |&position: &usize| {
            let (from, to) = graph.ends()[position];
            factor_of_edge(&graph.edges()[position], from, to)
        };
        let mut problem = Self {
            poses: graph.nodes().iter().map(|node| node.pose).collect(),
            held: Vec::new(),
            factors: factor_names.iter().map(factor).collect(),
            pose_names: (0..graph.nodes().len()).collect(),
            factor_names,
        };
        problem.hold_first_of_each_component();
        problem
    }

    fn hold_first_of_each_component(&mut self) {
        let components = self.components();
        self.held = (0..self.poses.len()).map(|k| components[k] == k).collect();
    }

    /// Which poses are moved: those that have a factor and are not held.
    pub(crate) fn free(&self) -> Vec<bool> {
        let mut free = vec![false; self.poses.len()];
        for factor in &self.factors {
            free[factor.from] = !self.held[factor.from];
            free[factor.to] = !self.held[factor.to];
        }
        free
    }

    /// The poses that are moved, in an order of elimination that keeps the Cholesky factor
    /// sparse; `None` if memory runs out.
    pub(crate) fn elimination_order(&self) -> Option<Vec<usize>> {
        let free = self.free();
        let poses: Vec<usize> = (0..free.len()).filter(|&k| free[k]).collect();
        let mut number = vec![0; free.len()];
        for (k, &pose) in poses.iter().enumerate() {
            number[pose] = k as u32;
        }
        let coupled = self.factors.iter().filter(|f| free[f.from] && free[f.to]);
        let pairs: Vec<_> = coupled.map(|f| (number[f.from], number[f.to])).collect();
        let order = approximate_minimum_degree(poses.len(), &pairs)?;
        Some(order.into_iter().map(|k| poses[k as usize]).collect())
    }

    /// For each pose the first pose of its component.
    pub(crate) fn components(&self) -> Vec<usize> {
        let mut parent: Vec<usize> = (0..self.poses.len()).collect();
        for factor in &self.factors {
            let (a, b) = (root(&mut parent, factor.from), root(&mut parent, factor.to));
            // The smaller place becomes the root, so that roots are first poses.
            parent[a.max(b)] = a.min(b);
        }
        (0..parent.len()).map(|k| root(&mut parent, k)).collect()
    }

    /// Σ weight · eᵀΩe.
    pub(crate) fn cost_at(&self, poses: &[Pose2]) -> f64 {
        let frames: Vec<Frame> = poses.iter().map(|&pose| Frame::of(pose)).collect();
        self.cost_of(&frames)
    }

    /// Σ weight · eᵀΩe, given the poses as frames.
    pub(crate) fn cost_of(&self, frames: &[Frame]) -> f64 {
        let cost = |factor: &Factor| {
            let (from, to) = (&frames[factor.from], &frames[factor.to]);
            let error = Frame::error(from, to, &factor.measurement);
            factor.weight * factor.information.squared_norm(&error)
        };
        dispatch(
            #[inline(always)]
            || self.factors.iter().map(cost).sum(),
        )
    }
}

fn root(parent: &mut [usize], mut k: usize) -> usize {
    while parent[k] != k {
        parent[k] = parent[parent[k]];
        k = parent[k];
    }
    k
}
