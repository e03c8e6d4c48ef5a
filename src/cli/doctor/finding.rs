//! The finding of a check.

use serde::Serialize;

/// Severity of a finding.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Level {
    Ok,
    Warning,
    Error,
}

impl Level {
    /// For people.
    pub(super) fn word(self) -> &'static str {
        match self {
            Self::Ok => "ok",
            Self::Warning => "warning",
            Self::Error => "error",
        }
    }
}

/// The finding of a check.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct Finding {
    pub level: Level,
    /// What was checked.
    pub check: &'static str,
    /// The result.
    pub finding: String,
    /// What to do about it; null if nothing is wrong.
    pub advice: Option<String>,
}

impl Finding {
    pub(super) fn ok(check: &'static str, finding: impl Into<String>) -> Self {
        Self {
            level: Level::Ok,
            check,
            finding: finding.into(),
            advice: None,
        }
    }

    pub(super) fn warning(
        check: &'static str,
        finding: impl Into<String>,
        advice: impl Into<String>,
    ) -> Self {
        Self {
            level: Level::Warning,
            advice: Some(advice.into()),
            ..Self::ok(check, finding)
        }
    }

    pub(super) fn error(
        check: &'static str,
        finding: impl Into<String>,
        advice: impl Into<String>,
    ) -> Self {
        Self {
            level: Level::Error,
            ..Self::warning(check, finding, advice)
        }
    }
}
