//! Maps recordings (CARMEN logs, MCAP) without a service: every one is one trip of one route, in the order given.
//!
//! `cargo run --release --example map_log -- OUT_DIR LOG…` writes a TUM trajectory for each log,
//! the map as a picture and the graph as g2o, and prints what became of each log. An argument
//! `--beam-spacing=0.925` in front takes the beams to be 0.925 times as far apart as the logs state.

use std::fs::File;
use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use jiff::Timestamp;
use mapshift::ids::{TripId, VehicleId};
use mapshift::ingest::mcap::TopicChoice;
use mapshift::ingest::{BatchHead, BatchWriter, Recording, batch_json, format_of};
use mapshift::mapping::{Drive, RouteMap, Weighting};
use mapshift::render::{OccupancyGrid, to_png};

const PICTURE_RESOLUTION_M: f64 = 0.05;
const BATCH_SCANS: usize = 60;

/// What became of a recording.
#[derive(Default)]
struct Mapped {
    scans: usize,
    nodes: usize,
    closures: usize,
    refused: Option<String>,
}
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
        let recording = read_recording(path, beam_spacing)?;
        let trip = trip_of(path)?;
        let started = std::time::Instant::now();
        let mapped = extend_in_batches(&mut map, &trip, path, &recording)?;
        let said = match &mapped.refused {
            None => format!("{} nodes, {} loop closures", mapped.nodes, mapped.closures),
            Some(reason) => format!("not used: {reason}"),
        };
        let took_s = started.elapsed().as_secs_f64();
        writeln!(
            console,
            "{trip}: {} scans, {said}, {took_s:.2} s",
            mapped.scans
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

/// The format is known by the file's first bytes.
fn reader(path: &Path) -> anyhow::Result<Box<dyn BufRead>> {
    let file = File::open(path).with_context(|| path.display().to_string())?;
    Ok(match path.extension().is_some_and(|e| e == "gz") {
        true => Box::new(BufReader::new(flate2::read::GzDecoder::new(file))),
        false => Box::new(BufReader::new(file)),
    })
}

fn read_recording(path: &Path, beam_spacing: f64) -> anyhow::Result<Recording> {
    let mut reader = reader(path)?;
    let format = format_of(reader.fill_buf()?)?;
    let mut recording = Recording::open(reader, format, &TopicChoice::default())?;
    let lidars = recording.lidars.into_iter();
    recording.lidars = lidars
        .map(|lidar| lidar.with_beam_spacing(beam_spacing))
        .collect();
    Ok(recording)
}

/// Batches as a gateway would send them: those that cannot be placed wait for the next.
fn extend_in_batches(
    map: &mut RouteMap,
    trip: &TripId,
    path: &Path,
    recording: &Recording,
) -> anyhow::Result<Mapped> {
    let head = BatchHead {
        vehicle_id: &VehicleId::new("vehicle")?,
        trip_id: trip,
        initial_pose: None,
        lidars: &recording.lidars,
    };
    let batches = BatchWriter::new(head, recording.scans(reader(path)?)?, BATCH_SCANS);
    let mut waiting = Vec::new();
    let mut mapped = Mapped::default();
    let mut refused = None;
    for batch in batches {
        // As the service reads it.
        let batch = batch_json::decode(&batch?.json, Timestamp::UNIX_EPOCH)?;
        mapped.scans += batch.scans.len();
        waiting.extend(batch.scans);
        let drive = Drive {
            wheels: Default::default(),
            trip: trip.clone(),
            initial_pose: None,
            scans: waiting.clone(),
        };
        match map.extend(&drive) {
            Ok(added) => {
                mapped.nodes += added.nodes.len();
                mapped.closures += added.closures.len();
                waiting.clear();
                refused = None;
            }
            Err(reason) => refused = Some(reason),
        }
    }
    mapped.refused = refused.map(|reason| reason.to_string());
    Ok(mapped)
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
