//! Maps CARMEN logs without a service: every log is one trip of one route, in the order given.
//!
//! `cargo run --release --example map_log -- OUT_DIR LOG…` writes a TUM trajectory for each log,
//! the map as a picture and the graph as g2o, and prints what became of each log. An argument
//! `--beam-spacing=0.925` in front takes the beams to be 0.925 times as far apart as the logs state.

use std::fs::File;
use std::io::{BufReader, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, bail};
use mapshift::ids::TripId;
use mapshift::ingest::CarmenLog;
use mapshift::mapping::{Drive, DriveScan, RouteMap, Weighting};
use mapshift::render::{OccupancyGrid, to_png};
use mapshift::scan::LaserScan;

const PICTURE_RESOLUTION_M: f64 = 0.05;
const BATCH_SCANS: usize = 60;
const BEAM_SPACING: &str = "--beam-spacing=";
const USAGE: &str = "usage: map_log [--beam-spacing=FACTOR] OUT_DIR LOG…";

fn main() -> anyhow::Result<()> {
    let mut arguments = std::env::args_os().skip(1).map(PathBuf::from).peekable();
    let option = |argument: &PathBuf| {
        let text = argument.to_string_lossy();
        text.strip_prefix(BEAM_SPACING).map(str::to_owned)
    };
    let beam_spacing = match arguments.peek().and_then(option) {
        Some(factor) => factor.parse()?,
        None => 1.0,
    };
    arguments.next_if(|argument| option(argument).is_some());
    let out = arguments.next().context(USAGE)?;
    let logs: Vec<PathBuf> = arguments.collect();
    if logs.is_empty() {
        bail!(USAGE);
    }
    std::fs::create_dir_all(&out)?;
    let mut map = RouteMap::new(Weighting::Robust);
    let mut console = std::io::stdout();
    for path in &logs {
        let log = read_log(path)?.with_beam_spacing(beam_spacing);
        let trip = trip_of(path)?;
        let started = std::time::Instant::now();
        let outcome = extend_in_batches(&mut map, &trip, &log);
        let said = match outcome {
            Ok((nodes, closures)) => format!("{nodes} nodes, {closures} loop closures"),
            Err(reason) => format!("not used: {reason}"),
        };
        let took_s = started.elapsed().as_secs_f64();
        writeln!(
            console,
            "{trip}: {} scans, {said}, {took_s:.2} s",
            log.scans.len()
        )?;
    }
    for path in &logs {
        write_tum(&map, &trip_of(path)?, &out)?;
    }
    write_picture(&map, &out)?;
    writeln!(console, "F = {:.3}", map.graph().cost())?;
    Ok(())
}

fn trip_of(path: &Path) -> anyhow::Result<TripId> {
    let name = path.file_name().context("not a file")?.to_string_lossy();
    Ok(TripId::new(name.split('.').next().unwrap_or_default())?)
}

fn read_log(path: &Path) -> anyhow::Result<CarmenLog> {
    let file = File::open(path).with_context(|| path.display().to_string())?;
    let reader: Box<dyn Read> = if path.extension().is_some_and(|e| e == "gz") {
        Box::new(flate2::read::GzDecoder::new(file))
    } else {
        Box::new(file)
    };
    Ok(CarmenLog::read(BufReader::new(reader))?)
}

/// Batches as a gateway would send them: those that cannot be placed wait for the next.
fn extend_in_batches(
    map: &mut RouteMap,
    trip: &TripId,
    log: &CarmenLog,
) -> anyhow::Result<(usize, usize)> {
    let lidar = Arc::new(log.lidar.clone());
    let mut waiting = Vec::new();
    let (mut nodes, mut closures) = (0, 0);
    let mut refused = None;
    for batch in log.scans.chunks(BATCH_SCANS) {
        for scan in batch {
            waiting.push(DriveScan {
                beam_interval_s: 0.0,
                lidar: Default::default(),
                stamp: scan.stamp,
                odom_from_base: scan.odom_from_base,
                scan: LaserScan::new(lidar.clone(), scan.ranges_m.iter().copied())?,
            });
        }
        let drive = Drive {
            wheels: Default::default(),
            trip: trip.clone(),
            initial_pose: None,
            scans: waiting.clone(),
        };
        match map.extend(&drive) {
            Ok(added) => {
                nodes += added.nodes.len();
                closures += added.closures.len();
                waiting.clear();
                refused = None;
            }
            Err(reason) => refused = Some(reason),
        }
    }
    match refused {
        Some(reason) => Err(reason.into()),
        None => Ok((nodes, closures)),
    }
}

fn write_tum(map: &RouteMap, trip: &TripId, out: &Path) -> anyhow::Result<()> {
    let mut file = File::create(out.join(format!("{trip}.tum")))?;
    for (keyframe, node) in map.keyframes().iter().zip(map.graph().nodes()) {
        if keyframe.trip == *trip {
            let (sin, cos) = (0.5 * node.pose.theta).sin_cos();
            let seconds = keyframe.stamp.0.div_euclid(1_000_000_000);
            let nanoseconds = keyframe.stamp.0.rem_euclid(1_000_000_000);
            let (x, y) = (node.pose.x, node.pose.y);
            writeln!(file, "{seconds}.{nanoseconds:09} {x} {y} 0 0 0 {sin} {cos}")?;
        }
    }
    Ok(())
}

fn write_picture(map: &RouteMap, out: &Path) -> anyhow::Result<()> {
    let placed = map.keyframes().iter().zip(map.graph().nodes());
    let scans = placed.filter_map(|(keyframe, node)| Some((node.pose, keyframe.scan.as_ref()?)));
    let grid = OccupancyGrid::from_scans(scans, PICTURE_RESOLUTION_M);
    std::fs::write(out.join("map.png"), to_png(&grid)?)?;
    Ok(())
}
