//! Whether maps mend themselves where a segment of a lap was laid wrong, in simulated worlds.
//!
//! `cargo run --release --example mended_segments -- [first seed] [seeds]`

use mapshift::experiments::{Displacement, measure_mending, mending_text};

#[allow(clippy::print_stdout)]
fn main() -> anyhow::Result<()> {
    let mut numbers = std::env::args().skip(1).map(|text| text.parse::<u64>());
    let first = numbers.next().transpose()?.unwrap_or(1);
    let seeds = numbers.next().transpose()?.unwrap_or(5);
    let cases = measure_mending(&Displacement::ALL, first..first + seeds, || ())?;
    for case in &cases {
        println!("{}", serde_json::to_string(case)?);
    }
    println!("{}", mending_text(&cases));
    Ok(())
}
