//! What one more closure costs, in maps from a thousand to a million nodes.
//!
//! `cargo run --release --example bench_network -- [OUT.svg [NODES_MAX [TOWN_NODES_MAX]]]`
//!
//! Two kinds of map, from a seed: *roads*, loops of streets that hang together by bridges and
//! single nodes, so that a map has many small blocks; and *towns*, a grid of streets driven over
//! and over, one block whatever its size. Into each map vehicles drive short trips, node by node,
//! with a closure at every node, as the service takes them in; each closure is timed with its
//! solve. Draws the curves into OUT.svg (log-log).

use std::collections::BTreeMap;
use std::io::Write;
use std::time::Instant;

use anyhow::Context;
use mapshift::geometry::{Information, Pose2};
use mapshift::graph::{Blocks, Edge, EdgeKind, EdgeStatus, Node, PoseGraph};
use mapshift::ids::{EdgeId, NodeId};
use mapshift::render::{Curve, Plot, to_svg};
use mapshift::solver::{SolveOptions, Solver};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const SIGMA_XY_M: f64 = 0.02;
const SIGMA_THETA_RAD: f64 = 0.004;
const TRIPS: usize = 30;
const TRIP_NODES: usize = 20;
/// Trips whose times are not counted: memory is still being warmed.
const TRIPS_WARM: usize = 3;
const SEED: u64 = 20_261_121;

/// Every drive is done so often from the same map, and each closure's best time counts: other
/// processes disturb one round or another, not all.
const ROUNDS: usize = 3;

/// A map with the truth about its nodes, and where vehicles may drive: places of nodes, one after
/// the other along a street.
#[derive(Clone)]
struct World {
    graph: PoseGraph,
    truth: Vec<Pose2>,
    streets: Vec<Vec<usize>>,
    rng: ChaCha8Rng,
}

impl World {
    fn new() -> Self {
        Self {
            graph: PoseGraph::new(),
            truth: Vec::new(),
            streets: Vec::new(),
            rng: ChaCha8Rng::seed_from_u64(SEED),
        }
    }

    fn measured(&mut self, from: usize, to: usize) -> Pose2 {
        let mut noise = |sigma: f64| {
            let sum: f64 = (0..4).map(|_| self.rng.random::<f64>() - 0.5).sum();
            sum * 3.0_f64.sqrt() * sigma
        };
        let noise = Pose2::new(noise(SIGMA_XY_M), noise(SIGMA_XY_M), noise(SIGMA_THETA_RAD));
        self.truth[from].between(&self.truth[to]).compose(&noise)
    }

    /// A node that starts where it truly is.
    fn add_node(&mut self, truth: Pose2) -> anyhow::Result<usize> {
        let place = self.truth.len();
        let id = NodeId(place as i64);
        self.graph.add_node(Node { id, pose: truth })?;
        self.truth.push(truth);
        Ok(place)
    }

    fn edge(&mut self, from: usize, to: usize, kind: EdgeKind) -> Edge {
        Edge {
            id: EdgeId(self.graph.edges().len() as i64),
            from: NodeId(from as i64),
            to: NodeId(to as i64),
            measurement: self.measured(from, to),
            information: Information::from_sigmas(SIGMA_XY_M, SIGMA_THETA_RAD),
            kind,
            status: EdgeStatus::Active,
        }
    }

    fn tie(&mut self, from: usize, to: usize, kind: EdgeKind) -> anyhow::Result<()> {
        let edge = self.edge(from, to, kind);
        Ok(self.graph.add_edge(edge)?)
    }

    /// Loops of streets, each driven twice, that hang on earlier ones by a street driven once or
    /// by a single node.
    fn roads(nodes: usize) -> anyhow::Result<Self> {
        let mut world = Self::new();
        world.add_node(Pose2::IDENTITY)?;
        let mut gate = 0;
        while world.truth.len() < nodes {
            world.add_loop(gate)?;
            let street = world.rng.random_range(0..world.streets.len());
            let along = world.rng.random_range(0..world.streets[street].len());
            gate = world.streets[street][along];
            if world.rng.random::<bool>() {
                for _ in 0..world.rng.random_range(1..12) {
                    let motion = Pose2::new(1.0, 0.0, 0.05);
                    let next = world.add_node(world.truth[gate].compose(&motion))?;
                    world.tie(gate, next, EdgeKind::Odometry)?;
                    gate = next;
                }
            }
        }
        Ok(world)
    }

    fn add_loop(&mut self, gate: usize) -> anyhow::Result<()> {
        let length = self.rng.random_range(30..90);
        let turn = std::f64::consts::TAU / length as f64;
        let (mut at, mut truth) = (gate, self.truth[gate]);
        let mut driven = vec![gate];
        for k in 1..2 * length {
            truth = truth.compose(&Pose2::new(1.0, 0.0, turn));
            let next = self.add_node(truth)?;
            self.tie(at, next, EdgeKind::Odometry)?;
            if k >= length {
                self.tie(driven[k - length], next, EdgeKind::LoopClosure)?;
            }
            driven.push(next);
            at = next;
        }
        driven.truncate(length);
        self.streets.push(driven);
        Ok(())
    }

    /// A drive at random over a grid of streets of ten nodes; every node is tied to the first that
    /// stood at its place, whichever way it looked.
    fn town(nodes: usize) -> anyhow::Result<Self> {
        const STREET_NODES: i64 = 10;
        let blocks = ((nodes as f64 / 80.0).sqrt().ceil() as i64).max(2);
        let mut world = Self::new();
        let mut at = world.add_node(Pose2::IDENTITY)?;
        let mut first_there = BTreeMap::from([((0, 0), at)]);
        let (mut x, mut y, mut heading) = (0_i64, 0_i64, 0_usize);
        let mut street = vec![at];
        while world.truth.len() < nodes {
            if x % STREET_NODES == 0 && y % STREET_NODES == 0 {
                let end = blocks * STREET_NODES;
                heading = world.way_on((x, y), heading, end);
                world.streets.push(std::mem::replace(&mut street, vec![at]));
            }
            let (dx, dy) = [(1, 0), (0, 1), (-1, 0), (0, -1)][heading];
            (x, y) = (x + dx, y + dy);
            let theta = heading as f64 * std::f64::consts::FRAC_PI_2;
            let next = world.add_node(Pose2::new(x as f64, y as f64, theta))?;
            world.tie(at, next, EdgeKind::Odometry)?;
            match first_there.get(&(x, y)) {
                Some(&first) => world.tie(first, next, EdgeKind::LoopClosure)?,
                None => {
                    first_there.insert((x, y), next);
                }
            }
            street.push(next);
            at = next;
        }
        world
            .streets
            .retain(|street| street.len() > STREET_NODES as usize);
        Ok(world)
    }

    /// Left, on or right at a junction, but not off the grid.
    fn way_on(&mut self, (x, y): (i64, i64), heading: usize, end: i64) -> usize {
        loop {
            let next = (heading + [3, 0, 1][self.rng.random_range(0..3)]) % 4;
            let off = [x >= end, y >= end, x <= 0, y <= 0][next];
            if !off {
                return next;
            }
            // In a corner on and one side may both be off; the other side is not.
        }
    }
}

/// What was seen in a map of one size.
#[derive(Default)]
struct Row {
    nodes: usize,
    blocks: usize,
    largest_block: usize,
    pass_ms: f64,
    closures: Vec<Closure>,
    at_first_street: Vec<Closure>,
    new_solver_ms: f64,
    rss_mb: f64,
}

/// What one closure was seen to cost.
struct Closure {
    ms: f64,
    /// How many nodes moved, those of child blocks included.
    moved: usize,
}

/// The same closures as in an earlier round, if there was one, each with its better time.
fn best_of(mut now: Vec<Closure>, before: &[Closure]) -> Vec<Closure> {
    for (now, before) in now.iter_mut().zip(before) {
        now.ms = now.ms.min(before.ms);
    }
    now
}

fn measure(mut world: World) -> anyhow::Result<Row> {
    let options = SolveOptions::default();
    let mut solver = Solver::new();
    let nodes = world.graph.nodes().len();
    let mut anew = Blocks::default();
    let mut pass_ms = f64::INFINITY;
    for _ in 0..ROUNDS {
        let started = Instant::now();
        anew = world.graph.find_blocks();
        pass_ms = pass_ms.min(ms_since(started));
    }
    let (blocks, largest_block) = (
        anew.iter().count(),
        anew.iter()
            .map(|block| block.nodes.len())
            .max()
            .unwrap_or(0),
    );
    drop(anew);
    let all: Vec<EdgeId> = world.graph.edges().iter().map(|edge| edge.id).collect();
    let whole = solver.solve_touched(&mut world.graph, &all, &options);
    anyhow::ensure!(whole.summary.termination.is_converged(), "{whole:?}");
    let mut row = Row {
        nodes,
        blocks,
        largest_block,
        pass_ms,
        rss_mb: rss_mb()?,
        ..Row::default()
    };
    for _ in 0..ROUNDS {
        let mut world = world.clone();
        let mut seen = Vec::new();
        for trip in 0..TRIPS_WARM + TRIPS {
            let street = world.rng.random_range(0..world.streets.len());
            let trip_seen = drive(&mut world, &mut solver, street)?;
            if trip >= TRIPS_WARM {
                seen.extend(trip_seen);
            }
        }
        row.closures = best_of(seen, &row.closures);
        // Everything hangs off the first street.
        let at_first_street = drive(&mut world, &mut solver, 0)?;
        row.at_first_street = best_of(at_first_street, &row.at_first_street);
        row.new_solver_ms = new_solver_ms(&mut world)?;
    }
    Ok(row)
}

/// One more closure by a solver that remembers nothing, as the first of a batch in the service.
fn new_solver_ms(world: &mut World) -> anyhow::Result<f64> {
    let mut closures = world.graph.edges().iter();
    let closure = *closures
        .rfind(|edge| edge.kind == EdgeKind::LoopClosure)
        .context("a drive makes closures")?;
    let id = EdgeId(world.graph.edges().len() as i64);
    world.graph.add_edge(Edge { id, ..closure })?;
    let started = Instant::now();
    Solver::new().solve_touched(&mut world.graph, &[id], &SolveOptions::default());
    Ok(ms_since(started))
}

/// One trip along a street.
fn drive(world: &mut World, solver: &mut Solver, street: usize) -> anyhow::Result<Vec<Closure>> {
    let street = world.streets[street].clone();
    let mut seen = Vec::new();
    let first = world.rng.random_range(0..street.len());
    let mut before: Option<usize> = None;
    for along in 0..TRIP_NODES.min(street.len()) {
        let old = street[(first + along) % street.len()];
        let node = world.add_node(world.truth[old])?;
        let (tie, to) = match before {
            Some(before) => (EdgeKind::Odometry, before),
            None => (EdgeKind::LoopClosure, old),
        };
        let edge = world.edge(to, node, tie);
        let pose = world.graph.nodes()[to].pose.compose(&edge.measurement);
        world.graph.set_pose_at(node, pose);
        world.graph.add_edge(edge)?;
        if before.replace(node).is_none() {
            continue;
        }
        let closure = world.edge(old, node, EdgeKind::LoopClosure);
        let started = Instant::now();
        world.graph.add_edge(closure)?;
        let options = SolveOptions::default();
        let touched = solver.solve_touched(&mut world.graph, &[closure.id], &options);
        let ms = ms_since(started);
        anyhow::ensure!(touched.summary.termination.is_converged(), "{touched:?}");
        seen.push(Closure {
            ms,
            moved: touched.moved.len(),
        });
    }
    Ok(seen)
}

fn ms_since(started: Instant) -> f64 {
    started.elapsed().as_secs_f64() * 1e3
}

fn rss_mb() -> anyhow::Result<f64> {
    let status = std::fs::read_to_string("/proc/self/status")?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    let kib = line.and_then(|line| line.split_whitespace().next());
    Ok(kib.context("no VmRSS")?.parse::<f64>()? / 1024.0)
}

/// The time that a part of the closures does not exceed.
fn quantile_ms(closures: &[Closure], part: f64) -> Option<f64> {
    let mut sorted: Vec<f64> = closures.iter().map(|closure| closure.ms).collect();
    sorted.sort_by(f64::total_cmp);
    let last = sorted.len().checked_sub(1)?;
    Some(sorted[(part * last as f64).round() as usize])
}

fn print(kind: &str, row: &Row) -> anyhow::Result<()> {
    let ms = |part| quantile_ms(&row.closures, part).unwrap_or(f64::NAN);
    let heaviest = row.at_first_street.iter().max_by_key(|c| c.moved);
    let heaviest = heaviest.context("the first street was driven")?;
    let Row {
        nodes,
        blocks,
        largest_block,
        pass_ms,
        new_solver_ms,
        rss_mb,
        ..
    } = row;
    writeln!(
        std::io::stdout(),
        "{kind}: {nodes} nodes, {blocks} blocks, largest {largest_block}; closure ms median {:.3} \
         p99 {:.3} worst {:.3} of {}; at the first street {:.3} ms, moves {}; one pass for blocks \
         {pass_ms:.2} ms, by a new solver {new_solver_ms:.2} ms; RSS {rss_mb:.0} MB",
        ms(0.5),
        ms(0.99),
        ms(1.0),
        row.closures.len(),
        heaviest.ms,
        heaviest.moved,
    )?;
    Ok(())
}

fn curve(
    label: &str,
    colour: &'static str,
    rows: &[Row],
    ms: impl Fn(&Row) -> Option<f64>,
) -> Curve {
    let point = |row: &Row| Some(((row.nodes as f64).log10(), ms(row)?.log10()));
    Curve {
        label: label.to_owned(),
        colour,
        joined: true,
        points: rows.iter().filter_map(point).collect(),
    }
}

fn chart(title: &str, rows: &[Row], last: Curve) -> Plot {
    let part = |part| move |row: &Row| quantile_ms(&row.closures, part);
    Plot {
        title: title.to_owned(),
        x_label: "log10 nodes".to_owned(),
        y_label: "log10 ms".to_owned(),
        curves: vec![
            last,
            curve("worst closure", "#d62728", rows, part(1.0)),
            curve("p99", "#ff7f0e", rows, part(0.99)),
            curve("median closure", "#1f77b4", rows, part(0.5)),
        ],
        guides: Vec::new(),
    }
}

fn main() -> anyhow::Result<()> {
    let mut arguments = std::env::args().skip(1);
    let out = arguments.next();
    let mut limit = |otherwise: usize| arguments.next().map_or(Ok(otherwise), |n| n.parse());
    let (roads_max, town_max) = (limit(1_000_000)?, limit(300_000)?);
    let sizes = |max: usize| {
        let decade = |k: u32| [1, 3].map(|m| m * 10_usize.pow(k));
        let all: Vec<usize> = (3..7).flat_map(decade).filter(|n| *n <= max).collect();
        all
    };
    let mut roads = Vec::new();
    for nodes in sizes(roads_max) {
        roads.push(measure(World::roads(nodes)?)?);
        print("roads", roads.last().context("just measured")?)?;
    }
    let mut towns = Vec::new();
    for nodes in sizes(town_max) {
        towns.push(measure(World::town(nodes)?)?);
        print("town", towns.last().context("just measured")?)?;
    }
    let Some(out) = out else {
        return Ok(());
    };
    let grey = "#777777";
    let pass = curve("one pass for all blocks", grey, &roads, |row| {
        Some(row.pass_ms)
    });
    let new = curve("by a new solver", grey, &towns, |row| {
        Some(row.new_solver_ms)
    });
    let charts = [
        chart("Roads: many blocks", &roads, pass),
        chart("Town: one block", &towns, new),
    ];
    std::fs::write(&out, to_svg(&charts)).with_context(|| out)
}
