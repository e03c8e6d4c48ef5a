//! The notes that people add to their actions.

use super::problem::{Problem, ProblemKind};

const CHARS_MAX: usize = 2_000;

/// A note as it is stored; an empty one counts as none.
///
/// # Errors
/// 422 for a note that is too long or has control characters.
pub(super) fn checked_note(note: Option<String>) -> Result<Option<String>, Problem> {
    let unprintable = |c: char| c.is_control() && c != '\n' && c != '\t';
    let note = note.filter(|note| !note.is_empty());
    if note
        .as_ref()
        .is_some_and(|note| note.chars().count() > CHARS_MAX || note.chars().any(unprintable))
    {
        let detail = "a note has at most 2,000 characters, and no control characters except line breaks and tabs";
        return Err(Problem::new(ProblemKind::OutOfRange, detail).at("/note"));
    }
    Ok(note)
}
