//! A solve that identifies false closures.
//!
//! Graduated non-convexity for truncated least squares (Yang et al., *Graduated Non-Convexity
//! for Robust Spatial Perception*, 2020): odometry is trusted, each loop closure has a weight
//! that goes from "all count" to "on or off" while the poses follow. Closures are often noisier
//! than their information says, so their scale is then estimated by the median of their errors,
//! which up to half of them may spoil, and those within the scaled bound are let in again.

use super::chordal::chordal_poses;
use super::solve::publish;
use super::spanning::start_along_odometry;
use crate::graph::{EdgeKind, EdgeStatus, PoseGraph};
use crate::ids::EdgeId;
use crate::solver::least_squares::{Minimiser, Problem, SolveOptions, SolveSummary, Termination};

/// The 99 % point of χ² with three degrees of freedom: what a true closure's eᵀΩe stays below.
const INLIER_COST: f64 = 11.345;
/// The median of χ² with three degrees of freedom.
const MEDIAN_COST: f64 = 2.366;
/// How fast the surrogate turns from convex to truncated.
const GRADUATION: f64 = 1.4;
const GRADUATIONS_MAX: usize = 100;
const READMISSIONS_MAX: usize = 10;
/// Between graduations the poses need only follow.
const FOLLOWING: SolveOptions = SolveOptions {
    iterations_max: 20,
    cost_tolerance: 1e-6,
    step_tolerance: 1e-6,
};

/// The result of a robust solve.
#[derive(Debug, Clone, PartialEq)]
pub struct RobustSummary {
    /// The initial cost is over all active edges at the given poses, the final cost over those
    /// that were kept; iterations are those of all graduations.
    pub summary: SolveSummary,
    /// Loop closures that contradict the rest, in the graph's order. Their status in the graph
    /// is left alone.
    pub switched_off: Vec<EdgeId>,
    /// By how much the closures' eᵀΩe exceeds what their information says, at least 1: the
    /// bound for switching off was the 99 % point of χ²₃ times this.
    pub noise_scale: f64,
}

/// Solves a graph some of whose loop closures are false. The given poses do not matter but for
/// each component's first: the start is along the odometry. Tries at most 113 graduations and
/// readmissions of at most 20 iterations each, and one last solve with the options.
///
/// Nothing moves if the poses that were found are worse than the given ones for the edges that
/// were kept.
pub fn solve_robust(graph: &mut PoseGraph, options: &SolveOptions) -> RobustSummary {
    let given = Problem::of_graph(graph);
    let active = graph.edges().iter();
    let active: Vec<_> = active.filter(|e| e.status == EdgeStatus::Active).collect();
    let is_closure = |k: &usize| active[*k].kind == EdgeKind::LoopClosure;
    let mut search = Search {
        problem: given.clone(),
        closures: (0..active.len()).filter(is_closure).collect(),
        minimiser: Minimiser::default(),
        iterations: 0,
    };
    search.find_start(graph);
    let noise_scale = search.readmit();
    let last = search.minimiser.minimise(&mut search.problem, options);

    let problem = &search.problem;
    let off = search
        .closures
        .iter()
        .filter(|&&k| problem.factors[k].weight == 0.0);
    let switched_off = off.map(|&k| active[k].id).collect();
    let moved = last.final_cost < problem.cost_at(&given.poses);
    let summary = SolveSummary {
        initial_cost: given.cost_at(&given.poses),
        final_cost: if moved {
            last.final_cost
        } else {
            problem.cost_at(&given.poses)
        },
        iterations: search.iterations + last.iterations,
        termination: if moved || last.termination.is_converged() {
            last.termination
        } else {
            Termination::NoProgress
        },
        moved,
    };
    if moved {
        publish(graph, &problem.poses);
    }
    RobustSummary {
        summary,
        switched_off,
        noise_scale,
    }
}

struct Search {
    problem: Problem,
    /// The places of the loop closures among the factors.
    closures: Vec<usize>,
    minimiser: Minimiser,
    iterations: usize,
}

impl Search {
    fn closure_costs(&self) -> Vec<f64> {
        let cost = |&k: &usize| self.problem.factors[k].cost(&self.problem.poses);
        self.closures.iter().map(cost).collect()
    }

    fn follow(&mut self) {
        let summary = self.minimiser.minimise(&mut self.problem, &FOLLOWING);
        self.iterations += summary.iterations;
    }

    /// Graduates along the odometry, unless believing every closure at first ends better:
    /// where none is false that is so, and long odometry misleads.
    fn find_start(&mut self, graph: &PoseGraph) {
        let chordal = chordal_poses(&self.problem);
        let mut along_odometry = graph.clone();
        start_along_odometry(&mut along_odometry);
        let nodes = along_odometry.nodes().iter();
        self.problem.poses = nodes.map(|node| node.pose).collect();
        self.graduate();
        let Some(chordal) = chordal else {
            return;
        };
        let graduated = self.problem.clone();
        self.problem.poses = chordal;
        self.weigh(|_| 1.0);
        self.follow();
        self.truncate(INLIER_COST);
        if self.truncated_cost(&graduated) < self.truncated_cost(&self.problem) {
            self.problem = graduated;
        }
    }

    /// The cost with every closure's part bounded, for weights that are 0 or 1.
    fn truncated_cost(&self, problem: &Problem) -> f64 {
        let off = |k: &&usize| problem.factors[**k].weight == 0.0;
        let bounded = self.closures.iter().filter(off).count() as f64 * INLIER_COST;
        problem.cost_at(&problem.poses) + bounded
    }

    /// Switches every closure off or on by a bound.
    fn truncate(&mut self, bound: f64) {
        self.weigh(|cost| f64::from(u8::from(cost <= bound)));
        self.follow();
    }

    /// Ends with every closure's weight 0 or 1.
    fn graduate(&mut self) {
        let largest = self.closure_costs().into_iter().fold(0.0, f64::max);
        // Below this bound the surrogate is the truncated cost itself.
        if largest > INLIER_COST {
            let mut mu = INLIER_COST / (2.0 * largest - INLIER_COST);
            for _ in 0..GRADUATIONS_MAX {
                let undecided = self.weigh(|cost| surrogate_weight(cost, mu));
                self.follow();
                if !undecided {
                    break;
                }
                mu *= GRADUATION;
            }
        }
        self.truncate(INLIER_COST);
    }

    /// Estimates the closures' scale and lets in those within the scaled bound, until none
    /// changes; returns the scale.
    fn readmit(&mut self) -> f64 {
        let mut costs = self.closure_costs();
        costs.sort_by(f64::total_cmp);
        let median = costs.get(costs.len() / 2).copied().unwrap_or_default();
        let scale = (median / MEDIAN_COST).max(1.0);
        for _ in 0..READMISSIONS_MAX {
            let before = self.weights();
            self.truncate(INLIER_COST * scale);
            if self.weights() == before {
                break;
            }
        }
        scale
    }

    fn weights(&self) -> Vec<f64> {
        let weight = |&k: &usize| self.problem.factors[k].weight;
        self.closures.iter().map(weight).collect()
    }

    /// Sets the closures' weights by their costs; whether any is neither off nor on.
    fn weigh(&mut self, weight_of: impl Fn(f64) -> f64) -> bool {
        let mut undecided = false;
        for &k in &self.closures {
            let factor = &mut self.problem.factors[k];
            factor.weight = weight_of(factor.cost(&self.problem.poses));
            undecided |= factor.weight > 0.0 && factor.weight < 1.0;
        }
        undecided
    }
}

/// The weight of a closure under the graduated truncated cost (equation 14 there).
fn surrogate_weight(cost: f64, mu: f64) -> f64 {
    if cost <= mu / (mu + 1.0) * INLIER_COST {
        1.0
    } else if cost >= (mu + 1.0) / mu * INLIER_COST {
        0.0
    } else {
        (INLIER_COST * mu * (mu + 1.0) / cost).sqrt() - mu
    }
}
