//! A large block's optimum from a solve of the part around what is new.
//!
//! The part is a region around the new edges, with the rest held. What that leaves is bounded
//! (`error_bound.rs`), and the bounds of all such solves are kept with the block: one after the
//! other they may not come to more than is allowed, or else the block is solved whole. Where a
//! block is one dense town, what a closure changes falls off with the square of the distance and
//! not faster, so that small regions suffice only in blocks whose F is that of very many closures.

use nalgebra::Vector3;

use super::error_bound::{Strains, least_strains};
use super::region::Region;
use crate::geometry::Pose2;
use crate::graph::{BlockIndex, PoseGraph, Standing};
use crate::solver::least_squares::{
    Minimiser, Problem, SolveOptions, SolveSummary, factor_of_edge,
};

/// Every next region that is tried has so many times as many nodes.
const GROWTH: usize = 4;
/// A region is at most this part of its block.
const SHARE: usize = 4;
/// One region may leave this part of what all together may.
const GAP_OF_ONE: f64 = 0.1;
/// An error that costs less than this part of a block is no reason to move anything.
const NEGLIGIBLE: f64 = 1e-16;

/// When a part will do.
pub(super) struct Limits {
    /// Blocks of no more nodes are solved whole: that costs no more than the search for a region
    /// that suffices.
    pub(super) large_nodes: usize,
    /// The size of the first region that is tried.
    pub(super) region_nodes: usize,
    /// A block's share of F is never more than this part of it above its optimum.
    pub(super) gap_max: f64,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            large_nodes: 20_000,
            region_nodes: 300,
            // Half of what is promised: the bound is exact to second order only.
            gap_max: 5e-7,
        }
    }
}

/// What a solve in a block came to.
pub(super) struct Solved {
    pub(super) summary: SolveSummary,
    pub(super) delta_f: f64,
    /// What was solved, at its optimum.
    pub(super) problem: Problem,
    pub(super) news: News,
}

/// What is known of a block after a solve.
pub(super) enum News {
    /// All of it was solved.
    Whole(Standing),
    /// Nothing is fresh any more, and some edges have these strains.
    Part {
        cost: f64,
        gap_max: f64,
        strains: Vec<(usize, Vector3<f64>)>,
    },
}

impl News {
    pub(super) fn tell(self, standing: &mut Standing) {
        match self {
            Self::Whole(whole) => *standing = whole,
            Self::Part {
                cost,
                gap_max,
                strains,
            } => {
                standing.fresh.clear();
                standing.cost = cost;
                standing.gap_max = gap_max;
                standing.strains.extend(strains);
            }
        }
    }
}

/// Edges that came into a block since it was solved, and whose errors are next to nothing, need no
/// solve: their errors become strains. New nodes come in by such edges.
pub(super) fn settle_fresh(graph: &mut PoseGraph, index: BlockIndex, touched: &[usize]) {
    let Some(block) = graph.blocks().get(index) else {
        return;
    };
    let negligible = NEGLIGIBLE * block.standing.cost;
    let settles = |edge: &usize| !touched.contains(edge) && cost_of(graph, &[*edge]) <= negligible;
    let fresh = block.standing.fresh.iter().copied();
    let (settled, fresh): (Vec<usize>, Vec<usize>) = fresh.partition(settles);
    let cost = cost_of(graph, &settled);
    let error = |&edge: &usize| Some((edge, graph.error_of(&graph.edges()[edge])?));
    let strains: Vec<_> = settled.iter().filter_map(error).collect();
    if let Some(standing) = graph.standing_mut(index) {
        standing.fresh = fresh;
        standing.strains.extend(strains);
        standing.gap_max += cost;
        standing.cost += cost;
    }
}

/// Solves a region around the touched and fresh edges of a block that was at its optimum before,
/// and a larger one as long as too much is left. `None` if nothing less than the whole block will
/// do.
pub(super) fn solve_part(
    minimiser: &mut Minimiser,
    graph: &PoseGraph,
    index: BlockIndex,
    touched: &[usize],
    options: &SolveOptions,
    limits: &Limits,
) -> Option<Solved> {
    let block = graph.blocks().get(index)?;
    let standing = &block.standing;
    let mut seeds: Vec<usize> = Vec::new();
    for &edge in touched.iter().chain(&standing.fresh) {
        let (from, to) = graph.ends()[edge];
        seeds.extend([from, to]);
    }
    let cost_of_fresh = cost_of(graph, &standing.fresh);
    let mut start: Vec<Pose2> = Vec::new();
    let mut size = limits.region_nodes;
    while size <= block.nodes.len() / SHARE && seeds.len() <= size {
        let region = Region::around(graph, index, &seeds, size);
        let mut problem = region.problem(graph, block.anchor);
        let initial_cost = problem.cost_at(&problem.poses);
        problem.poses[..start.len()].copy_from_slice(&start);
        let summary = minimiser.minimise(&mut problem, options);
        if !summary.termination.is_converged() {
            return None;
        }
        let change = summary.final_cost - initial_cost;
        let cost = standing.cost + cost_of_fresh + change;
        let strains = least_strains(graph, index, &region, &problem)?;
        if strains.energy > GAP_OF_ONE * limits.gap_max * cost {
            start = region.inside(&problem.poses).to_vec();
            size *= GROWTH;
            continue;
        }
        let gap_max = standing.gap_max + strains.energy - strains.energy_before;
        return (gap_max <= limits.gap_max * cost).then(|| Solved {
            summary: SolveSummary {
                initial_cost,
                moved: true,
                ..summary
            },
            delta_f: change + cost_of(graph, touched),
            news: news(&region, strains, cost, gap_max),
            problem,
        });
    }
    None
}

fn news(region: &Region, strains: Strains, cost: f64, gap_max: f64) -> News {
    News::Part {
        cost,
        gap_max,
        strains: region.edges.iter().copied().zip(strains.of_edges).collect(),
    }
}

/// Σ eᵀΩe over some edges at the graph's poses.
pub(super) fn cost_of(graph: &PoseGraph, edges: &[usize]) -> f64 {
    let cost = |&edge: &usize| {
        let (from, to) = graph.ends()[edge];
        let poses = [from, to].map(|node| graph.nodes()[node].pose);
        factor_of_edge(&graph.edges()[edge], 0, 1).cost(&poses)
    };
    edges.iter().map(cost).sum()
}
