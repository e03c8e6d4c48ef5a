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
