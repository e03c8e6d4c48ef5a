//! Accepted and pending changes as steps in the drawing of a map.

use crate::change::{AcceptedChange, PendingChange};
use crate::ids::StampNs;

/// The changes in whose regions some scans do not count.
#[derive(Debug, Clone, Copy, Default)]
pub struct Decided<'a> {
    /// In the region of each, only scans since the change count.
    pub accepted: &'a [AcceptedChange],
    /// In the region of each, only scans from before the change count.
    pub pending: &'a [PendingChange],
}

/// What is done to a grid before the scans since `at` are drawn; after the last scan without it.
pub(super) struct Step<'a> {
    pub(super) at: Option<StampNs>,
    pub(super) what: What<'a>,
}

pub(super) enum What<'a> {
    /// Clears the region of an accepted change.
    Forget(&'a AcceptedChange),
    /// Remembers the region of the pending change of this number as it was before the change.
    Remember(usize, &'a PendingChange),
    /// Restores what was remembered.
    Restore(usize),
}

/// The steps for some changes, in the order of time. Changes that began last end first, so that overlapping
/// ones restore what was there before the first.
pub(super) fn steps<'a>(decided: Decided<'a>) -> Vec<Step<'a>> {
    let forget = decided.accepted.iter().map(|change| Step {
        at: Some(change.since),
        what: What::Forget(change),
    });
    let mut steps: Vec<Step<'a>> = forget.collect();
    let mut pending: Vec<_> = decided.pending.iter().enumerate().collect();
    pending.sort_by_key(|(_, change)| change.since);
    steps.extend(pending.iter().map(|&(k, change)| Step {
        at: Some(change.since),
        what: What::Remember(k, change),
    }));
    steps.extend(pending.iter().rev().map(|&(k, change)| Step {
        at: change.until,
        what: What::Restore(k),
    }));
    // `None` is after all times.
    steps.sort_by_key(|step| (step.at.is_none(), step.at));
    steps
}
