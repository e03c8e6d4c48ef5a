//! Whether maps mend themselves where a segment of a lap was laid wrong, in simulated worlds, and
//! what mending does to recordings.
//!
//! `cargo run --release --example mended_segments -- [first seed] [seeds]`, or
//! `… -- LOG …` with CARMEN logs, also gzipped, of one route.

use std::fs::File;
use std::path::Path;

use flate2::read::MultiGzDecoder;
use mapshift::experiments::{
    Displacement, in_sequence, measure_mended_recordings, measure_mending, mending_text,
};
use mapshift::ids::TripId;
use mapshift::ingest::CarmenLog;

#[allow(clippy::print_stdout)]
fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let numbers = arguments.iter().map(|text| text.parse::<u64>());
    let Ok(numbers) = numbers.collect::<Result<Vec<u64>, _>>() else {
        return recordings(&arguments);
    };
    let first = numbers.first().copied().unwrap_or(1);
    let seeds = numbers.get(1).copied().unwrap_or(5);
    let cases = measure_mending(&Displacement::ALL, first..first + seeds, || ())?;
    for case in &cases {
        println!("{}", serde_json::to_string(case)?);
    }
    println!("{}", mending_text(&cases));
    Ok(())
}

#[allow(clippy::print_stdout)]
fn recordings(paths: &[String]) -> anyhow::Result<()> {
    let logs = paths.iter().map(|path| {
        let file = File::open(path)?;
        let reader: Box<dyn std::io::Read> = match path.ends_with(".gz") {
            true => Box::new(MultiGzDecoder::new(file)),
            false => Box::new(file),
        };
        let log = CarmenLog::read(std::io::BufReader::new(reader))?;
        let name = Path::new(path).file_name().unwrap_or_default();
        let name = name.to_string_lossy();
        anyhow::Ok((
            TripId::new(name.split('.').next().unwrap_or_default())?,
            log.into(),
        ))
    });
    let logs = logs.collect::<anyhow::Result<Vec<_>>>()?;
    let measured = measure_mended_recordings(&in_sequence(logs)?)?;
    println!("{}", serde_json::to_string_pretty(&measured)?);
    Ok(())
}
