//! A promise and how it is shown.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::{Duration, Instant};

use tokio::runtime::Runtime;

/// How much of a row is run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Form {
    /// By `cargo test`: seconds, and no time is judged.
    Quick,
    /// By hand: as much as the document states.
    Full,
}

impl Form {
    /// One of two values.
    pub fn choose<T>(self, quick: T, full: T) -> T {
        match self {
            Self::Quick => quick,
            Self::Full => full,
        }
    }
}

/// A promise, and what shows whether it is kept.
pub struct Row {
    pub name: &'static str,
    /// What it shows, in a line.
    pub shows: &'static str,
    /// Why it cannot run on this machine, if it cannot.
    pub obstacle: fn() -> Option<String>,
    pub run: fn(Form) -> Finding,
}

/// What a row found.
#[derive(Debug, Default)]
pub struct Finding {
    /// What was measured, for people.
    pub figures: Vec<String>,
    /// What of the promise does not hold.
    pub faults: Vec<String>,
    /// What the same judgement says of a subject that is broken on purpose.
    pub control: Vec<String>,
}

impl Finding {
    /// Notes a figure.
    pub fn figure(&mut self, text: impl Into<String>) {
        self.figures.push(text.into());
    }

    /// Notes what does not hold unless it does.
    pub fn expect(&mut self, holds: bool, otherwise: impl FnOnce() -> String) {
        if !holds {
            self.faults.push(otherwise());
        }
    }
}

/// What became of a row.
#[derive(Debug)]
pub enum Verdict {
    Run {
        finding: Finding,
        took: Duration,
    },
    /// It cannot run on this machine: why.
    Skipped(String),
    /// It broke off.
    Broken(String),
}

impl Verdict {
    pub fn is_no_failure(&self) -> bool {
        match self {
            Self::Run { finding, .. } => finding.faults.is_empty() && !finding.control.is_empty(),
            Self::Skipped(_) => true,
            Self::Broken(_) => false,
        }
    }
}

impl Row {
    /// Runs it.
    pub fn verdict(&self, form: Form) -> Verdict {
        if let Some(why) = (self.obstacle)() {
            return Verdict::Skipped(why);
        }
        let began = Instant::now();
        match catch_unwind(AssertUnwindSafe(|| (self.run)(form))) {
            Ok(finding) => Verdict::Run {
                finding,
                took: began.elapsed(),
            },
            Err(panic) => Verdict::Broken(words_of(&*panic)),
        }
    }
}

fn words_of(panic: &(dyn std::any::Any + Send)) -> String {
    let text = panic.downcast_ref::<String>().map(String::as_str);
    let text = text.or_else(|| panic.downcast_ref::<&str>().copied());
    text.unwrap_or("it panicked").to_owned()
}

/// Of a row that runs anywhere.
pub fn nothing_in_the_way() -> Option<String> {
    None
}

/// Runs what a row does.
pub fn run<T>(work: impl Future<Output = T>) -> T {
    Runtime::new().unwrap().block_on(work)
}
