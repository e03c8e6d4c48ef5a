//! Touched blocks and regions against whole solves.

use super::super::solve;
use super::super::testing::{add_closure, random_graph};
use super::*;
use crate::geometry::Information;
use crate::geometry::wrap_angle;
use crate::graph::{Edge, EdgeKind, EdgeStatus, Node};
use crate::ids::NodeId;
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

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
    let blocks = graph.blocks();
    let largest = blocks.iter().max_by_key(|b| b.edges.len()).unwrap().clone();
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

fn jolt(rng: &mut ChaCha8Rng, sigma_m: f64) -> Pose2 {
    let mut noise = || (rng.random::<f64>() - 0.5) * 3.4 * sigma_m;
    Pose2::new(noise(), noise(), noise() * 0.3)
}

/// A vehicle that drives laps of a round street, and is told where it is by closures to the lap
/// before. Calls back after each solve.
fn drive_laps(
    seed: u64,
    nodes_per_lap: usize,
    nodes: usize,
    mut after: impl FnMut(&PoseGraph, &TouchedSummary),
) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut solver = Solver::new();
    let mut graph = PoseGraph::new();
    let turn = std::f64::consts::TAU / nodes_per_lap as f64;
    let mut truth = Pose2::new(3.0, -2.0, 0.4);
    let mut truths: Vec<Pose2> = Vec::new();
    let information = Information::from_sigmas(0.02, 0.004);
    let mut tie = |graph: &mut PoseGraph, from: usize, to: usize, measurement, kind| {
        let id = EdgeId(graph.edges().len() as i64);
        graph
            .add_edge(Edge {
                id,
                from: NodeId(from as i64),
                to: NodeId(to as i64),
                measurement,
                information,
                kind,
                status: EdgeStatus::Active,
            })
            .unwrap();
        id
    };
    for k in 0..nodes {
        let id = NodeId(k as i64);
        let motion = Pose2::new(1.0, 0.0, turn).compose(&jolt(&mut rng, 0.02));
        let before = graph
            .nodes()
            .last()
            .map_or(truth, |node| node.pose.compose(&motion));
        graph.add_node(Node { id, pose: before }).unwrap();
        truths.push(truth);
        truth = truth.compose(&Pose2::new(1.0, 0.0, turn));
        if k == 0 {
            continue;
        }
        tie(&mut graph, k - 1, k, motion, EdgeKind::Odometry);
        for back in [0, 2] {
            let Some(old) = k.checked_sub(nodes_per_lap + back) else {
                continue;
            };
            let seen = truths[old].between(&truths[k]);
            let seen = seen.compose(&jolt(&mut rng, 0.02));
            let id = tie(&mut graph, old, k, seen, EdgeKind::LoopClosure);
            let touched = solver.solve_touched(&mut graph, &[id], &SolveOptions::default());
            after(&graph, &touched);
        }
    }
}

/// How far F is above its optimum, as a part of it.
fn gap(graph: &PoseGraph) -> f64 {
    let mut optimal = graph.clone();
    let tight = SolveOptions {
        cost_tolerance: 1e-14,
        ..SolveOptions::default()
    };
    assert!(solve(&mut optimal, &tight).termination.is_converged());
    graph.cost() / optimal.cost() - 1.0
}

#[test]
fn laps_of_a_long_street_stay_at_the_optimum() {
    let mut cost = 0.0;
    let mut worst: f64 = 0.0;
    let mut count = 0;
    let (mut regions, mut largest) = (0, 0);
    drive_laps(5, 900, 2400, |graph, touched| {
        count += 1;
        assert!(touched.summary.termination.is_converged());
        let cost_now = graph.cost();
        assert!((touched.delta_f - (cost_now - cost)).abs() < 1e-9 * (1.0 + cost_now));
        cost = cost_now;
        let block = graph
            .blocks()
            .iter()
            .max_by_key(|block| block.nodes.len())
            .unwrap();
        let standing = &block.standing;
        assert!(standing.solved && standing.fresh.is_empty());
        assert!((standing.cost / cost - 1.0).abs() < 1e-9);
        let part = touched.summary.initial_cost < 0.5 * cost;
        regions += usize::from(part);
        largest = largest.max(block.nodes.len());
        if count % 37 == 0 {
            let gap = gap(graph);
            worst = worst.max(gap);
            eprintln!(
                "{count} F {cost:.3} gap {gap:.2e} bound {:.2e} moved {} part {part}",
                standing.gap_max / cost,
                touched.moved.len()
            );
            assert!(
                gap <= standing.gap_max / cost + 1e-9,
                "{gap} {}",
                standing.gap_max / cost
            );
        }
    });
    eprintln!("worst {worst:.2e}; {regions} of {count} by regions, block {largest}");
    assert!(worst < 1e-6);
}
