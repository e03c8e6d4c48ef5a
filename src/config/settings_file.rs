//! A settings file: TOML whose keys are the long flags of `serve`.
//!
//! The file says what the defaults of the flags are. Everything else follows: a variable beats a
//! default, and a flag beats both. Begin with [`SettingsFile::read`].

use std::path::{Path, PathBuf};

use clap::{Arg, Command};
use toml::de::{DeTable, DeValue};

use super::settings::{Setting, ValueKind, settings};

/// The argument that names the file.
const ARGUMENT: &str = "config";
const VARIABLE: &str = "MAPSHIFT_CONFIG";
/// Keys that differ by more edits than this are not taken for a misspelling.
const EDITS_MAX: usize = 5;

/// The settings that a file gives.
#[derive(Debug, Clone)]
pub struct SettingsFile {
    /// Where it is.
    pub path: PathBuf,
    entries: Vec<Entry>,
}

#[derive(Debug, Clone)]
struct Entry {
    setting: Setting,
    line: usize,
    values: Vec<String>,
}

/// Why a settings file is refused.
#[derive(Debug, thiserror::Error)]
pub enum SettingsFileError {
    /// It cannot be read.
    #[error("the settings file {} cannot be read", path.display())]
    Read {
        /// Where it is.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// It is not TOML.
    #[error("the settings file {} is not valid TOML", path.display())]
    Syntax {
        /// Where it is.
        path: PathBuf,
        /// Why, with the place.
        source: toml::de::Error,
    },
    /// A key is unknown, or a value not valid.
    #[error("{}, line {line}: {what}", path.display())]
    Entry {
        /// Where the file is.
        path: PathBuf,
        /// The line of the key, from 1.
        line: usize,
        /// What is wrong.
        what: String,
    },
}

/// Lets every command that takes the data directory take a settings file as well.
pub fn with_settings_file(command: Command) -> Command {
    let takes_settings = |command: &Command| {
        let settings = settings();
        let is_data = |argument: &Arg| {
            let data = settings.iter().find(|setting| setting.name == "data");
            data.is_some_and(|data| data.is(argument))
        };
        command.get_arguments().any(is_data)
    };
    command.mut_subcommands(|subcommand| match takes_settings(&subcommand) {
        true => subcommand.arg(
            Arg::new(ARGUMENT)
                .long(ARGUMENT)
                .env(VARIABLE)
                .value_name("FILE")
                .global(true)
                .value_parser(clap::value_parser!(PathBuf))
                .help("Settings file, TOML: its keys are the long flags of `serve`. Variables and flags beat it"),
        ),
        false => subcommand,
    })
}

/// The settings file that parsed arguments name.
pub fn settings_file_of(matches: &clap::ArgMatches) -> Option<&PathBuf> {
    let own = matches.try_get_one::<PathBuf>(ARGUMENT).ok().flatten();
    own.or_else(|| settings_file_of(matches.subcommand()?.1))
}

impl SettingsFile {
    /// Reads a file.
    ///
    /// # Errors
    /// If it cannot be read, a key is unknown, or a value not valid.
    pub fn read(path: &Path) -> Result<Self, SettingsFileError> {
        let text = std::fs::read_to_string(path).map_err(|source| SettingsFileError::Read {
            path: path.to_path_buf(),
            source,
        })?;
        Self::parse(path, &text)
    }

    fn parse(path: &Path, text: &str) -> Result<Self, SettingsFileError> {
        let table = DeTable::parse(text).map_err(|source| SettingsFileError::Syntax {
            path: path.to_path_buf(),
            source,
        })?;
        let known = settings();
        let mut entries: Vec<Entry> = Vec::new();
        for (key, value) in table.get_ref() {
            let line = line_of(text, key.span().start);
            let refused = |what| SettingsFileError::Entry {
                path: path.to_path_buf(),
                line,
                what,
            };
            let setting = find(&known, key.get_ref()).map_err(refused)?;
            let values = values(setting, value.get_ref()).map_err(refused)?;
            if let Some(earlier) = entries.iter().find(|e| e.setting.name == setting.name) {
                let what = format!("{} is set in line {} already", setting.name, earlier.line);
                return Err(refused(what));
            }
            entries.push(Entry {
                setting: setting.clone(),
                line,
                values,
            });
        }
        Ok(Self {
            path: path.to_path_buf(),
            entries,
        })
    }

    /// The line that gives a setting.
    pub fn line(&self, setting: &Setting) -> Option<usize> {
        let entry = self.entries.iter().find(|e| e.setting.name == setting.name);
        entry.map(|entry| entry.line)
    }

    /// A command whose defaults are what the file gives, and so those of its subcommands.
    pub fn apply(&self, command: Command) -> Command {
        let command = command.mut_args(|argument| self.apply_to(argument));
        command.mut_subcommands(|subcommand| self.apply(subcommand))
    }

    fn apply_to(&self, argument: Arg) -> Arg {
        match self.entries.iter().find(|e| e.setting.is(&argument)) {
            Some(entry) => argument.default_values(entry.values.clone()),
            None => argument,
        }
    }
}

fn line_of(text: &str, offset: usize) -> usize {
    let before = text.bytes().take(offset);
    1 + before.filter(|byte| *byte == b'\n').count()
}

fn find<'a>(known: &'a [Setting], key: &str) -> Result<&'a Setting, String> {
    let name = key.replace('_', "-");
    if let Some(setting) = known.iter().find(|setting| setting.name == name) {
        return Ok(setting);
    }
    let edits = |setting: &&Setting| strsim::osa_distance(&setting.name, &name);
    let nearest = known.iter().min_by_key(edits);
    Err(
        match nearest.filter(|nearest| edits(nearest) <= EDITS_MAX) {
            Some(nearest) => format!("there is no setting {key}; is it {}?", nearest.name),
            None => format!("there is no setting {key}; `mapshift config` lists them"),
        },
    )
}

/// The values of a key, as flags would give them.
fn values(setting: &Setting, value: &DeValue<'_>) -> Result<Vec<String>, String> {
    let values = match value {
        DeValue::Array(items) if setting.is_list() => {
            let items = items.iter().map(|item| text(setting, item.get_ref()));
            items.collect::<Result<Vec<_>, _>>()?
        }
        value => vec![text(setting, value)?],
    };
    let shown = values.join(", ");
    let checked = setting.check(&values);
    checked.map_err(|why| format!("{} = {shown:?}: {why}", setting.name))?;
    Ok(values)
}

fn text(setting: &Setting, value: &DeValue<'_>) -> Result<String, String> {
    let wanted = match (setting.kind(), value) {
        (ValueKind::Boolean, DeValue::Boolean(value)) => return Ok(value.to_string()),
        (ValueKind::Integer, DeValue::Integer(value)) if value.radix() == 10 => {
            return Ok(value.as_str().to_owned());
        }
        (ValueKind::Text, DeValue::String(value)) => return Ok(value.to_string()),
        (ValueKind::Boolean, _) => "true or false, without quotes",
        (ValueKind::Integer, _) => "a whole number, without quotes",
        (ValueKind::Text, _) if setting.is_list() => "text in quotes, or a list of such",
        (ValueKind::Text, _) => "text in quotes",
    };
    Err(format!("{} takes {wanted}", setting.name))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::ServiceArgs;
    use clap::{Args as _, FromArgMatches as _};

    fn parse(text: &str) -> Result<SettingsFile, String> {
        SettingsFile::parse(Path::new("m.toml"), text).map_err(|error| error.to_string())
    }

    /// The service's arguments with a file beneath the flags.
    fn args(text: &str, flags: &[&str]) -> ServiceArgs {
        let command = ServiceArgs::augment_args(Command::new("serve").no_binary_name(true));
        let command = parse(text).unwrap().apply(command);
        let matches = command.try_get_matches_from(flags).unwrap();
        ServiceArgs::from_arg_matches(&matches).unwrap()
    }

    #[test]
    fn a_file_sets_what_flags_set() {
        let text = "# the plant\nlisten = \"127.0.0.1:9000\"\nmap_memory_mb = 64\n\
                    keep-bodies-days = 30\nlog-format = \"json\"\n\
                    webhooks-to-private-networks = true\n\
                    trusted_proxy = [\"127.0.0.1\", \"10.0.0.0/8\"]\n\
                    proxy-role = \"map-keepers=maintainer\"\n";
        let from_file = args(text, &[]);
        let from_flags = args(
            "",
            &[
                "--listen=127.0.0.1:9000",
                "--map-memory-mb=64",
                "--keep-bodies-days=30",
                "--log-format=json",
                "--webhooks-to-private-networks",
                "--trusted-proxy=127.0.0.1,10.0.0.0/8",
                "--proxy-role=map-keepers=maintainer",
            ],
        );
        assert_eq!(format!("{from_file:?}"), format!("{from_flags:?}"));
        assert_eq!(from_file.trusted_proxies.len(), 2);
    }

    #[test]
    fn a_flag_beats_the_file_and_the_file_the_default() {
        let with = |flags: &[&str]| args("map-memory-mb = 64", flags).map_memory_mb;
        assert_eq!(with(&[]), 64);
        assert_eq!(with(&["--map-memory-mb", "7"]), 7);
        assert_eq!(args("", &[]).map_memory_mb, 1024);
    }

    #[test]
    fn what_is_wrong_is_said_with_its_line() {
        let wrong = [
            (
                "\nlisten_on = \"a\"",
                "m.toml, line 2: there is no setting listen_on; is it listen?",
            ),
            (
                "mapmemory_mb = 3",
                "m.toml, line 1: there is no setting mapmemory_mb; is it map-memory-mb?",
            ),
            ("[service]\nlisten = \"a\"", "there is no setting service"),
            ("accept-lost-log = true", "there is no setting"),
            (
                "map-memory-mb = \"64\"",
                "map-memory-mb takes a whole number, without quotes",
            ),
            ("listen = 8080", "listen takes text in quotes"),
            (
                "insecure-open-to-network = \"yes\"",
                "takes true or false, without quotes",
            ),
            ("trusted-proxy = 10", "a list of such"),
            ("listen = [\"127.0.0.1:1\"]", "listen takes text in quotes"),
            (
                "\n\naddress-share = 101",
                "m.toml, line 3: address-share = \"101\": 101 is not in 1..=100",
            ),
            (
                "listen = \"here\"",
                "listen = \"here\": invalid socket address",
            ),
            (
                "log-format = \"xml\"",
                "log-format = \"xml\": it must be one of text, json",
            ),
            (
                "address-share = 3\naddress_share = 4",
                "address-share is set in line",
            ),
            ("listen = ", "not valid TOML"),
        ];
        for (text, message) in wrong {
            let error = parse(text).unwrap_err();
            assert!(error.contains(message), "{text:?}: {error}");
        }
    }

    #[test]
    fn the_example_names_every_setting_with_its_default() {
        let example = include_str!("../../deploy/mapshift.toml");
        assert!(
            parse(example).unwrap().entries.is_empty(),
            "all is commented"
        );
        let uncommented: String = example
            .lines()
            .filter_map(|line| line.strip_prefix("#").filter(|l| !l.starts_with(' ')))
            .fold(String::new(), |text, line| text + line + "\n");
        let file = parse(&uncommented).unwrap();
        for setting in settings() {
            assert!(
                file.line(&setting).is_some(),
                "no line #{} = …",
                setting.name
            );
            if let Some(default) = setting.default_value() {
                let line = format!("#{} = {}\n", setting.name, setting.in_file(&default));
                assert!(example.contains(&line), "{line}");
            }
        }
    }

    #[test]
    fn the_reference_lists_every_setting() {
        let reference = include_str!("../../docs/reference/settings.md");
        for setting in settings() {
            let default = match setting.default_value() {
                Some(default) => format!("`{default}`"),
                None => "—".to_owned(),
            };
            let Setting { name, variable, .. } = &setting;
            let row = format!(
                "| `{name}` | `{variable}` | {default} | {} |",
                setting.help()
            );
            assert!(
                reference.contains(&row),
                "docs/reference/settings.md lacks\n{row}"
            );
        }
    }
}
