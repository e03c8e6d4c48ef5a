//! `mapshift buildings`.

use super::progress::{Progress, say};
use crate::experiments::{BUILDINGS, buildings_text, measure_buildings};

/// Arguments of `mapshift buildings`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Floors of each kind.
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u64).range(1..=1_000))]
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
/// If a floor could not be mapped.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let seeds = args.first_seed..args.first_seed + args.seeds;
    let runs = BUILDINGS.len() as u64 * args.seeds;
    let progress = Progress::at_a_terminal(runs, "floors");
    let advance = || progress.advance(1);
    let cases = measure_buildings(&BUILDINGS, seeds, advance)?;
    progress.finish();
    match args.json {
        true => say(&serde_json::to_string_pretty(&cases)?),
        false => say(&buildings_text(&cases)),
    }
    Ok(())
}
