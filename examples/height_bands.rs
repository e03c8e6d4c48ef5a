//! What height bands of a 3D lidar find of tables and shelves that come and go in a simulated hall.
//!
//! `cargo run --release --example height_bands -- [SEEDS [FIRST_SEED]]` prints the table of
//! `docs/explanation/detection.md`.

use std::io::Write;

use mapshift::experiments::{bands_text, score_bands};

const SEEDS: u64 = 5;
const FIRST_SEED: u64 = 700;

fn main() -> anyhow::Result<()> {
    let mut arguments = std::env::args().skip(1);
    let mut number = |otherwise: u64| match arguments.next() {
        Some(text) => text.parse(),
        None => Ok(otherwise),
    };
    let (seeds, first_seed) = (number(SEEDS)?, number(FIRST_SEED)?);
    let study = score_bands(first_seed, seeds, || {})?;
    write!(std::io::stdout(), "{}", bands_text(&study))?;
    Ok(())
}
