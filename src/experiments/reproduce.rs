//! The paper's experiments: its tables and figures, and ours beside them.

mod baselines;
mod case;
mod counts;
mod figures;
mod fused_mode;
mod laps;
mod mapped;
mod method;
mod paper_mode;
mod protocol;
mod report;
mod run_one;
mod score;
mod summary;

pub use case::Seeds;
pub use figures::Figure;

use std::num::NonZeroUsize;

use anyhow::Context;
use rayon::iter::{IntoParallelIterator, ParallelIterator};

use case::Case;
use run_one::Outcome;
use summary::Summary;

/// What is reproduced.
#[derive(Debug, Clone, Copy)]
pub struct Protocol {
    /// A few small cases only: shows that everything runs, says little.
    pub short: bool,
    /// Every n-th case only.
    pub every: NonZeroUsize,
    /// Which seeds.
    pub seeds: Seeds,
}

/// What came of the paper's experiments.
#[derive(Debug)]
pub struct Reproduced {
    /// Tables, Markdown.
    pub tables: String,
    /// The numbers behind them, JSON.
    pub numbers: Vec<u8>,
    /// The paper's figures.
    pub figures: Vec<Figure>,
}

impl Protocol {
    /// How many cases there are, and laps in them.
    pub fn size(&self) -> (usize, usize) {
        let cases = self.cases();
        (cases.len(), cases.iter().map(Case::laps).sum())
    }

    fn cases(&self) -> Vec<Case> {
        let cases = protocol::cases(self.short, self.seeds);
        cases.into_iter().step_by(self.every.get()).collect()
    }

    /// Runs the cases side by side, and calls `advance` after each.
    ///
    /// # Errors
    /// If a case could not be run.
    pub fn run(&self, advance: impl Fn() + Sync) -> anyhow::Result<Reproduced> {
        let outcomes = self.cases().into_par_iter().map(|case| {
            let outcome = run_one::run(&case).with_context(|| case.name())?;
            advance();
            anyhow::Ok(outcome)
        });
        let outcomes: Vec<Outcome> = outcomes.collect::<anyhow::Result<_>>()?;
        let summary = Summary::of(outcomes, self.seeds, self.short);
        Ok(Reproduced {
            tables: text_of(&summary),
            numbers: serde_json::to_vec_pretty(&summary)?,
            figures: figures::draw(self.short, self.seeds)?,
        })
    }
}

fn text_of(summary: &Summary) -> String {
    let tables: Vec<String> = report::tables(summary).iter().map(|t| t.text()).collect();
    format!(
        "{} cases, {} laps; closures: {} in the maps as of the service's `seed`, {} in the \
         paper's own, {} in the robust maps; shares with Wilson's 95 % interval and counts.\n\n{}",
        summary.cases,
        summary.laps,
        summary.closures.seed,
        summary.closures.faithful,
        summary.closures.robust,
        tables.join("\n")
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_case_comes_out_the_same_each_time() {
        let case = protocol::cases(true, Seeds::Tuning).remove(2);
        let outcome = || serde_json::to_string(&run_one::run(&case).unwrap()).unwrap();
        assert_eq!(outcome(), outcome());
    }
}
