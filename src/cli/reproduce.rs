//! `mapshift reproduce`.

use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};

use anyhow::Context;

use super::progress::{Progress, say};
use crate::experiments::{Protocol, Seeds};

/// Arguments of `mapshift reproduce`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// A few small cases only: a test that everything runs.
    #[arg(long)]
    short: bool,
    /// Every n-th case only: a quick overview of the whole range.
    #[arg(long, value_name = "N", default_value = "1")]
    every: NonZeroUsize,
    /// Which seeds: parameters are chosen on one set and results reported on the other.
    #[arg(long, value_enum, default_value = "scoring")]
    seeds: SeedSet,
    /// Where tables, figures and the numbers behind them are written.
    #[arg(long, value_name = "DIR", default_value = "reproduced")]
    output: PathBuf,
}

/// One of two sets of seeds.
#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum SeedSet {
    /// For choosing parameters.
    Tuning,
    /// For reporting results.
    Scoring,
}

/// Runs the command.
///
/// # Errors
/// If a case could not be run or the results could not be written.
pub fn run(args: Args) -> anyhow::Result<()> {
    let directory = args.output.display();
    std::fs::create_dir_all(&args.output)
        .with_context(|| format!("the directory {directory} could not be made"))?;
    let protocol = Protocol {
        short: args.short,
        every: args.every,
        seeds: match args.seeds {
            SeedSet::Tuning => Seeds::Tuning,
            SeedSet::Scoring => Seeds::Scoring,
        },
    };
    let (cases, laps) = protocol.size();
    say(&format!("{cases} cases with {laps} laps"));
    let progress = Progress::new(cases as u64, "cases");
    let advance = || progress.advance(1);
    let reproduced = protocol.run(advance)?;
    progress.finish();
    say(&reproduced.tables);
    write(&args.output, "tables.md", reproduced.tables.as_bytes())?;
    write(&args.output, "numbers.json", &reproduced.numbers)?;
    for figure in &reproduced.figures {
        say(&format!("{}: {}", figure.name, figure.caption));
        write(&args.output, figure.name, figure.svg.as_bytes())?;
    }
    say(&format!("tables, figures and numbers are in {directory}"));
    Ok(())
}

fn write(directory: &Path, name: &str, bytes: &[u8]) -> anyhow::Result<()> {
    let path = directory.join(name);
    std::fs::write(&path, bytes).with_context(|| format!("cannot write {}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_short_form_writes_everything() {
        let directory = tempfile::tempdir().unwrap();
        run(Args {
            short: true,
            every: NonZeroUsize::MIN,
            seeds: SeedSet::Tuning,
            output: directory.path().join("made"),
        })
        .unwrap();
        let read =
            |file: &str| std::fs::read_to_string(directory.path().join("made").join(file)).unwrap();
        let tables = read("tables.md");
        assert!(tables.contains("| 0 m, 1 th") && tables.contains("1.00, 0.83, 0.91, 0.99"));
        for map in ["as the service's `seed`", "faithful"] {
            let of_map = |line: &&str| line.starts_with("| 0 m, 1 th") && line.contains(map);
            assert_eq!(tables.lines().filter(of_map).count(), 1, "{map}");
        }
        let numbers: serde_json::Value = serde_json::from_str(&read("numbers.json")).unwrap();
        assert_eq!(numbers["cases"], 3);
        let closures = |map: &str| numbers["closures"][map].as_u64().unwrap();
        assert!(closures("faithful") > 0 && closures("faithful") != closures("seed"));
        let of_paper = &numbers["levels"][0]["rows"]["paper, faithful, th"];
        assert!(of_paper["laps"]["left_alone"].is_u64());
        let events = &numbers["levels"][0]["rows"]["fused"]["events_found"];
        assert!(events["of"].as_u64() > Some(0) && events["high"].as_f64() <= Some(1.0));
        for number in [1, 3, 4, 5] {
            let figure = read(&format!("figure-{number}.svg"));
            assert!(figure.starts_with("<svg") && !figure.contains("NaN"));
        }
    }
}
