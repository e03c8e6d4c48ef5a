//! `mapshift faults`.

use super::progress::{Progress, say};
use crate::experiments::{Fault, faults_text, measure_faults};

/// Arguments of `mapshift faults`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Simulated worlds of each kind that every fault strikes; four cases each.
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u64).range(1..=1_000))]
    seeds: u64,
    /// The first seed; the others follow it.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u64).range(..1 << 32))]
    first_seed: u64,
    /// Print JSON, a case each, instead of a table.
    #[arg(long)]
    json: bool,
}

/// Runs the command.
///
/// # Errors
/// If a world could not be run.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let seeds = args.first_seed..args.first_seed + args.seeds;
    let runs = 4 * Fault::ALL.len() as u64 * args.seeds;
    let progress = Progress::at_a_terminal(runs, "maps");
    let advance = || progress.advance(1);
    let cases = measure_faults(&Fault::ALL, seeds, advance)?;
    progress.finish();
    match args.json {
        true => say(&serde_json::to_string_pretty(&cases)?),
        false => say(&faults_text(&cases)),
    }
    Ok(())
}
