//! Matches simulated pairs of scans and prints what was found, for an evaluator that other
//! matchers' results go through too.
//!
//! `cargo run --release --example bench_matching -- SCANS GUESSES local|wide [REPEATS]`
//!
//! SCANS has three lines a pair: `PAIR id beams angle_min angle_increment x y theta`, the ranges
//! of the old scan and those of the new one in metres, 0 for no return. GUESSES has a line
//! `case pair x y theta` for each match: where it begins. Each result is a line
//! `case pair x y theta time_us`: `old_from_new` as it was matched, and the least time of the
//! repeats, in which everything counts from the ranges on (projection, normals, neighbours).
//! `local` aligns from the guess; `wide` searches ±1 m and ±30° around it first.

use std::io::{BufWriter, Write};
use std::sync::Arc;
use std::time::Instant;

use anyhow::Context;
use mapshift::geometry::Pose2;
use mapshift::matching::{
    IcpParams, LikelihoodGrid, ReferenceCloud, SearchParams, SearchWindow, align, search,
};
use mapshift::scan::{LaserScan, Lidar, SurfacePoint, surface_points};

const RANGE_SIGMA_M: f64 = 0.01;
const RANGE_MAX_M: f64 = 30.0;

const GRID_RESOLUTION_M: f64 = 0.1;
const GRID_LEVELS: usize = 5;
const SEARCH_POINTS: usize = 180;
const WINDOW_HALF_WIDTH_M: f64 = 1.0;
const WINDOW_HALF_TURN_RAD: f64 = std::f64::consts::FRAC_PI_6;
const SEARCH: SearchParams = SearchParams {
    score_min: 0.3,
    distinct_distance_m: f64::INFINITY,
    distinct_turn_rad: f64::INFINITY,
    rival_share: 1.0,
    wants_best_rival: true,
};

struct Pair {
    old: LaserScan,
    new: LaserScan,
}

fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [scans, guesses, way, rest @ ..] = arguments.as_slice() else {
        anyhow::bail!("usage: bench_matching SCANS GUESSES local|wide [REPEATS]");
    };
    let matcher: fn(&Pair, &Pose2) -> Pose2 = match way.as_str() {
        "local" => match_locally,
        "wide" => match_widely,
        other => anyhow::bail!("{other} is neither local nor wide"),
    };
    let repeats: usize = rest.first().map_or(Ok(1), |text| text.parse())?;
    let pairs = read_pairs(&std::fs::read_to_string(scans).context("cannot read the scans")?)?;
    let guesses = std::fs::read_to_string(guesses).context("cannot read the guesses")?;
    let mut console = BufWriter::new(std::io::stdout());
    for line in guesses.lines() {
        let fields: Vec<&str> = line.split_whitespace().collect();
        let [case, pair, x, y, theta] = fields.as_slice() else {
            anyhow::bail!("not a guess: {line}");
        };
        let scans: &Pair = pairs
            .get(pair.parse::<usize>()?)
            .context("an unknown pair")?;
        let guess = Pose2::new(x.parse()?, y.parse()?, theta.parse()?);
        let (mut pose, mut least_us) = (guess, f64::INFINITY);
        for _ in 0..repeats.max(1) {
            let begin = Instant::now();
            pose = matcher(scans, &guess);
            least_us = least_us.min(begin.elapsed().as_secs_f64() * 1e6);
        }
        let Pose2 { x, y, theta } = pose;
        writeln!(
            console,
            "{case} {pair} {x:.9} {y:.9} {theta:.9} {least_us:.2}"
        )?;
    }
    Ok(())
}

fn match_locally(pair: &Pair, guess: &Pose2) -> Pose2 {
    let (old, new) = (surface_points(&pair.old), surface_points(&pair.new));
    refine(&old, &new, guess)
}

fn refine(old: &[SurfacePoint], new: &[SurfacePoint], start: &Pose2) -> Pose2 {
    let Some(cloud) = ReferenceCloud::new([(Pose2::IDENTITY, old)]) else {
        return *start;
    };
    align(&cloud, new, start, RANGE_SIGMA_M, None, &IcpParams::ROBUST).pose
}

fn match_widely(pair: &Pair, guess: &Pose2) -> Pose2 {
    let (old, new) = (surface_points(&pair.old), surface_points(&pair.new));
    let reference = old.iter().map(|p| p.position);
    let sigma_m = 1.5 * GRID_RESOLUTION_M;
    let Some(grid) = LikelihoodGrid::new(reference, GRID_RESOLUTION_M, sigma_m, GRID_LEVELS) else {
        return *guess;
    };
    let stride = new.len().div_ceil(SEARCH_POINTS).max(1);
    let sampled: Vec<_> = new.iter().step_by(stride).map(|p| p.position).collect();
    let window = SearchWindow {
        centre: *guess,
        half_width_m: WINDOW_HALF_WIDTH_M,
        half_turn_rad: WINDOW_HALF_TURN_RAD,
    };
    let found = search(&grid, &sampled, &window, &SEARCH);
    let start = found.map_or(*guess, |hit| hit.pose);
    refine(&old, &new, &start)
}

fn read_pairs(text: &str) -> anyhow::Result<Vec<Pair>> {
    let lines: Vec<&str> = text.lines().collect();
    lines
        .chunks_exact(3)
        .map(|lines| {
            let head = numbers(lines[0].trim_start_matches("PAIR"))?;
            let [_, beams, angle_min_rad, angle_increment_rad, ..] = head[..] else {
                anyhow::bail!("not a pair: {}", lines[0]);
            };
            let lidar = Arc::new(Lidar {
                angle_min_rad,
                angle_increment_rad,
                range_min_m: 0.02,
                range_max_m: RANGE_MAX_M,
                mount: Pose2::IDENTITY,
                range_sigma_m: RANGE_SIGMA_M,
                band: None,
            });
            let scan = |line: &str| {
                let ranges_m = numbers(line)?;
                anyhow::ensure!(ranges_m.len() == beams as usize, "ranges are missing");
                let ranges_m = ranges_m.into_iter().map(Some);
                Ok(LaserScan::new(Arc::clone(&lidar), ranges_m)?)
            };
            let (old, new) = (scan(lines[1])?, scan(lines[2])?);
            Ok(Pair { old, new })
        })
        .collect()
}

fn numbers(line: &str) -> anyhow::Result<Vec<f64>> {
    line.split_whitespace()
        .map(|word| Ok(word.parse()?))
        .collect()
}
