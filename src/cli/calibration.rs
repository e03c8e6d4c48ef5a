//! `mapshift calibration`.

use super::progress::{Progress, say};
use crate::experiments::{calibration_text, measure_calibration};
use crate::model::Quantity;

/// Arguments of `mapshift calibration`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Simulated vehicles for each quantity that can be off, and sound ones.
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u64).range(1..=1_000))]
    seeds: u64,
    /// The first seed; the others follow it.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u64).range(..1 << 32))]
    first_seed: u64,
    /// Print JSON, a vehicle each, instead of a table.
    #[arg(long)]
    json: bool,
}

/// Runs the command.
///
/// # Errors
/// If a vehicle could not be simulated.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let seeds = args.first_seed..args.first_seed + args.seeds;
    let vehicles = (Quantity::ALL.len() as u64 + 1) * args.seeds;
    let progress = Progress::at_a_terminal(vehicles, "vehicles");
    let cases = measure_calibration(seeds, || progress.advance(1))?;
    progress.finish();
    match args.json {
        true => say(&serde_json::to_string_pretty(&cases)?),
        false => say(&calibration_text(&cases)),
    }
    Ok(())
}
