//! Solving a simulated drive over a grid of streets, and M3500 where `MAPSHIFT_DATA` is set.
//!
//! A warm iteration is the difference between three and two iterations from the odometry.

// Clippy lets tests unwrap, and not yet benches.
#![allow(clippy::unwrap_used, missing_docs)]

use std::fs::File;
use std::hint::black_box;
use std::io::Read;
use std::path::Path;

use criterion::{BatchSize, Criterion, criterion_group, criterion_main};
use flate2::read::GzDecoder;
use mapshift::geometry::{Information, Pose2, Vector3};
use mapshift::graph::{Edge, EdgeKind, EdgeStatus, Node, PoseGraph};
use mapshift::ids::{EdgeId, NodeId};
use mapshift::ingest::g2o::read_g2o;
use mapshift::solver::{SolveOptions, Solver, solve, start_along_odometry};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const NODES: usize = 3500;
/// Corners along a side of the town.
const SIDE: i64 = 40;

/// A drive at random from corner to corner, with a closure wherever it comes by a corner again.
fn town() -> PoseGraph {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut graph = PoseGraph::new();
    let mut seen = std::collections::BTreeMap::<(i64, i64), (NodeId, Pose2)>::new();
    let (mut corner, mut truth) = ((SIDE / 2, SIDE / 2), Pose2::IDENTITY);
    for k in 0..NODES {
        let id = NodeId(k as i64);
        if k == 0 {
            graph.add_node(Node { id, pose: truth }).unwrap();
        }
        if let Some(&(before, pose)) = seen.get(&corner) {
            let motion = pose.between(&truth);
            add_edge(
                &mut graph,
                &mut rng,
                before,
                id,
                motion,
                EdgeKind::LoopClosure,
            );
        }
        seen.insert(corner, (id, truth));
        if k + 1 == NODES {
            break;
        }
        let quarter = loop {
            let quarter = rng.random_range(0..4);
            let (dx, dy) = direction(quarter);
            let next = (corner.0 + dx, corner.1 + dy);
            if (0..SIDE).contains(&next.0) && (0..SIDE).contains(&next.1) {
                corner = next;
                break quarter;
            }
        };
        let (dx, dy) = direction(quarter);
        let theta = quarter as f64 * std::f64::consts::FRAC_PI_2;
        let next = Pose2::new(truth.x + dx as f64, truth.y + dy as f64, theta);
        let to = NodeId(k as i64 + 1);
        graph.add_node(Node { id: to, pose: next }).unwrap();
        add_edge(
            &mut graph,
            &mut rng,
            id,
            to,
            truth.between(&next),
            EdgeKind::Odometry,
        );
        truth = next;
    }
    graph
}

fn direction(quarter: i32) -> (i64, i64) {
    [(1, 0), (0, 1), (-1, 0), (0, -1)][quarter as usize % 4]
}

fn add_edge(
    graph: &mut PoseGraph,
    rng: &mut ChaCha8Rng,
    from: NodeId,
    to: NodeId,
    motion: Pose2,
    kind: EdgeKind,
) {
    let mut noise = || (rng.random::<f64>() - 0.5) * 0.1;
    let noise = Vector3::new(noise(), noise(), noise());
    graph
        .add_edge(Edge {
            id: EdgeId(graph.edges().len() as i64),
            from,
            to,
            measurement: motion.compose(&Pose2::exp(&noise)),
            information: Information::from_sigmas(0.03, 0.03),
            kind,
            status: EdgeStatus::Active,
        })
        .unwrap();
}

fn batch(criterion: &mut Criterion, name: &str, mut graph: PoseGraph) {
    start_along_odometry(&mut graph);
    let mut group = criterion.benchmark_group(name);
    for iterations_max in [2, 3] {
        let options = SolveOptions {
            iterations_max,
            ..SolveOptions::default()
        };
        group.bench_function(format!("{iterations_max}_iterations"), |bencher| {
            bencher.iter_batched_ref(
                || graph.clone(),
                |graph| black_box(solve(graph, &options)),
                BatchSize::LargeInput,
            );
        });
    }
    group.finish();
}

/// The last closure of a graph that is at its optimum without it, by a solver that knows the rest.
fn closure(criterion: &mut Criterion, name: &str, whole: &PoseGraph) {
    let options = SolveOptions::default();
    let edges = whole.edges();
    let is_closure = |edge: &&Edge| edge.kind == EdgeKind::LoopClosure;
    let last = *edges.iter().rev().find(is_closure).unwrap();
    let mut before = PoseGraph::new();
    for node in whole.nodes() {
        before.add_node(*node).unwrap();
    }
    for edge in edges.iter().filter(|edge| edge.id != last.id) {
        before.add_edge(*edge).unwrap();
    }
    let known: Vec<EdgeId> = before.edges().iter().map(|edge| edge.id).collect();
    criterion.bench_function(&format!("{name}/closure"), |bencher| {
        bencher.iter_batched_ref(
            || {
                let (mut graph, mut solver) = (before.clone(), Solver::new());
                solver.solve_touched(&mut graph, &known, &options);
                graph.add_edge(last).unwrap();
                (graph, solver)
            },
            |(graph, solver)| black_box(solver.solve_touched(graph, &[last.id], &options)),
            BatchSize::LargeInput,
        );
    });
}

fn benches(criterion: &mut Criterion) {
    let town = town();
    batch(criterion, "town", town.clone());
    closure(criterion, "town", &town);
    if let Some(data) = std::env::var_os("MAPSHIFT_DATA") {
        let file = File::open(Path::new(&data).join("graphs/M3500.g2o.gz"));
        if let Ok(file) = file {
            let mut text = String::new();
            GzDecoder::new(file).read_to_string(&mut text).unwrap();
            let graph = read_g2o(&text).unwrap().graph;
            batch(criterion, "M3500", graph.clone());
            closure(criterion, "M3500", &graph);
        }
    }
}

criterion_group!(solver, benches);
criterion_main!(solver);
