//! What a connection is doing: idle, or answering a request.

use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use tokio_util::sync::CancellationToken;

use crate::api::Held;

/// What one connection is doing. Its listener, its socket and its service share it.
pub(super) struct Activity {
    state: Mutex<State>,
    /// Cancelled when another connection needs its place.
    pub unwanted: CancellationToken,
}

enum State {
    /// Between two requests, or before the first.
    Idle { since: Instant },
    /// From the head of a request until the kernel has all of its answer.
    Answering {
        made: bool,
        /// Held until then.
        held: Option<Held>,
    },
}

impl Activity {
    pub(super) fn new() -> Self {
        let since = Instant::now();
        Self {
            state: Mutex::new(State::Idle { since }),
            unwanted: CancellationToken::new(),
        }
    }

    /// The head of a request has arrived.
    pub(super) fn begin(&self) {
        *self.state() = State::Answering {
            made: false,
            held: None,
        };
    }

    /// The answer begins; it holds `what` until it has been sent.
    pub(super) fn hold(&self, what: Option<Held>) {
        if let State::Answering { held, .. } = &mut *self.state() {
            *held = what;
        }
    }

    /// The whole answer has been handed over.
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
            *state = State::Idle { since };
        }
    }

    /// Since when the connection has been idle; `None` if it is answering.
    pub(super) fn idle_since(&self) -> Option<Instant> {
        match *self.state() {
            State::Idle { since } => Some(since),
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
        assert!(activity.idle_since().is_some());
        activity.begin();
        activity.sent();
        assert!(activity.idle_since().is_none(), "nothing was made yet");
        activity.made();
        assert!(activity.idle_since().is_none(), "nothing was sent yet");
        activity.sent();
        assert!(activity.idle_since().is_some());
    }
}
