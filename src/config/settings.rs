//! The settings of the service: the arguments of `serve` that have a variable.

use std::any::TypeId;

use clap::{Arg, ArgAction, Args as _, Command};

use super::ServiceArgs;

/// One setting, as the command line defines it.
#[derive(Debug, Clone)]
pub struct Setting {
    argument: Arg,
    /// Its flag without the dashes: its key in a file.
    pub name: String,
    /// Its variable.
    pub variable: String,
}

/// What a file gives for a setting.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum ValueKind {
    /// `true` or `false`.
    Boolean,
    /// A number without quotes.
    Integer,
    /// Text in quotes.
    Text,
}

/// All settings, in the order of the help.
pub fn settings() -> Vec<Setting> {
    let command = ServiceArgs::augment_args(Command::new("settings"));
    command
        .get_arguments()
        .filter_map(Setting::of_argument)
        .collect()
}

impl Setting {
    fn of_argument(argument: &Arg) -> Option<Self> {
        Some(Self {
            name: argument.get_long()?.to_owned(),
            variable: argument.get_env()?.to_str()?.to_owned(),
            argument: argument.clone(),
        })
    }

    /// Whether an argument of some command is this setting.
    pub(super) fn is(&self, argument: &Arg) -> bool {
        let variable = argument.get_env().and_then(|variable| variable.to_str());
        variable == Some(self.variable.as_str())
    }

    /// Its id among parsed arguments.
    pub fn id(&self) -> &str {
        self.argument.get_id().as_str()
    }

    /// What it is, in a paragraph without its last full stop.
    pub fn help(&self) -> String {
        let help = self.argument.get_help().map(ToString::to_string);
        help.unwrap_or_default()
    }

    /// Whether its value must not be shown.
    pub fn is_secret(&self) -> bool {
        self.argument.is_hide_env_values_set()
    }

    /// Whether it takes several values.
    pub fn is_list(&self) -> bool {
        matches!(self.argument.get_action(), ArgAction::Append)
    }

    /// Its default as it would be given; `None` if it is not set by default.
    pub fn default_value(&self) -> Option<String> {
        if self.kind() == ValueKind::Boolean {
            return Some("false".to_owned());
        }
        let default = self.argument.get_default_values().first()?;
        Some(default.to_string_lossy().into_owned())
    }

    /// A value as a file gives it.
    pub fn in_file(&self, value: &str) -> String {
        match self.kind() {
            ValueKind::Boolean | ValueKind::Integer => value.to_owned(),
            ValueKind::Text => format!("{value:?}"),
        }
    }

    pub(super) fn kind(&self) -> ValueKind {
        let parsed = self.argument.get_value_parser().type_id();
        let integers = [
            TypeId::of::<u8>(),
            TypeId::of::<u16>(),
            TypeId::of::<u32>(),
            TypeId::of::<u64>(),
            TypeId::of::<usize>(),
        ];
        if parsed == TypeId::of::<bool>() {
            ValueKind::Boolean
        } else if integers.iter().any(|integer| parsed == *integer) {
            ValueKind::Integer
        } else {
            ValueKind::Text
        }
    }

    /// Whether the command line would take these values; the error says why not.
    pub(super) fn check(&self, values: &[String]) -> Result<(), String> {
        use clap::builder::Resettable::Reset;
        use clap::error::{ContextKind, ContextValue};
        use std::error::Error as _;

        if self.kind() == ValueKind::Boolean {
            return Ok(());
        }
        let argument = self.argument.clone().env(Reset);
        let command = Command::new("settings").no_binary_name(true).arg(argument);
        let flags = values
            .iter()
            .map(|value| format!("--{}={value}", self.name));
        let Err(error) = command.try_get_matches_from(flags) else {
            return Ok(());
        };
        if let Some(cause) = error.source() {
            return Err(cause.to_string());
        }
        match error.get(ContextKind::ValidValue) {
            Some(ContextValue::Strings(valid)) if !valid.is_empty() => {
                Err(format!("it must be one of {}", valid.join(", ")))
            }
            _ => Err("it is not valid".to_owned()),
        }
    }
}
