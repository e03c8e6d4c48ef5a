//! Solves pose graphs from odometry and prints one JSON line a graph.
//!
//! `cargo run --release --example bench_graphs -- [--rounds N] [--optimum F] GRAPH…` finds the
//! iteration at which F ≤ F*(1 + 10⁻⁴), and prints the time to each iteration, best of the rounds.
//! `cargo run --release --example bench_graphs -- --each-closure [--check-every N]
//! [--tolerance PART] GRAPH…` feeds the poses one at a time, solves again after each that closes
//! a loop, and prints the total, the mean, the 99 % point and the worst time. A solve stops once
//! a step promises less than PART of F. Every Nth optimum is compared with that of a solve of
//! the whole graph.
//!
//! Times are milliseconds of the process's processor time; reading and building graphs is not in
//! them. GRAPH is g2o text whose node ids are 0, 1, … along the drive.
#![allow(clippy::print_stdout)]

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, bail};
use mapshift::geometry::Pose2;
use mapshift::graph::{Edge, EdgeKind, Node, PoseGraph};
use mapshift::ingest::g2o::read_g2o;
use mapshift::solver::{SolveOptions, Solver, solve, start_along_odometry};
use serde_json::json;

const USAGE: &str = "usage: bench_graphs [--rounds N] [--optimum F] [--each-closure] \
                     [--check-every N] [--tolerance PART] GRAPH…";
/// A solve has arrived once F is this part above the optimum.
const ARRIVED: f64 = 1e-4;
const TIGHT: SolveOptions = SolveOptions {
    iterations_max: 100,
    cost_tolerance: 1e-14,
    step_tolerance: 1e-12,
};

struct Arguments {
    rounds: usize,
    optimum: Option<f64>,
    each_closure: bool,
    check_every: Option<usize>,
    cost_tolerance: f64,
    graphs: Vec<PathBuf>,
}

fn main() -> anyhow::Result<()> {
    let arguments = parse()?;
    for path in &arguments.graphs {
        let text = std::fs::read_to_string(path)
            .with_context(|| format!("cannot read {}", path.display()))?;
        let mut graph = read_g2o(&text)?.graph;
        drop(text);
        start_along_odometry(&mut graph);
        let name = path.file_name().unwrap_or(path.as_os_str());
        let name = name.to_string_lossy();
        let line = if arguments.each_closure {
            each_closure(&name, &graph, &arguments)?
        } else {
            batch(&name, &mut graph, &arguments)
        };
        println!("{line}");
    }
    Ok(())
}

fn parse() -> anyhow::Result<Arguments> {
    let mut arguments = Arguments {
        rounds: 9,
        optimum: None,
        each_closure: false,
        check_every: None,
        cost_tolerance: SolveOptions::default().cost_tolerance,
        graphs: Vec::new(),
    };
    let mut words = std::env::args().skip(1);
    while let Some(word) = words.next() {
        match word.as_str() {
            "--rounds" => arguments.rounds = words.next().context(USAGE)?.parse()?,
            "--optimum" => arguments.optimum = Some(words.next().context(USAGE)?.parse()?),
            "--tolerance" => {
                arguments.cost_tolerance = words.next().context(USAGE)?.parse()?;
            }
            "--each-closure" => arguments.each_closure = true,
            "--check-every" => {
                arguments.check_every = Some(words.next().context(USAGE)?.parse()?);
            }
            _ => arguments.graphs.push(PathBuf::from(word)),
        }
    }
    if arguments.graphs.is_empty() {
        bail!(USAGE);
    }
    Ok(arguments)
}

/// From the odometry to F*.
fn batch(name: &str, graph: &mut PoseGraph, arguments: &Arguments) -> serde_json::Value {
    let start: Vec<Pose2> = graph.nodes().iter().map(|node| node.pose).collect();
    let (n, m) = (graph.nodes().len(), graph.edges().len());
    let mut solve_from_start = |options: &SolveOptions| {
        for (position, pose) in start.iter().enumerate() {
            graph.set_pose_at(position, *pose);
        }
        let begin = processor_ms();
        let cost = solve(graph, options).final_cost;
        (processor_ms() - begin, cost)
    };
    let optimum = arguments
        .optimum
        .unwrap_or_else(|| solve_from_start(&TIGHT).1);
    let bound = optimum * (1.0 + ARRIVED);
    let (mut best_ms, mut costs) = (Vec::new(), Vec::new());
    for iterations in 1..=TIGHT.iterations_max {
        let options = SolveOptions {
            iterations_max: iterations,
            ..SolveOptions::default()
        };
        let rounds: Vec<_> = (0..arguments.rounds.max(1))
            .map(|_| solve_from_start(&options))
            .collect();
        let cost = rounds[0].1;
        best_ms.push(rounds.iter().map(|r| r.0).fold(f64::INFINITY, f64::min));
        costs.push(cost);
        if cost <= bound {
            break;
        }
    }
    let last = best_ms.len() - 1;
    json!({
        "solver": "mapshift", "graph": name,
        "n": n, "m": m,
        "iterations": best_ms.len(), "total_ms": best_ms[last],
        "iteration_ms": (best_ms[last] - best_ms[0]) / last.max(1) as f64,
        "cum_ms": best_ms, "cost": costs, "rss_peak_mb": peak_rss_mb(),
    })
}

/// Poses one at a time, solved again after each that closes a loop.
fn each_closure(
    name: &str,
    whole: &PoseGraph,
    arguments: &Arguments,
) -> anyhow::Result<serde_json::Value> {
    let mut edges = whole.edges().to_vec();
    edges.sort_by_key(|edge| (edge.from.max(edge.to), edge.kind == EdgeKind::LoopClosure));
    let mut graph = PoseGraph::new();
    let first = whole.nodes().first().context("the graph has no nodes")?;
    graph.add_node(*first)?;
    let mut solver = Solver::new();
    let options = SolveOptions {
        cost_tolerance: arguments.cost_tolerance,
        ..SolveOptions::default()
    };
    let (mut times_ms, mut largest_gap, mut iterations) = (Vec::new(), 0.0_f64, 0);
    for reached in edges.chunk_by(|a, b| a.from.max(a.to) == b.from.max(b.to)) {
        let closures = add_reached(&mut graph, reached)?;
        if closures.is_empty() {
            continue;
        }
        let start = processor_ms();
        let touched = solver.solve_touched(&mut graph, &closures, &options);
        times_ms.push(processor_ms() - start);
        iterations += touched.summary.iterations;
        if arguments
            .check_every
            .is_some_and(|every| times_ms.len() % every == 0)
        {
            let cost = graph.cost();
            let exact = solve(&mut graph.clone(), &TIGHT).final_cost;
            // Below this cost the closures agree to within rounding.
            largest_gap = largest_gap.max((cost - exact) / exact.max(1e-9));
        }
    }
    let final_cost = graph.cost();
    let total: f64 = times_ms.iter().sum();
    let count = times_ms.len();
    times_ms.sort_by(f64::total_cmp);
    let at = |part: f64| times_ms.get((count as f64 * part) as usize).copied();
    Ok(json!({
        "solver": "mapshift", "graph": name, "closures": count,
        "total_s": total * 1e-3, "mean_ms": total / count.max(1) as f64,
        "p50_ms": at(0.5), "p99_ms": at(0.99), "worst_ms": times_ms.last(),
        "iterations": iterations, "final_cost": final_cost,
        "largest_gap": arguments.check_every.map(|_| largest_gap),
        "rss_peak_mb": peak_rss_mb(),
    }))
}

/// Adds the next pose with its edges; the ids of those that close a loop.
fn add_reached(
    graph: &mut PoseGraph,
    reached: &[Edge],
) -> anyhow::Result<Vec<mapshift::ids::EdgeId>> {
    let mut closures = Vec::new();
    for edge in reached {
        let (from, to) = (graph.node(edge.from).copied(), graph.node(edge.to).copied());
        let (id, pose) = match (from, to) {
            (Some(from), None) => (edge.to, from.pose.compose(&edge.measurement)),
            (None, Some(to)) => (edge.from, to.pose.compose(&edge.measurement.inverse())),
            (Some(_), Some(_)) => {
                closures.push(edge.id);
                graph.add_edge(*edge)?;
                continue;
            }
            (None, None) => bail!("edge {} joins two poses that come later", edge.id),
        };
        graph.add_node(Node { id, pose })?;
        graph.add_edge(*edge)?;
    }
    Ok(closures)
}

/// What the process has computed so far. To yield makes the scheduler bring its books up to
/// date. The time of the clock on the wall where the system keeps no such books.
fn processor_ms() -> f64 {
    static START: std::sync::OnceLock<Instant> = std::sync::OnceLock::new();
    let start = START.get_or_init(Instant::now);
    std::thread::yield_now();
    let nanoseconds = std::fs::read_to_string("/proc/self/schedstat")
        .ok()
        .and_then(|text| text.split(' ').next()?.parse::<f64>().ok());
    nanoseconds.map_or_else(|| start.elapsed().as_secs_f64() * 1e3, |ns| ns * 1e-6)
}

/// The most memory that the process has had at a time; nothing where the system does not tell.
fn peak_rss_mb() -> Option<f64> {
    let status = std::fs::read_to_string(Path::new("/proc/self/status")).ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM:"))?;
    let kilobytes: f64 = line.split_ascii_whitespace().nth(1)?.parse().ok()?;
    Some(kilobytes / 1024.0)
}
