//! What a connection is doing: waiting for a request, or answering one.

use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use tokio_util::sync::CancellationToken;

use crate::api::Held;

/// What one connection is doing. Its listener, its socket and its service share it.
pub(super) struct Activity {
    state: Mutex<State>,
    /// Cancelled when its place is needed by another connection.
    pub unwanted: CancellationToken,
}

enum State {
    /// Between two requests, or before the first.
    Waiting { since: Instant },
    /// From a request's head until its answer is in the kernel's hands.
    Answering {
        made: bool,
        /// What the answer holds until then.
        held: Option<Held>,
    },
}

impl Activity {
    pub(super) fn new() -> Self {
        let since = Instant::now();
        Self {
            state: Mutex::new(State::Waiting { since }),
            unwanted: CancellationToken::new(),
        }
    }

    /// A request's head has come.
    pub(super) fn begin(&self) {
        *self.state() = State::Answering {
            made: false,
            held: None,
        };
    }

    /// The answer begins, and holds this until it is sent.
    pub(super) fn hold(&self, what: Option<Held>) {
        if let State::Answering { held, .. } = &mut *self.state() {
            *held = what;
        }
    }

    /// The answer has been handed over to its end.
    pub(super) fn made(&self) {
        if let State::Answering { made, .. } = &mut *self.state() {
            *made = true;
        }
    }

    /// Everything that was handed over has been sent.
    pub(super) fn sent(&self) {
        let mut state = self.state();
        if matches!(*state, State::Answering { made: true, .. }) {
            let since = Instant::now();
            *state = State::Waiting { since };
        }
    }

    /// Since when the connection waits for a request, if it does.
    pub(super) fn waits_since(&self) -> Option<Instant> {
        match *self.state() {
            State::Waiting { since } => Some(since),
            State::Answering { .. } => None,
        }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_answer_lasts_until_all_of_it_is_sent() {
        let activity = Activity::new();
        assert!(activity.waits_since().is_some());
        activity.begin();
        activity.sent();
        assert!(activity.waits_since().is_none(), "nothing was made yet");
        activity.made();
        assert!(activity.waits_since().is_none(), "nothing was sent yet");
        activity.sent();
        assert!(activity.waits_since().is_some());
    }
}
