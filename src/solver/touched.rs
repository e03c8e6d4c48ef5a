//! Only the biconnected blocks that some edges belong to, to the exact optimum.

#[cfg(test)]
mod tests;

use std::collections::BTreeSet;

use nalgebra::Vector3;

use super::complementary::least_strains;
use super::minimise::Minimiser;
use super::problem::{Factor, Problem};
use super::region::Region;
use super::summary::{SolveOptions, SolveSummary, Termination};
use crate::geometry::Pose2;
use crate::graph::{Block, BlockIndex, PoseGraph, Standing};
use crate::ids::{EdgeId, NodeId};

/// Blocks of more nodes are solved around the touched edges first: below, a solve of the whole
/// block costs no more than the search for a region that suffices.
const LARGE_NODES: usize = 1000;
/// So many nodes has the first region that is tried, and so many times as many every next one.
const REGION_NODES_FIRST: usize = 200;
const REGION_GROWTH: usize = 3;
/// A region is at most this part of its block.
const REGION_SHARE: usize = 3;
/// A block's share of F is never further than this part of it above its optimum: half of what is
/// promised, because the bound is exact to second order only. When small gaps have come to this,
/// the whole block is solved.
const GAP_MAX: f64 = 5e-7;
/// What one region may leave.
const REGION_GAP_MAX: f64 = 1e-8;
/// An error that costs less than this part of a block is no reason to move anything.
const NEGLIGIBLE: f64 = 1e-16;

/// A solver that is called again and again on one growing graph, and keeps its memory.
#[derive(Default)]
pub struct Solver {
    whole_blocks: Minimiser,
    regions: Minimiser,
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

impl Solver {
    /// A solver with no memory yet.
    pub fn new() -> Self {
        Self::default()
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
        let mut touched: Vec<usize> = touched
            .iter()
            .filter_map(|&id| graph.edge_position(id))
            .collect();
        touched.sort_unstable();
        touched.dedup();
        let mut total = TouchedSummary {
            summary: SolveSummary::nothing(),
            delta_f: 0.0,
            moved: Vec::new(),
        };
        let mut moved = Vec::new();
        for index in blocks_of(graph, &touched) {
            let Some(solved) = self.solve_block(graph, index, &touched, options) else {
                continue;
            };
            total.delta_f += solved.delta_f;
            total.summary.add(&solved.summary);
            graph.move_with_hanging(solved.poses, &mut moved);
            if let Some(standing) = graph.standing_mut(index) {
                solved.news.tell(standing);
            }
        }
        moved.sort_unstable();
        moved.dedup();
        let nodes = graph.nodes();
        total.moved = moved
            .into_iter()
            .map(|position| nodes[position].id)
            .collect();
        total
    }

    fn solve_block(
        &mut self,
        graph: &mut PoseGraph,
        index: BlockIndex,
        touched: &[usize],
        options: &SolveOptions,
    ) -> Option<Solved> {
        let of_block = |edge: &usize| graph.blocks().of_edge(*edge) == Some(index);
        let touched: Vec<usize> = touched.iter().copied().filter(of_block).collect();
        let block = graph.blocks().get(index)?;
        if block.nodes.len() > LARGE_NODES && block.standing.solved {
            settle_fresh(graph, index, &touched);
            let solved = self.solve_around(graph, index, &touched, options);
            if solved.is_some() {
                return solved;
            }
        }
        self.solve_whole(graph, index, &touched, options)
    }

    fn solve_whole(
        &mut self,
        graph: &PoseGraph,
        index: BlockIndex,
        touched: &[usize],
        options: &SolveOptions,
    ) -> Option<Solved> {
        let (mut problem, nodes) = block_problem(graph, graph.blocks().get(index)?);
        let cost_of_touched = cost_of(graph, touched);
        let summary = self.whole_blocks.minimise(&mut problem, options);
        let standing = if summary.termination.is_converged() {
            Standing::optimal(summary.final_cost)
        } else {
            Standing::unknown()
        };
        // The anchor, first among the nodes, was held.
        let poses = nodes.into_iter().zip(problem.poses).skip(1);
        Some(Solved {
            summary,
            delta_f: summary.final_cost - (summary.initial_cost - cost_of_touched),
            poses: poses.filter(|_| summary.moved).collect(),
            news: News::Whole(standing),
        })
    }

    /// Solves a region around the touched edges in a block that was at its optimum before, with
    /// the rest held, and a larger one as long as the block may be too far from its optimum.
    /// `None` if nothing less than the whole block will do.
    fn solve_around(
        &mut self,
        graph: &PoseGraph,
        index: BlockIndex,
        touched: &[usize],
        options: &SolveOptions,
    ) -> Option<Solved> {
        let block = graph.blocks().get(index)?;
        let standing = &block.standing;
        let mut seeds: Vec<usize> = Vec::new();
        for &edge in touched.iter().chain(&standing.fresh) {
            let (from, to) = graph.ends()[edge];
            seeds.extend([from, to]);
        }
        let mut start: Vec<Pose2> = Vec::new();
        let mut size = REGION_NODES_FIRST;
        while size <= block.nodes.len() / REGION_SHARE && seeds.len() <= size {
            let region = Region::around(graph, index, &seeds, size);
            let mut problem = region.problem(graph, block.anchor);
            let initial_cost = problem.cost_at(&problem.poses);
            problem.poses[..start.len()].copy_from_slice(&start);
            let summary = self.regions.minimise(&mut problem, options);
            if !summary.termination.is_converged() {
                return None;
            }
            let change = summary.final_cost - initial_cost;
            let cost = standing.cost + cost_of(graph, &standing.fresh) + change;
            let strains = least_strains(graph, index, &region, &problem)?;
            let gap_max = standing.gap_max + strains.energy - strains.energy_before;
            if strains.energy <= REGION_GAP_MAX * cost {
                let news = News::Part {
                    cost,
                    gap_max,
                    strains: region.edges.iter().copied().zip(strains.of_edges).collect(),
                };
                return (gap_max <= GAP_MAX * cost).then_some(Solved {
                    summary: SolveSummary {
                        initial_cost,
                        moved: true,
                        ..summary
                    },
                    delta_f: change + cost_of(graph, touched),
                    poses: region.nodes.into_iter().zip(problem.poses).collect(),
                    news,
                });
            }
            start = region.inside(&problem.poses).to_vec();
            size *= REGION_GROWTH;
        }
        None
    }
}

/// Edges that came into a block since it was solved, and whose errors are next to nothing, need no
/// solve: their errors become strains. New nodes come in by such edges.
fn settle_fresh(graph: &mut PoseGraph, index: BlockIndex, touched: &[usize]) {
    let Some(block) = graph.blocks().get(index) else {
        return;
    };
    let negligible = NEGLIGIBLE * block.standing.cost;
    let mut settled: Vec<(usize, Vector3<f64>, f64)> = Vec::new();
    let mut fresh = Vec::new();
    for &position in &block.standing.fresh {
        let edge = &graph.edges()[position];
        let cost = cost_of(graph, &[position]);
        match graph.error_of(edge) {
            Some(error) if cost <= negligible && !touched.contains(&position) => {
                settled.push((position, error, cost));
            }
            _ => fresh.push(position),
        }
    }
    if let Some(standing) = graph.standing_mut(index) {
        standing.fresh = fresh;
        for (position, error, cost) in settled {
            standing.strains.insert(position, error);
            standing.gap_max += cost;
            standing.cost += cost;
        }
    }
}

/// What a solve in a block came to.
struct Solved {
    summary: SolveSummary,
    delta_f: f64,
    /// The places of nodes, and where they are now.
    poses: Vec<(usize, Pose2)>,
    news: News,
}

/// What is known of a block after a solve.
enum News {
    Whole(Standing),
    /// Nothing is fresh any more, and the edges of a region have these strains.
    Part {
        cost: f64,
        gap_max: f64,
        strains: Vec<(usize, Vector3<f64>)>,
    },
}

impl News {
    fn tell(self, standing: &mut Standing) {
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

/// Σ eᵀΩe over some edges at the graph's poses.
fn cost_of(graph: &PoseGraph, edges: &[usize]) -> f64 {
    let cost = |&edge: &usize| {
        let (from, to) = graph.ends()[edge];
        let poses = [from, to].map(|node| graph.nodes()[node].pose);
        Factor::of_edge(&graph.edges()[edge], 0, 1).cost(&poses)
    };
    edges.iter().map(cost).sum()
}

/// The blocks that some edges belong to, by the smallest of these edges.
fn blocks_of(graph: &PoseGraph, touched: &[usize]) -> Vec<BlockIndex> {
    let blocks = graph.blocks();
    let mut seen = BTreeSet::new();
    let indices = touched.iter().filter_map(|&edge| blocks.of_edge(edge));
    indices.filter(|&index| seen.insert(index)).collect()
}

/// A block as a problem, its anchor held, and the places of its poses in the graph. Its nodes and
/// edges are in the graph's order, however the block has grown.
fn block_problem(graph: &PoseGraph, block: &Block) -> (Problem, Vec<usize>) {
    let mut edges = block.edges.clone();
    edges.sort_unstable();
    let mut nodes = Vec::with_capacity(block.nodes.len() + 1);
    nodes.push(block.anchor);
    nodes.extend_from_slice(&block.nodes);
    nodes[1..].sort_unstable();
    let local = |node: usize| {
        if node == block.anchor {
            0
        } else {
            1 + nodes[1..].partition_point(|&n| n < node)
        }
    };
    let factors = edges.iter().map(|&edge| {
        let (from, to) = graph.ends()[edge];
        Factor::of_edge(&graph.edges()[edge], local(from), local(to))
    });
    let problem = Problem {
        factors: factors.collect(),
        poses: nodes.iter().map(|&n| graph.nodes()[n].pose).collect(),
        held: (0..nodes.len()).map(|k| k == 0).collect(),
    };
    (problem, nodes)
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
