//! Progress for people: a bar on a terminal, plain lines elsewhere.

use std::io::{self, IsTerminal, Write};
use std::sync::atomic::{AtomicU64, Ordering};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

/// Plain lines are written whenever this share of the work is done.
const PLAIN_STEPS: u64 = 10;

/// Writes a line for the user; a closed pipe is no error.
pub(super) fn say(text: &str) {
    let _ = writeln!(io::stdout().lock(), "{text}");
}

/// Progress of a long task.
pub(super) struct Progress {
    bar: ProgressBar,
    plain: bool,
    what: &'static str,
    total: u64,
    done: AtomicU64,
}

impl Progress {
    /// Work of `total` pieces; `what` names them.
    pub(super) fn new(total: u64, what: &'static str) -> Self {
        let plain = !io::stderr().is_terminal();
        let bar = if plain {
            ProgressBar::with_draw_target(Some(total), ProgressDrawTarget::hidden())
        } else {
            ProgressBar::new(total)
        };
        let template = "{bar:32} {pos}/{len} {msg} {elapsed} (about {eta} left)";
        if let Ok(style) = ProgressStyle::with_template(template) {
            bar.set_style(style);
        }
        bar.set_message(what);
        Self {
            bar,
            plain,
            what,
            total,
            done: AtomicU64::new(0),
        }
    }

    /// As [`Progress::new`], but silent without a terminal: the output is for other programs.
    pub(super) fn at_a_terminal(total: u64, what: &'static str) -> Self {
        Self {
            plain: false,
            ..Self::new(total, what)
        }
    }

    /// Writes a line beside the bar.
    pub(super) fn say(&self, text: &str) {
        self.bar.suspend(|| say(text));
    }

    /// Something to write lines with while the work is under way.
    pub(super) fn speaker(&self) -> impl Fn(&str) + Send + Sync + 'static {
        let bar = self.bar.clone();
        move |text| bar.suspend(|| say(text))
    }

    /// Adds finished pieces, from any thread.
    pub(super) fn advance(&self, pieces: u64) {
        let step = |done: u64| done * PLAIN_STEPS / self.total.max(1);
        let before = self.done.fetch_add(pieces, Ordering::Relaxed);
        let done = before + pieces;
        self.bar.inc(pieces);
        if self.plain && step(done) > step(before) {
            say(&format!("  {done}/{} {}", self.total, self.what));
        }
    }

    /// Sets the number of finished pieces.
    pub(super) fn advance_to(&self, done: u64) {
        self.advance(done.saturating_sub(self.done.load(Ordering::Relaxed)));
    }

    /// Removes the bar.
    pub(super) fn finish(self) {
        self.bar.finish_and_clear();
    }
}
