//! Real pose graphs to their known optima.

use std::io::Read;
use std::path::PathBuf;

use mapshift::formats::g2o::{G2oGraph, read_g2o};
use mapshift::solver::{SolveOptions, solve, solve_from_chordal, start_along_odometry};

/// (file, F* as several public solvers agree).
const OPTIMA: [(&str, f64); 7] = [
    ("M3500", 137.91295),
    ("M3500b", 2054.7159),
    ("intel", 45.004696),
    ("city10000", 511.98516),
    ("CSAIL", 40.555129),
    ("kitti_00", 98.322012),
    ("MIT", 41.163269),
];

fn data(name: &str) -> Option<PathBuf> {
    let Some(root) = std::env::var_os("MAPSHIFT_DATA") else {
        eprintln!("skipped: MAPSHIFT_DATA is not set");
        return None;
    };
    Some(PathBuf::from(root).join("graphs").join(name))
}

fn load(name: &str) -> Option<G2oGraph> {
    let bytes = std::fs::read(data(&format!("{name}.g2o.gz"))?).unwrap();
    let mut text = String::new();
    flate2::read::GzDecoder::new(bytes.as_slice())
        .read_to_string(&mut text)
        .unwrap();
    Some(read_g2o(&text).unwrap())
}

#[test]
fn probe() {
    for (name, optimum) in OPTIMA {
        let Some(read) = load(name) else { return };
        for kind in ["file", "odometry", "chordal"] {
            let mut graph = read.graph.clone();
            if kind == "odometry" {
                start_along_odometry(&mut graph);
            }
            let t = std::time::Instant::now();
            let s = if kind == "chordal" {
                solve_from_chordal(&mut graph, &SolveOptions::default())
            } else {
                solve(&mut graph, &SolveOptions::default())
            };
            eprintln!(
                "{name:10} {kind:9} {:8.2} ms rel {:.2e} {s:?}",
                t.elapsed().as_secs_f64() * 1e3,
                s.final_cost / optimum - 1.0
            );
        }
    }
}

#[test]
fn incremental_probe() {
    use mapshift::graph::PoseGraph;
    use mapshift::solver::Solver;
    for name in ["M3500", "intel"] {
        let Some(read) = load(name) else { return };
        let whole = read.graph;
        let mut graph = PoseGraph::new();
        let mut solver = Solver::new();
        let mut edges: Vec<_> = whole.edges().to_vec();
        edges.sort_by_key(|e| {
            (
                e.from.max(e.to),
                e.kind == mapshift::graph::EdgeKind::LoopClosure,
            )
        });
        graph.add_node(whole.nodes()[0]).unwrap();
        let (mut total, mut worst, mut n, mut its, mut maxits) = (0.0_f64, 0.0_f64, 0, 0, 0);
        let mut f = 0.0;
        for e in edges {
            let new = e.from.max(e.to);
            if graph.node(new).is_none() {
                let prev = graph.node(e.from).unwrap().pose;
                graph
                    .add_node(mapshift::graph::Node {
                        id: new,
                        pose: prev.compose(&e.measurement),
                    })
                    .unwrap();
                graph.add_edge(e).unwrap();
                continue;
            }
            graph.add_edge(e).unwrap();
            let t = std::time::Instant::now();
            let s = solver.solve_touched(&mut graph, &[e.id], &SolveOptions::default());
            let ms = t.elapsed().as_secs_f64() * 1e3;
            total += ms;
            worst = worst.max(ms);
            n += 1;
            its += s.summary.iterations;
            maxits = maxits.max(s.summary.iterations);
            f += s.delta_f;
            assert!(s.summary.termination.is_converged(), "{s:?}");
        }
        eprintln!(
            "{name}: {n} closures, {total} ms, worst {worst}, its {its} max {maxits} F {} sum {f}",
            graph.cost()
        );
    }
}

#[test]
fn robust_probe() {
    for name in OPTIMA.iter().map(|o| o.0).chain(["B25b_0.150"]) {
        let Some(read) = load(name) else { return };
        let mut graph = read.graph;
        let t = std::time::Instant::now();
        let r = mapshift::solver::solve_robust(&mut graph, &SolveOptions::default());
        let ms = t.elapsed().as_secs_f64() * 1e3;
        eprintln!(
            "{name} {ms:.0} ms scale {} off {} {:?}",
            r.noise_scale,
            r.switched_off.len(),
            r.summary
        );
        if name.starts_with('B') {
            let mut d: Vec<_> = graph
                .edges()
                .iter()
                .filter(|e| e.kind == mapshift::graph::EdgeKind::LoopClosure)
                .map(|e| {
                    let x = graph.error_of(e).unwrap();
                    (x.xy().norm(), x.z, !r.switched_off.contains(&e.id))
                })
                .collect();
            d.sort_by(|a, b| a.0.total_cmp(&b.0));
            for d in &d[195..252] {
                eprint!("{:.2}/{:.2}/{} ", d.0, d.1, d.2);
            }
            eprintln!();
        }
    }
}
