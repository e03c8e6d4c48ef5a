//! A pose graph by places instead of ids: what the minimiser works on.

use crate::geometry::{Information, Pose2};
use crate::graph::{Edge, EdgeStatus, PoseGraph};

/// A measured motion between two poses, by their places.
#[derive(Debug, Clone, Copy)]
pub(super) struct Factor {
    pub(super) from: usize,
    pub(super) to: usize,
    pub(super) measurement: Pose2,
    pub(super) information: Information,
    /// What the information is multiplied with: 1 but in a robust solve.
    pub(super) weight: f64,
}

impl Factor {
    /// An edge between the poses at two places.
    pub(super) fn of_edge(edge: &Edge, from: usize, to: usize) -> Self {
        Self {
            from,
            to,
            measurement: edge.measurement,
            information: edge.information,
            weight: 1.0,
        }
    }

    /// eᵀΩe without the weight.
    pub(super) fn cost(&self, poses: &[Pose2]) -> f64 {
        let error = Pose2::edge_error(&poses[self.from], &poses[self.to], &self.measurement);
        self.information.squared_norm(&error)
    }
}

/// Poses, some of them held, and the factors between them.
#[derive(Debug, Clone, Default)]
pub(super) struct Problem {
    pub(super) poses: Vec<Pose2>,
    pub(super) held: Vec<bool>,
    pub(super) factors: Vec<Factor>,
}

impl Problem {
    /// All nodes and active edges of a graph; each component's first node is held.
    pub(super) fn of_graph(graph: &PoseGraph) -> Self {
        let factors = graph
            .edges()
            .iter()
            .zip(graph.ends())
            .filter(|(edge, _)| edge.status == EdgeStatus::Active)
            .map(|(edge, &(from, to))| Factor::of_edge(edge, from, to))
            .collect();
        let mut problem = Self {
            poses: graph.nodes().iter().map(|node| node.pose).collect(),
            held: Vec::new(),
            factors,
        };
        problem.hold_first_of_each_component();
        problem
    }

    fn hold_first_of_each_component(&mut self) {
        let components = self.components();
        self.held = (0..self.poses.len()).map(|k| components[k] == k).collect();
    }

    /// For each pose its variable, counted from 0, and how many there are; poses that are held
    /// or have no factor have none.
    pub(super) fn variables(&self) -> (Vec<Option<usize>>, usize) {
        let mut touched = vec![false; self.poses.len()];
        for factor in &self.factors {
            touched[factor.from] = true;
            touched[factor.to] = true;
        }
        let mut count = 0;
        let mut next = |free: bool| {
            count += usize::from(free);
            free.then(|| count - 1)
        };
        let poses = touched.iter().zip(&self.held);
        let variable = poses.map(|(&touched, &held)| next(touched && !held));
        (variable.collect(), count)
    }

    /// For each pose the first pose of its component.
    pub(super) fn components(&self) -> Vec<usize> {
        let mut parent: Vec<usize> = (0..self.poses.len()).collect();
        for factor in &self.factors {
            let (a, b) = (root(&mut parent, factor.from), root(&mut parent, factor.to));
            // The smaller place becomes the root, so that roots are first poses.
            parent[a.max(b)] = a.min(b);
        }
        (0..parent.len()).map(|k| root(&mut parent, k)).collect()
    }

    /// Σ weight · eᵀΩe.
    pub(super) fn cost_at(&self, poses: &[Pose2]) -> f64 {
        let factors = self.factors.iter();
        factors
            .map(|factor| factor.weight * factor.cost(poses))
            .sum()
    }
}

fn root(parent: &mut [usize], mut k: usize) -> usize {
    while parent[k] != k {
        parent[k] = parent[parent[k]];
        k = parent[k];
    }
    k
}
