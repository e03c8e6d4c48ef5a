//! The command line: one file per command.
//!
//! Must not know the inside of a running service: `upload`, `simulate` and `demo` talk to it through `client`,
//! over HTTP like any other client. Begin with [`run`].

mod backup;
mod backup_file;
mod buildings;
mod calibration;
mod comparison;
mod config;
mod demo;
mod doctor;
mod export;
mod faults;
mod fleet;
mod fsck;
mod graph_file;
mod key_arg;
mod keys;
mod openapi;
mod optimise;
mod plan;
mod progress;
mod recording;
mod replay;
mod reproduce;
mod restore;
mod score;
mod serve;
mod simulate;
mod stability;
mod upload;

use std::io::{self, Write};
use std::process::ExitCode;

use clap::{ArgMatches, CommandFactory, FromArgMatches, Parser, Subcommand};

use crate::config::{SettingsFile, settings_file_of, with_settings_file};

/// Reports to the maintainers of a map where the world has changed.
#[derive(Debug, Parser)]
#[command(name = "mapshift", version, arg_required_else_help = true)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Run the service.
    Serve(serve::Args),
    /// Run the service with simulated vehicles that drive laps in a changing hall.
    Demo(demo::Args),
    /// Drive simulated vehicles through a world that changes, against a running service.
    Simulate(simulate::Args),
    /// Upload recorded trips to a running service; safe to repeat.
    Upload(upload::Args),
    /// Write a route's map, trips, scans and alerts as an MCAP recording.
    Export(export::Args),
    /// Optimise a pose graph in a g2o file.
    Optimise(optimise::Args),
    /// Run the paper's experiments: its tables and figures with this program's beside them.
    Reproduce(reproduce::Args),
    /// Score the detectors on your recordings, with known objects drawn into them.
    Score(score::Args),
    /// Measure how far the map of your recordings moves if the scans differ slightly.
    Stability(stability::Args),
    /// Measure maps of simulated floors with long corridors: whether loops close, and correctly.
    Buildings(buildings::Args),
    /// Measure the effect of odometry faults on a map: jumps, slip, a robot that is carried.
    Faults(faults::Args),
    /// Measure how well trips show the errors of simulated vehicles: mounts, wheels, clocks, beams, ranges.
    Calibration(calibration::Args),
    /// Check a database: checksums and the invariants of its tables.
    Fsck(fsck::Args),
    /// Write a checked copy of the database while the service runs.
    Backup(backup::Args),
    /// Put a backup into a data directory.
    Restore(restore::Args),
    /// Diagnose an installation: what is wrong, and what to do about it.
    Doctor(doctor::Args),
    /// Rebuild maps from their journal of inputs, and compare them with the stored ones.
    Replay(replay::Args),
    /// Create, list and revoke API keys.
    Keys(keys::Args),
    /// List the settings with their values and sources.
    Config(config::Args),
    /// Print the OpenAPI document.
    Openapi(openapi::Args),
}

/// Exit code for wrong arguments or a wrong settings file, as clap's.
const WRONG_ARGUMENTS: u8 = 2;

/// Parses the arguments, runs the command, and turns its error into an exit code.
pub fn run() -> ExitCode {
    let given = match Given::parse() {
        Ok(given) => given,
        Err(error) => {
            report(&error);
            return ExitCode::from(WRONG_ARGUMENTS);
        }
    };
    let outcome = match given.command {
        Command::Serve(args) => serve::run(args),
        Command::Demo(args) => demo::run(args),
        Command::Simulate(args) => simulate::run(args),
        Command::Upload(args) => upload::run(args),
        Command::Export(args) => export::run(&args),
        Command::Optimise(args) => optimise::run(args),
        Command::Reproduce(args) => reproduce::run(args),
        Command::Score(args) => score::run(args),
        Command::Stability(args) => stability::run(args),
        Command::Buildings(args) => buildings::run(&args),
        Command::Faults(args) => faults::run(&args),
        Command::Calibration(args) => calibration::run(&args),
        Command::Fsck(args) => return exit(fsck::run(&args)),
        Command::Backup(args) => backup::run(&args),
        Command::Restore(args) => restore::run(&args),
        Command::Doctor(args) => return exit(doctor::run(&args)),
        Command::Replay(args) => return exit(replay::run(&args)),
        Command::Keys(args) => keys::run(&args),
        Command::Config(args) => config::run(&args, &given.arguments, given.file.as_ref()),
        Command::Openapi(args) => openapi::run(args),
    };
    exit(outcome.map(|()| ExitCode::SUCCESS))
}

/// The command line, with the settings file as defaults.
struct Given {
    command: Command,
    /// The arguments of the command, with where each comes from.
    arguments: ArgMatches,
    file: Option<SettingsFile>,
}

impl Given {
    /// Parses the arguments; ends the process if they are wrong or ask for help.
    fn parse() -> anyhow::Result<Self> {
        let command = with_settings_file(Cli::command());
        let mut matches = command.clone().get_matches();
        let file = match settings_file_of(&matches) {
            Some(path) => Some(SettingsFile::read(path)?),
            None => None,
        };
        if let Some(file) = &file {
            matches = file.apply(command).get_matches();
        }
        let parsed = Cli::from_arg_matches(&matches).unwrap_or_else(|error| error.exit());
        let own = matches.remove_subcommand();
        Ok(Self {
            command: parsed.command,
            arguments: own.map(|(_, arguments)| arguments).unwrap_or_default(),
            file,
        })
    }
}

fn report(error: &anyhow::Error) {
    let _ = writeln!(io::stderr(), "error: {error:#}");
}

fn exit(outcome: anyhow::Result<ExitCode>) -> ExitCode {
    match outcome {
        Ok(code) => code,
        Err(error) => {
            report(&error);
            ExitCode::FAILURE
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_reference_lists_every_command() {
        let reference = include_str!("../../docs/reference/commands.md");
        for command in Cli::command().get_subcommands() {
            let about = command.get_about().map(ToString::to_string);
            let row = format!("| `{}` | {} |", command.get_name(), about.unwrap());
            let lacks = format!("docs/reference/commands.md lacks\n{row}");
            assert!(reference.contains(&row), "{lacks}");
        }
    }

    #[test]
    fn the_arguments_are_well_defined() {
        with_settings_file(Cli::command()).debug_assert();
    }
}
