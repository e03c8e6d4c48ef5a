//! Whether poses are as uncertain as the map says, in simulated worlds.
//!
//! `cargo run --release --example pose_errors -- [first seed] [seeds]`

use mapshift::experiments::{measure_pose_consistency, pose_consistency_text};

#[allow(clippy::print_stdout)]
fn main() -> anyhow::Result<()> {
    let mut numbers = std::env::args().skip(1).map(|text| text.parse::<u64>());
    let first = numbers.next().transpose()?.unwrap_or(1);
    let seeds = numbers.next().transpose()?.unwrap_or(5);
    let rows = measure_pose_consistency(&(first..first + seeds))?;
    println!("{}", pose_consistency_text(&rows));
    Ok(())
}
