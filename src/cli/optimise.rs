//! `mapshift optimise`.

use std::io::Write;
use std::path::PathBuf;
use std::time::Instant;

use anyhow::Context;
use serde::Serialize;

use super::graph_file::read_graph;
use crate::graph::{EdgeKind, EdgeStatus, PoseGraph};
use crate::ingest::g2o::write_g2o;
use crate::solver::{
    RobustSummary, SolveOptions, SolveSummary, solve_from_chordal, solve_robust,
    start_along_odometry,
};

/// Arguments of `mapshift optimise`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// A planar pose graph as g2o text (VERTEX_SE2, EDGE_SE2), gzipped or not.
    file: PathBuf,
    /// Trust odometry, and switch off loop closures that contradict the rest.
    #[arg(long)]
    robust: bool,
    /// Write the optimised graph there, without the edges that were switched off.
    #[arg(long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Print one JSON object instead of text.
    #[arg(long)]
    json: bool,
}

/// What the command prints.
#[derive(Debug, Serialize)]
struct Report {
    nodes: usize,
    edges: usize,
    loop_closures: usize,
    initial_cost: f64,
    final_cost: f64,
    iterations: usize,
    termination: &'static str,
    converged: bool,
    /// Time of the solve alone, without files.
    solve_ms: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    robust: Option<RobustReport>,
}

#[derive(Debug, Serialize)]
struct RobustReport {
    noise_scale: f64,
    switched_off: Vec<SwitchedOff>,
}

#[derive(Debug, Serialize)]
struct SwitchedOff {
    /// Which `EDGE_SE2` line, from 0.
    edge: i64,
    from: i64,
    to: i64,
}

/// Runs the command.
///
/// # Errors
/// If a file cannot be read, understood or written.
pub fn run(args: Args) -> anyhow::Result<()> {
    let read = read_graph(&args.file)?;
    let mut graph = read.graph;
    anyhow::ensure!(
        !graph.nodes().is_empty(),
        "{} has no VERTEX_SE2 and no EDGE_SE2 line: there is nothing to optimise",
        args.file.display()
    );
    if !read.without_pose.is_empty() {
        start_along_odometry(&mut graph);
    }
    let report = if args.robust {
        robust(&mut graph)
    } else {
        let start = Instant::now();
        let summary = solve_from_chordal(&mut graph, &SolveOptions::default());
        Report::new(&graph, &summary, start)
    };
    if let Some(output) = &args.output {
        std::fs::write(output, write_g2o(&graph))
            .with_context(|| format!("cannot write {}", output.display()))?;
    }
    print(&report, args.json).context("cannot write to standard output")
}

/// Solves, and quarantines what was switched off.
fn robust(graph: &mut PoseGraph) -> Report {
    let start = Instant::now();
    let RobustSummary {
        summary,
        switched_off,
        noise_scale,
    } = solve_robust(graph, &SolveOptions::default());
    let mut report = Report::new(graph, &summary, start);
    let edges = switched_off.iter().filter_map(|&id| graph.edge(id));
    let switched_off_edges = edges.map(|edge| SwitchedOff {
        edge: edge.id.0,
        from: edge.from.0,
        to: edge.to.0,
    });
    report.robust = Some(RobustReport {
        noise_scale,
        switched_off: switched_off_edges.collect(),
    });
    for id in switched_off {
        graph.set_edge_status(id, EdgeStatus::Quarantined);
    }
    report
}

impl Report {
    fn new(graph: &PoseGraph, summary: &SolveSummary, start: Instant) -> Self {
        let solve_ms = start.elapsed().as_secs_f64() * 1e3;
        let edges = graph.edges();
        let is_closure = |kind| kind == EdgeKind::LoopClosure;
        Self {
            nodes: graph.nodes().len(),
            edges: edges.len(),
            loop_closures: edges.iter().filter(|edge| is_closure(edge.kind)).count(),
            initial_cost: summary.initial_cost,
            final_cost: summary.final_cost,
            iterations: summary.iterations,
            termination: summary.termination.name(),
            converged: summary.termination.is_converged(),
            solve_ms,
            robust: None,
        }
    }
}

fn print(report: &Report, json: bool) -> anyhow::Result<()> {
    let mut out = std::io::stdout().lock();
    if json {
        serde_json::to_writer(&mut out, report)?;
        writeln!(out)?;
        return Ok(());
    }
    let r = report;
    writeln!(
        out,
        "graph         {} nodes, {} edges, {} of them loop closures",
        r.nodes, r.edges, r.loop_closures
    )?;
    writeln!(out, "initial cost  {:.8e}", r.initial_cost)?;
    writeln!(out, "final cost    {:.8e}", r.final_cost)?;
    writeln!(out, "iterations    {} ({})", r.iterations, r.termination)?;
    writeln!(out, "time          {:.1} ms", r.solve_ms)?;
    if let Some(robust) = &r.robust {
        writeln!(
            out,
            "switched off  {} of {} loop closures (noise scale {:.2})",
            robust.switched_off.len(),
            r.loop_closures,
            robust.noise_scale
        )?;
    }
    Ok(())
}
