//! `mapshift score`.

use std::path::PathBuf;

use anyhow::Context;

use super::progress::{Progress, say};
use super::recording;
use crate::experiments::{
    Options, Recording, in_sequence, measure_correlation, read_labels, score_recordings,
    score_worlds, text_of, world_runs, worlds_text,
};

/// Arguments of `mapshift score`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Recordings of one route (CARMEN logs or MCAP, of several lidars the first; also gzipped): one trip each, in the order given. With
    /// --worlds none is needed; recordings then serve only to measure how correlated their errors are.
    #[arg(required_unless_present = "worlds", value_name = "LOG")]
    logs: Vec<PathBuf>,
    /// Score simulated worlds instead, each once with every seed.
    #[arg(long, conflicts_with_all = ["objects", "labels", "pictures"])]
    worlds: bool,
    /// How many sets of objects are drawn into the recordings.
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u64).range(0..=1_000))]
    seeds: u64,
    /// The first seed; the others follow it.
    #[arg(long, default_value_t = 9_000, value_parser = clap::value_parser!(u64).range(..1 << 32))]
    first_seed: u64,
    /// Objects for each seed.
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u16).range(1..=500))]
    objects: u16,
    /// Real changes of the recordings as CSV: x, y, kind, what; in the first recording's odometry
    /// frame.
    #[arg(long, value_name = "FILE")]
    labels: Option<PathBuf>,
    /// Write a picture of each missed object, of each alert that fits no object, and of each alert
    /// of the untouched recordings.
    #[arg(long, value_name = "DIR")]
    pictures: Option<PathBuf>,
    /// Multiply the stated beam spacing by this factor (some logs state it wrongly).
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, value_parser = super::upload::parse_beam_spacing)]
    beam_spacing: f64,
    /// Print one JSON object instead of text.
    #[arg(long)]
    json: bool,
}

/// Runs the command.
///
/// # Errors
/// If a recording could not be read or run, a world could not be run, or a picture could not be
/// written.
pub fn run(args: Args) -> anyhow::Result<()> {
    let recordings = recordings_of(&args)?;
    match args.worlds {
        true => run_worlds(&args, &recordings),
        false => run_recordings(&args, &recordings),
    }
}

fn recordings_of(args: &Args) -> anyhow::Result<Vec<Recording>> {
    let mut logs = Vec::new();
    for path in &args.logs {
        let log = recording::read(path, args.beam_spacing)?;
        logs.push((recording::trip_of(path)?, log));
    }
    in_sequence(logs)
}

fn run_worlds(args: &Args, recordings: &[Recording]) -> anyhow::Result<()> {
    let runs = world_runs(args.seeds);
    let progress = Progress::at_a_terminal(runs, "worlds");
    let advance = || progress.advance(1);
    let mut study = score_worlds(args.first_seed, args.seeds, advance)?;
    progress.finish();
    if !recordings.is_empty() {
        study.correlations.push(measure_correlation(recordings)?);
    }
    match args.json {
        true => say(&serde_json::to_string_pretty(&study)?),
        false => say(&worlds_text(&study)),
    }
    Ok(())
}

fn run_recordings(args: &Args, recordings: &[Recording]) -> anyhow::Result<()> {
    let labels = args.labels.as_ref().map(|path| {
        let read = || read_labels(&std::fs::read_to_string(path)?);
        read().with_context(|| path.display().to_string())
    });
    let options = Options {
        first_seed: args.first_seed,
        seeds: args.seeds,
        objects: usize::from(args.objects),
        labels: labels.transpose()?,
        pictures: args.pictures.is_some(),
    };
    let progress = Progress::at_a_terminal(options.runs(), "runs");
    let study = score_recordings(recordings, &options, || progress.advance(1))?;
    progress.finish();
    if let Some(directory) = &args.pictures {
        std::fs::create_dir_all(directory).with_context(|| directory.display().to_string())?;
        for picture in &study.pictures {
            let path = directory.join(format!("{}.png", picture.name));
            std::fs::write(&path, &picture.png).with_context(|| path.display().to_string())?;
        }
    }
    match args.json {
        true => say(&serde_json::to_string_pretty(&study)?),
        false => say(&text_of(&study)),
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Command {
        #[command(flatten)]
        args: Args,
    }

    #[test]
    fn worlds_need_no_recording_and_draw_no_objects() {
        let parse = |text: &str| Command::try_parse_from(text.split(' '));
        assert!(parse("score").is_err());
        assert!(parse("score a.log").is_ok());
        let worlds = parse("score --worlds --seeds 2 --first-seed 5")
            .unwrap()
            .args;
        assert!(worlds.worlds && worlds.logs.is_empty());
        assert_eq!((worlds.seeds, worlds.first_seed), (2, 5));
        assert!(parse("score --worlds a.log").is_ok());
        assert!(parse("score --worlds --objects 3").is_err());
    }
}
