//! Touched blocks against whole solves.

use std::collections::BTreeMap;
use std::f64::consts::FRAC_PI_2;

use super::*;
use crate::geometry::wrap_angle;
use crate::geometry::{Information, Pose2};
use crate::graph::{Edge, EdgeKind, EdgeStatus, Node};
use crate::ids::NodeId;
use crate::solver::testing::{add_closure, random_graph};
use crate::solver::{Termination, solve};
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
    // Not at its optimum on purpose: child blocks must be moved rigidly, not improved.
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

fn jolt(rng: &mut ChaCha8Rng, sigma_m: f64) -> Pose2 {
    let mut noise = || (rng.random::<f64>() - 0.5) * 3.4 * sigma_m;
    Pose2::new(noise(), noise(), noise() * 0.3)
}

/// A vehicle that drives over and over round two loops of streets that cross, eight nodes to a
/// side, and has a closure that states where it is relative to the first node at each place. Calls back
/// after each solve.
fn drive_figure_eight(seed: u64, nodes: usize, mut after: impl FnMut(&PoseGraph, &TouchedSummary)) {
    const SIDE: usize = 8;
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut solver = Solver::new();
    let mut graph = PoseGraph::new();
    let mut truths: Vec<Pose2> = Vec::new();
    let mut first_there: BTreeMap<(i64, i64), usize> = BTreeMap::new();
    let mut truth = Pose2::IDENTITY;
    for k in 0..nodes {
        let turn_rad = match k % (8 * SIDE) / SIDE {
            _ if k % SIDE != SIDE - 1 => 0.0,
            0..4 => FRAC_PI_2,
            _ => -FRAC_PI_2,
        };
        let motion = Pose2::new(1.0, 0.0, turn_rad);
        truths.push(truth);
        if k > 0 {
            let seen = truths[k - 1].between(&truth).compose(&jolt(&mut rng, 0.01));
            let pose = graph.nodes()[k - 1].pose.compose(&seen);
            let id = NodeId(k as i64);
            graph.add_node(Node { id, pose }).unwrap();
            tie(&mut graph, k - 1, k, seen, EdgeKind::Odometry);
        } else {
            let id = NodeId(0);
            graph.add_node(Node { id, pose: truth }).unwrap();
        }
        let cell = (truth.x.round() as i64, truth.y.round() as i64);
        truth = truth.compose(&motion);
        let first = *first_there.entry(cell).or_insert(k);
        if first == k {
            continue;
        }
        let seen = truths[first].between(&truths[k]);
        let seen = seen.compose(&jolt(&mut rng, 0.01));
        let id = tie(&mut graph, first, k, seen, EdgeKind::LoopClosure);
        let touched = solver.solve_touched(&mut graph, &[id], &SolveOptions::default());
        after(&graph, &touched);
    }
}

fn tie(graph: &mut PoseGraph, from: usize, to: usize, seen: Pose2, kind: EdgeKind) -> EdgeId {
    let id = EdgeId(graph.edges().len() as i64);
    let edge = Edge {
        id,
        from: NodeId(from as i64),
        to: NodeId(to as i64),
        measurement: seen,
        information: Information::from_sigmas(0.01, 0.003),
        kind,
        status: EdgeStatus::Active,
    };
    graph.add_edge(edge).unwrap();
    id
}

/// How far F is above its optimum.
fn gap(graph: &PoseGraph) -> f64 {
    let mut optimal = graph.clone();
    let tight = SolveOptions {
        cost_tolerance: 1e-14,
        ..SolveOptions::default()
    };
    assert!(solve(&mut optimal, &tight).termination.is_converged());
    graph.cost() - optimal.cost()
}

/// A block that grows for hundreds of closures is at its optimum after each, though little of it
/// is linearised and factored again.
#[test]
fn a_block_that_grows_stays_at_its_optimum() {
    let mut closures = 0;
    drive_figure_eight(7, 600, |graph, touched| {
        assert!(touched.summary.termination.is_converged());
        closures += 1;
        if closures % 11 == 0 {
            let gap = gap(graph);
            assert!(gap.abs() < 1e-9 * graph.cost(), "{gap}");
        }
    });
    assert!(closures > 400);
}

/// Turned by hand as one rigid body, a block is known again: its errors are the same.
#[test]
fn a_block_that_was_moved_rigidly_is_solved() {
    let mut graph = random_graph(9, 60, 9);
    let mut solver = Solver::new();
    let tight = SolveOptions {
        cost_tolerance: 1e-14,
        ..SolveOptions::default()
    };
    for round in 0..6 {
        let all: Vec<_> = graph.edges().iter().map(|edge| edge.id).collect();
        solver.solve_touched(&mut graph, &all, &tight);
        assert!(gap(&graph).abs() < 1e-9 * graph.cost());
        let motion = Pose2::new(3.0, -20.0, 0.7 + round as f64);
        for node in graph.nodes().to_vec() {
            graph.set_pose(node.id, motion.compose(&node.pose));
        }
        add_closure(&mut graph, round);
    }
}

/// A pose that was set by hand, and an edge that left, are not passed over.
#[test]
fn what_was_done_by_hand_is_solved() {
    let mut graph = random_graph(7, 60, 9);
    let mut solver = Solver::new();
    let options = SolveOptions::default();
    let edges: Vec<EdgeId> = graph.edges().iter().map(|edge| edge.id).collect();
    solver.solve_touched(&mut graph, &edges, &options);
    assert!(gap(&graph).abs() < 1e-9);
    let moved = graph.nodes()[20].id;
    let astray = graph.nodes()[20].pose.compose(&Pose2::new(0.3, 0.1, 0.05));
    graph.set_pose(moved, astray);
    solver.solve_touched(&mut graph, &edges[..1], &options);
    solver.solve_touched(&mut graph, &edges[18..21], &options);
    assert!(gap(&graph).abs() < 1e-9 * graph.cost());
    let closure = graph
        .edges()
        .iter()
        .rfind(|e| e.kind == EdgeKind::LoopClosure);
    let closure = closure.unwrap().id;
    for status in [EdgeStatus::Retired, EdgeStatus::Active] {
        graph.set_edge_status(closure, status);
        solver.solve_touched(&mut graph, &edges, &options);
        assert!(gap(&graph).abs() < 1e-9 * graph.cost());
    }
}
