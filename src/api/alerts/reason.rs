//! Who decides about an alert, and why, checked.

use crate::api::note::checked_note;
use crate::api::problem::{Problem, ProblemKind};
use crate::model::{Actor, AlertAction, DismissReason};
use crate::store::SYSTEM;

const NAME_CHARS_MAX: usize = 100;
/// Who decided, if the request does not say.
const UNNAMED: &str = "anonymous";

/// Who decides, and why.
pub(super) struct Why {
    pub by: String,
    pub note: Option<String>,
    pub reason: Option<DismissReason>,
}

impl Why {
    /// # Errors
    /// 422 for a note that cannot be kept, or a reason for anything but a dismissal.
    pub(super) fn checked(
        action: AlertAction,
        by: String,
        note: Option<String>,
        reason: Option<DismissReason>,
    ) -> Result<Self, Problem> {
        if reason.is_some() && action != AlertAction::Dismiss {
            let detail = "a reason goes with dismiss only: write a note instead";
            return Err(Problem::new(ProblemKind::OutOfRange, detail).at("/reason"));
        }
        let note = checked_note(note)?;
        Ok(Self { by, note, reason })
    }
}

/// Who decides: whoever has signed in, else the name that the request gives.
pub(super) fn decider(actor: &Actor, by: Option<String>) -> Result<String, Problem> {
    match actor.signed_in() {
        Some(name) => Ok(name.to_owned()),
        None => checked_name("/by", by),
    }
}

/// A person's name at a JSON pointer of the body; `anonymous` without one.
pub(super) fn checked_name(pointer: &str, by: Option<String>) -> Result<String, Problem> {
    let refuse = |detail: &str| Err(Problem::new(ProblemKind::OutOfRange, detail).at(pointer));
    let by = by.unwrap_or_else(|| UNNAMED.to_owned());
    let length = by.chars().count();
    if !(1..=NAME_CHARS_MAX).contains(&length) || by.chars().any(char::is_control) {
        return refuse("a name has 1 to 100 characters, none of them a control character");
    }
    if by.eq_ignore_ascii_case(SYSTEM) {
        return refuse("\"system\" is the service itself: give another name");
    }
    Ok(by)
}
