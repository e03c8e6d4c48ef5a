//! From the journal to the map: workers that claim a batch, load its route, compute, and save
//! everything that came of it in one transaction.
//!
//! A job is never worked on inside a transaction. What a worker computed is refused by the store
//! if its lease was lost or the route has moved on; then it is dropped and computed anew. What
//! people decide about alerts takes the same way, without a job.
//!
//! Knows nothing of HTTP or SQL. Begin with `process` in `process.rs`, which computes one job.

mod accept;
mod alert_id;
mod alerts;
mod calibrate;
mod clock;
mod clock_faults;
mod decide;
mod decision_details;
mod decision_revision;
mod drawn_map;
mod edges;
mod engine;
mod findings;
mod operations;
mod options;
mod preview;
mod process;
mod refusal;
mod release;
mod remove;
mod replay;
mod residual_findings;
mod residuals;
mod result;
mod retention;
mod saved;
mod settle;
mod several;
mod shift;
mod stage;
mod suspects;
mod vehicles;
mod watch;
mod worker;
mod workspace;
mod zones;

pub use decide::{DecisionError, Decisions, Order, is_allowed};
pub use drawn_map::drawn_map;
pub use operations::Operations;
pub use options::PipelineOptions;
pub use preview::Preview;
pub use release::{ReleaseError, ReleaseOrder};
pub use replay::{Replayed, replay};
pub use residuals::{ResidualReading, Residuals};

use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;

use crate::store::Store;
use engine::Engine;

/// A pipeline that runs.
pub struct Pipeline {
    /// Takes decisions about alerts.
    pub decisions: Decisions,
    /// Takes long work on.
    pub operations: Operations,
    /// Workers; they end soon after the pipeline is told to stop.
    pub tasks: Vec<JoinHandle<()>>,
}

/// Starts the pipeline's workers on the current runtime. They end soon after `stopping` is
/// cancelled; a batch under way is finished first, unless the drain time ends before it.
///
/// # Errors
/// If the threads cannot be had.
pub fn start(
    store: &Store,
    options: PipelineOptions,
    stopping: &CancellationToken,
) -> anyhow::Result<Pipeline> {
    let engine = Engine::new(store, options)?;
    let mut tasks = worker::start(&engine, stopping);
    tasks.push(tokio::spawn(zones::end_in_time(
        store.clone(),
        stopping.clone(),
    )));
    let decisions = Decisions::new(engine);
    let operations = Operations::new(store);
    let carrying_out = operations
        .clone()
        .carry_out(decisions.clone(), stopping.clone());
    tasks.push(tokio::spawn(carrying_out));
    Ok(Pipeline {
        tasks,
        operations,
        decisions,
    })
}

#[cfg(test)]
mod tests;
