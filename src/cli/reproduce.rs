//! `mapshift reproduce`.

mod baselines;
mod case;
mod counts;
mod figures;
mod fused_mode;
mod laps;
mod mapped;
mod method;
mod paper_mode;
mod protocol;
mod report;
mod run_one;
mod score;
mod summary;

use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::sync::mpsc;

use anyhow::Context;
use rayon::iter::{IndexedParallelIterator, IntoParallelIterator, ParallelIterator};

use super::progress::{Progress, say};
use case::{Case, Seeds};
use run_one::Outcome;
use summary::Summary;

/// Arguments of `mapshift reproduce`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// A few small cases only: shows that everything runs, says little.
    #[arg(long)]
    short: bool,
    /// Every so many-th case only: a quick look at the whole range.
    #[arg(long, value_name = "N", default_value = "1")]
    every: NonZeroUsize,
    /// Which seeds: numbers are chosen on the one set and reported on the other.
    #[arg(long, value_enum, default_value = "scoring")]
    seeds: Seeds,
    /// Where tables, figures and the numbers behind them are written.
    #[arg(long, value_name = "DIR", default_value = "reproduced")]
    output: PathBuf,
}

/// Runs the command.
///
/// # Errors
/// If a case could not be run or the results could not be written.
pub fn run(args: Args) -> anyhow::Result<()> {
    let directory = args.output.display();
    std::fs::create_dir_all(&args.output)
        .with_context(|| format!("the directory {directory} could not be made"))?;
    let cases = protocol::cases(args.short, args.seeds);
    let cases: Vec<Case> = cases.into_iter().step_by(args.every.get()).collect();
    let laps: usize = cases.iter().map(Case::laps).sum();
    say(&format!("{} cases with {laps} laps", cases.len()));
    let outcomes = run_all(cases)?;
    let summary = Summary::of(outcomes, args.seeds, args.short);
    let tables = text_of(&summary);
    say(&tables);
    write(&args.output, "tables.md", tables.as_bytes())?;
    let numbers = serde_json::to_vec_pretty(&summary)?;
    write(&args.output, "numbers.json", &numbers)?;
    for figure in figures::draw(args.short, args.seeds)? {
        say(&format!("{}: {}", figure.name, figure.caption));
        write(&args.output, figure.name, figure.svg.as_bytes())?;
    }
    say(&format!("tables, figures and numbers are in {directory}"));
    Ok(())
}

/// Runs the cases side by side; the outcomes are in the order of the cases.
fn run_all(cases: Vec<Case>) -> anyhow::Result<Vec<Outcome>> {
    let count = cases.len();
    let mut progress = Progress::new(count as u64, "cases");
    let (sender, receiver) = mpsc::channel();
    rayon::spawn(move || {
        let numbered = cases.into_par_iter().enumerate();
        numbered.for_each_with(sender, |sender, (k, case)| {
            let outcome = run_one::run(&case).with_context(|| case.name());
            // Nobody listens any more after another case has failed.
            let _ = sender.send((k, outcome));
        });
    });
    let mut outcomes = Vec::with_capacity(count);
    for (k, outcome) in receiver {
        outcomes.push((k, outcome?));
        progress.advance(1);
    }
    progress.finish();
    outcomes.sort_by_key(|(k, _)| *k);
    Ok(outcomes.into_iter().map(|(_, outcome)| outcome).collect())
}

fn text_of(summary: &Summary) -> String {
    let tables: Vec<String> = report::tables(summary).iter().map(|t| t.text()).collect();
    format!(
        "{} cases, {} laps; closures: {} in the maps as of the service's `seed`, {} in the \
         paper's own, {} in the robust maps; shares with Wilson's 95 % interval and counts.\n\n{}",
        summary.cases,
        summary.laps,
        summary.closures.seed,
        summary.closures.faithful,
        summary.closures.robust,
        tables.join("\n")
    )
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
            seeds: Seeds::Tuning,
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

    #[test]
    fn a_case_comes_out_the_same_each_time() {
        let case = protocol::cases(true, Seeds::Tuning).remove(2);
        let outcome = || serde_json::to_string(&run_one::run(&case).unwrap()).unwrap();
        assert_eq!(outcome(), outcome());
    }
}
