//! The console's words for the values of enumerations, as a script that it loads. The compiler asks for the words of a
//! new value here.

use crate::model::{AlertAction, AlertStatus, ChangeKind, DismissReason, TextEnum, Tier};

/// The script: one constant for each enumeration that the console shows, with pairs of the API's text and the console's
/// words, in the order of the model.
///
/// # Errors
/// If a table does not serialise.
pub(super) fn script() -> Result<String, serde_json::Error> {
    Ok([
        constant("KINDS", kind_words)?,
        constant("ACTIONS", action_words)?,
        constant("STATUSES", AlertStatus::name)?,
        constant("DOUBTS", doubt_words)?,
        constant("REASONS", reason_words)?,
    ]
    .concat())
}

fn constant<T: TextEnum>(
    name: &str,
    words: impl Fn(T) -> &'static str,
) -> Result<String, serde_json::Error> {
    let pairs = T::TABLE.iter().map(|(value, text)| (*text, words(*value)));
    let pairs = serde_json::to_string(&pairs.collect::<Vec<_>>())?;
    Ok(format!("export const {name} = new Map({pairs});\n"))
}

/// The title of a kind of change.
pub(super) fn kind_words(kind: ChangeKind) -> &'static str {
    match kind {
        ChangeKind::Appeared => "Something appeared",
        ChangeKind::Disappeared => "Something disappeared",
        ChangeKind::Residual => "Closures contradict the map",
        ChangeKind::MapMismatch => "The map does not fit",
        ChangeKind::VehicleSuspect => "A vehicle may be faulty",
    }
}

/// The text of a button.
fn action_words(action: AlertAction) -> &'static str {
    match action {
        AlertAction::Acknowledge => "Acknowledge",
        AlertAction::Accept => "Accept into the map",
        AlertAction::Dismiss => "Dismiss",
        AlertAction::Reopen => "Reopen",
        AlertAction::Undo => "Undo",
    }
}

/// The remark on alerts that are not certain.
fn doubt_words(tier: Tier) -> &'static str {
    match tier {
        Tier::Tentative => "tentative, observed in one pass",
        Tier::Confirmed => "",
    }
}

/// The choices when an alert is dismissed.
fn reason_words(reason: DismissReason) -> &'static str {
    match reason {
        DismissReason::Temporary => "Temporary: it will not last",
        DismissReason::People => "People were standing there",
        DismissReason::Sensor => "Sensor: a lidar measured wrongly",
        DismissReason::WrongPlace => "Wrong place: the map or the pose is wrong",
        DismissReason::Other => "Something else, see the note",
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;
    use crate::model::{BatchStatus, ResidualVerdict};

    use crate::api::documents::CONSOLE;

    /// The concatenated files of the console whose path has this ending.
    fn console(end: &str) -> String {
        let files = CONSOLE.iter().filter(|(path, ..)| path.ends_with(end));
        files.map(|(.., text)| *text).collect()
    }

    fn has<T: TextEnum>(text: &str) -> bool {
        T::of_text(text).is_ok()
    }

    fn has_status(text: &str) -> bool {
        has::<AlertStatus>(text) || has::<BatchStatus>(text)
    }

    /// The name that follows each `before` in a text, of the letters that texts of enumerations have.
    fn named<'a>(text: &'a str, before: &str) -> Vec<&'a str> {
        let is_letter = |c: char| c.is_ascii_lowercase() || c == '_';
        let after = text.split(before).skip(1);
        let named = after.map(|rest| rest.split(|c| !is_letter(c)).next().unwrap_or_default());
        named.filter(|name| !name.is_empty()).collect()
    }

    #[test]
    fn the_script_has_every_value_with_its_words() {
        let script = script().unwrap();
        let first = "export const KINDS = new Map([[\"appeared\",\"Something appeared\"],";
        assert!(script.starts_with(first), "{script}");
        assert!(script.contains("[\"undo\",\"Undo\"]]);\n"), "{script}");
        for name in ["KINDS", "ACTIONS", "STATUSES", "DOUBTS", "REASONS"] {
            assert!(script.contains(&format!("export const {name} = ")));
            assert!(
                console(".js").contains(name),
                "the console does not use {name}"
            );
        }
    }

    #[test]
    fn every_enumeration_text_in_the_console_exists() {
        let mut found = BTreeSet::new();
        let mut check = |text: &str, before, is_one: fn(&str) -> bool| {
            for name in named(text, before) {
                assert!(is_one(name), "{before}{name}");
                found.insert(name.to_owned());
            }
        };
        let (script, style) = (console(".js"), console(".css"));
        check(&script, "status === \"", has_status);
        check(&script, "action === \"", has::<AlertAction>);
        check(&script, "kind === \"", has::<ChangeKind>);
        check(&script, "tier === \"", has::<Tier>);
        check(&style, ".status-", has::<BatchStatus>);
        check(&style, ".dot.", has::<ResidualVerdict>);
        check(&style, ".kind-", has::<ChangeKind>);
        assert!(found.len() >= 8, "the console was not read: {found:?}");
    }
}
