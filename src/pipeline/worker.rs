//! Tasks that claim jobs and see them through.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, anyhow};
use jiff::Timestamp;
use tokio::sync::oneshot;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;

use super::process::process;
use super::workspace::Workspaces;
use crate::store::{Applied, ClaimedJob, Store, StoreError};

/// A worker that is lost gives its route back after this time.
const LEASE: Duration = Duration::from_secs(600);
/// How often work is looked for without a hint.
const LOOK: Duration = Duration::from_secs(1);
/// How often held batches are looked through.
const RELEASE: Duration = Duration::from_secs(5);

/// Starts as many workers as there are cores, and the task that releases held batches. They end
/// soon after `stopping` is cancelled; a batch under way is finished
/// first, unless the drain time ends before it; then it is claimed again at the next start.
///
/// # Errors
/// If the threads cannot be had.
pub fn start_workers(
    store: &Store,
    stopping: &CancellationToken,
) -> anyhow::Result<Vec<JoinHandle<()>>> {
    let count = std::thread::available_parallelism().map_or(1, usize::from);
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(count)
        .thread_name(|k| format!("map-{k}"))
        .build()
        .context("cannot start the worker threads")?;
    let worker = Worker {
        store: store.clone(),
        workspaces: Arc::new(Workspaces::default()),
        pool: Arc::new(pool),
    };
    let mut tasks: Vec<JoinHandle<()>> = (0..count)
        .map(|_| tokio::spawn(worker.clone().run(stopping.clone())))
        .collect();
    tasks.push(tokio::spawn(release_held(store.clone(), stopping.clone())));
    Ok(tasks)
}

async fn release_held(store: Store, stopping: CancellationToken) {
    while tokio::time::timeout(RELEASE, stopping.cancelled())
        .await
        .is_err()
    {
        if let Err(error) = store.release_overdue(Timestamp::now()).await {
            tracing::warn!(%error, "held batches could not be looked through");
        }
    }
}

#[derive(Clone)]
struct Worker {
    store: Store,
    workspaces: Arc<Workspaces>,
    pool: Arc<rayon::ThreadPool>,
}

impl Worker {
    async fn run(self, stopping: CancellationToken) {
        while !stopping.is_cancelled() {
            match self.store.claim_job(Timestamp::now(), LEASE).await {
                Ok(Some(job)) => self.see_through(job, &stopping).await,
                Ok(None) => idle(&self.store, &stopping).await,
                Err(error) => {
                    tracing::warn!(%error, "no job could be claimed");
                    pause(&stopping).await;
                }
            }
        }
    }

    async fn see_through(&self, job: ClaimedJob, stopping: &CancellationToken) {
        let (job_id, generation, route) = (job.job_id, job.generation, job.route_id.clone());
        let Err(error) = self.attempt(job).await else {
            return;
        };
        let reason = format!("{error:#}");
        let passing = is_passing(&error);
        tracing::error!(%route, job_id, reason, passing, "a batch could not be processed");
        while let Err(error) = self.hand_back(job_id, generation, &reason, passing).await {
            tracing::error!(%route, job_id, %error, "nor could that be noted");
            if stopping.is_cancelled() {
                return;
            }
            pause(stopping).await;
        }
    }

    async fn hand_back(
        &self,
        job_id: i64,
        generation: i64,
        reason: &str,
        passing: bool,
    ) -> Result<(), StoreError> {
        let now = Timestamp::now();
        if passing {
            return self.store.return_job(job_id, generation, now).await;
        }
        self.store.fail_job(job_id, generation, reason, now).await
    }

    /// Load, compute, save.
    async fn attempt(&self, job: ClaimedJob) -> anyhow::Result<()> {
        let route = job.route_id.clone();
        let workspace = self.workspaces.take(&self.store, &route).await?;
        let (workspace, result) = self.compute(move || process(workspace, &job)).await??;
        match self.store.apply_result(result).await? {
            Applied::Committed => {
                self.workspaces.put_back(route, workspace.saved());
                Ok(())
            }
            Applied::Stale => Err(anyhow!("the route has moved on meanwhile")),
        }
    }

    async fn compute<T: Send + 'static>(
        &self,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> anyhow::Result<T> {
        let (sender, receiver) = oneshot::channel();
        self.pool.spawn(move || {
            let outcome = catch_unwind(AssertUnwindSafe(work));
            // A receiver that is gone was cut off at shutdown: the job is claimed again.
            let _ = sender.send(outcome);
        });
        match receiver.await.context("the worker thread is gone")? {
            Ok(value) => Ok(value),
            Err(panic) => Err(anyhow!("the computation panicked: {}", message_of(&*panic))),
        }
    }
}

/// Whether the store was in the way, and not the batch.
fn is_passing(error: &anyhow::Error) -> bool {
    error
        .downcast_ref::<StoreError>()
        .is_some_and(StoreError::is_passing)
}

fn message_of(panic: &(dyn std::any::Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().map(|text| (*text).to_owned());
    text.or_else(|| panic.downcast_ref::<String>().cloned())
        .unwrap_or_else(|| "without a message".to_owned())
}

async fn idle(store: &Store, stopping: &CancellationToken) {
    tokio::select! {
        () = store.job_hint() => {}
        () = tokio::time::sleep(LOOK) => {}
        () = stopping.cancelled() => {}
    }
}

async fn pause(stopping: &CancellationToken) {
    tokio::select! {
        () = tokio::time::sleep(LOOK) => {}
        () = stopping.cancelled() => {}
    }
}
