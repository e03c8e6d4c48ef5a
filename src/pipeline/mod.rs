//! From the journal to the map: workers claim a job, load its route, compute, and save everything that
//! follows from it in one transaction. Decisions about alerts, removals and releases do the same without a
//! job.
//!
//! No transaction is open while a job is computed. The store refuses the result if the worker has lost its
//! lease or the route's revision has changed; it is then computed again.
//!
//! Must not know HTTP or SQL. Begin with `process` in `process.rs`: one batch in ten steps.

mod accept;
mod added;
mod alert_id;
mod alerts;
mod archive;
mod calibrate;
mod clock;
mod clock_faults;
mod clock_note;
mod decide;
mod decision_details;
mod decision_revision;
mod drawn_map;
mod drawn_scans;
mod edges;
mod engine;
mod findings;
mod operations;
mod options;
mod preview;
mod process;
mod rebuild;
mod rebuilt_alerts;
mod refusal;
mod release;
mod remove;
mod repeat;
mod replay;
mod residual_findings;
mod residuals;
mod result;
mod retention;
mod saved;
mod several;
mod shift;
mod stage;
mod suspects;
mod trip_start;
mod vehicles;
mod watch;
mod worker;
mod workspace;
mod zones;

pub use decide::{DecisionError, Decisions, Order, is_allowed};
pub use drawn_map::drawn_map;
pub use drawn_scans::DrawnScans;
pub use operations::Operations;
pub use options::PipelineOptions;
pub use preview::Preview;
pub use release::{ReleaseError, ReleaseOrder};
pub use repeat::Replayed;
pub use replay::replay;
pub use residuals::{ResidualReading, Residuals};

use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;

use crate::store::Store;
use engine::Engine;

/// A running pipeline.
pub struct Pipeline {
    /// Takes decisions about alerts.
    pub decisions: Decisions,
    /// Accepts long-running operations.
    pub operations: Operations,
    /// Workers and periodic tasks; they end soon after `stopping` is cancelled.
    pub tasks: Vec<JoinHandle<()>>,
}

/// Starts the pipeline's tasks on the current runtime. They end soon after `stopping` is cancelled; a batch
/// that is being processed is finished first, unless the drain time ends before.
///
/// # Errors
/// If the worker threads cannot be started.
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
    tasks.extend(operations.start(&decisions, stopping));
    Ok(Pipeline {
        tasks,
        operations,
        decisions,
    })
}

#[cfg(test)]
mod tests;
