//! `mapshift config`.

use std::io::Write;

use clap::ArgMatches;
use clap::parser::ValueSource;
use serde::Serialize;

use crate::config::{ServiceArgs, Setting, SettingsFile, settings};

/// Arguments of `mapshift config`.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    _service: ServiceArgs,
    /// Print one JSON array.
    #[arg(long)]
    json: bool,
}

/// A setting with its effective value.
#[derive(Debug, Serialize)]
struct InForce {
    name: String,
    /// The value as a flag would state it, several for a list. Null if not set.
    value: serde_json::Value,
    source: Source,
    /// The line of the settings file, if that is the source.
    line: Option<usize>,
    variable: String,
    help: String,
}

/// Where a value comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
enum Source {
    Flag,
    Variable,
    File,
    Default,
}

/// Prints the settings that `mapshift serve` would have with the same flags, variables and file.
///
/// # Errors
/// If standard output is closed.
pub fn run(args: &Args, matches: &ArgMatches, file: Option<&SettingsFile>) -> anyhow::Result<()> {
    let in_force: Vec<InForce> = settings()
        .iter()
        .map(|setting| InForce::of(setting, matches, file))
        .collect();
    let mut out = std::io::stdout().lock();
    if args.json {
        serde_json::to_writer_pretty(&mut out, &in_force)?;
        writeln!(out)?;
        return Ok(());
    }
    for setting in &in_force {
        writeln!(out, "{}", setting.line(file))?;
        writeln!(out, "    {}", setting.help.replace('\n', "\n    "))?;
    }
    Ok(())
}

impl InForce {
    fn of(setting: &Setting, matches: &ArgMatches, file: Option<&SettingsFile>) -> Self {
        let line = file.and_then(|file| file.line(setting));
        let source = match matches.value_source(setting.id()) {
            Some(ValueSource::CommandLine) => Source::Flag,
            Some(ValueSource::EnvVariable) => Source::Variable,
            _ if line.is_some() => Source::File,
            _ => Source::Default,
        };
        let values = matches.get_raw(setting.id()).into_iter().flatten();
        let values: Vec<String> = match setting.is_secret() {
            true => values.map(|_| "(not shown)".to_owned()).collect(),
            false => values.map(|v| v.to_string_lossy().into_owned()).collect(),
        };
        Self {
            name: setting.name.clone(),
            value: match setting.is_list() {
                true => values.into(),
                false => values.into_iter().next().into(),
            },
            source,
            line: line.filter(|_| source == Source::File),
            variable: setting.variable.clone(),
            help: setting.help(),
        }
    }

    /// In a line for people.
    fn line(&self, file: Option<&SettingsFile>) -> String {
        let value = match &self.value {
            serde_json::Value::Null => "(not set)".to_owned(),
            serde_json::Value::Array(values) if values.is_empty() => "(none)".to_owned(),
            serde_json::Value::Array(values) => {
                let values: Vec<&str> = values.iter().filter_map(|v| v.as_str()).collect();
                values.join(",")
            }
            serde_json::Value::String(value) => value.clone(),
            value => value.to_string(),
        };
        let (name, variable) = (&self.name, &self.variable);
        let source = match (self.source, self.line, file) {
            (Source::Flag, ..) => "flag".to_owned(),
            (Source::Variable, ..) => "variable".to_owned(),
            (Source::File, Some(line), Some(file)) => {
                format!("{}, line {line}", file.path.display())
            }
            _ => "default".to_owned(),
        };
        format!("{name} = {value}  [{source}; {variable}]")
    }
}
