//! `mapshift stability`.

use std::path::PathBuf;

use super::progress::{Progress, say};
use super::recording;
use crate::experiments::{Disturbance, in_sequence, measure_stability, stability_text};

/// What must not move a map: a millimetre of noise on every range, and ten objects.
const DISTURBANCES: [Disturbance; 2] = [Disturbance::RangeNoise(0.001), Disturbance::Objects(10)];

/// Arguments of `mapshift stability`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Recordings of one route (CARMEN logs or MCAP, of several lidars the first; also gzipped): one trip each, in the order given.
    #[arg(required = true, value_name = "LOG")]
    logs: Vec<PathBuf>,
    /// How often noise and objects are drawn.
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u64).range(1..=1_000))]
    seeds: u64,
    /// The first seed; the others follow it.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u64).range(..1 << 32))]
    first_seed: u64,
    /// Multiply the stated beam spacing by this factor (some logs state it wrongly).
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, value_parser = super::upload::parse_beam_spacing)]
    beam_spacing: f64,
    /// Print JSON instead of text.
    #[arg(long)]
    json: bool,
}

/// Runs the command.
///
/// # Errors
/// If a recording could not be read or run.
pub fn run(args: Args) -> anyhow::Result<()> {
    let mut logs = Vec::new();
    for path in &args.logs {
        let log = recording::read(path, args.beam_spacing)?;
        logs.push((recording::trip_of(path)?, log));
    }
    let recordings = in_sequence(logs)?;
    let runs = DISTURBANCES.len() as u64 * args.seeds;
    let seeds = args.first_seed..args.first_seed + args.seeds;
    let progress = Progress::at_a_terminal(runs, "maps");
    let moved = measure_stability(&recordings, &DISTURBANCES, seeds, |_| progress.advance(1))?;
    progress.finish();
    match args.json {
        true => say(&serde_json::to_string_pretty(&moved)?),
        false => say(&stability_text(&moved)),
    }
    Ok(())
}
