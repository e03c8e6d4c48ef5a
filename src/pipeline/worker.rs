//! Tasks that claim jobs and process them.

use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, anyhow};
use jiff::Timestamp;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;
use tokio_util::task::AbortOnDropHandle;

use super::archive::{archive, reactivate_named, reactivate_trip, solve_reactivated};
use super::edges::{EdgeJob, process_edges};
use super::engine::{Engine, is_passing, now};
use super::process::process;
use super::refusal::{Processed, of_quarantine, refuse};
use super::retention::{delete_bodies, delete_trajectories, redact_names};
use super::trip_start::known_start;
use super::watch::Watch;
use super::workspace::Workspace;
use crate::ids::RouteId;
use crate::model::BatchKind;
use crate::solver::Interrupt;
use crate::store::{Applied, ClaimedJob, JobResult, Store, StoreError};

/// A lost worker's job can be claimed by another one after this time.
const LEASE: Duration = Duration::from_secs(600);
/// How often a job is computed again because a decision changed the route meanwhile, before it fails.
const COMPUTATIONS_MAX: usize = 4;
/// How often workers poll for jobs without being woken.
const POLL: Duration = Duration::from_secs(1);
/// How often overdue held batches are released.
const RELEASE: Duration = Duration::from_secs(5);

/// Starts one worker for each core, the task that releases overdue held batches, those that delete old bodies
/// and trajectories, and the one that redacts old names. They end soon after `stopping` is cancelled. A batch
/// that is being processed is finished first; if the drain time ends before, it is claimed again at the next
/// start.
pub(super) fn start(engine: &Engine, stopping: &CancellationToken) -> Vec<JoinHandle<()>> {
    let worker = Worker {
        engine: engine.clone(),
    };
    let mut tasks: Vec<JoinHandle<()>> = (0..Engine::threads())
        .map(|_| tokio::spawn(worker.clone().run(stopping.clone())))
        .collect();
    let store = engine.store.clone();
    tasks.push(tokio::spawn(release_held(store, stopping.clone())));
    if let Some(kept) = engine.options.keep_bodies {
        let store = engine.store.clone();
        tasks.push(tokio::spawn(delete_bodies(store, kept, stopping.clone())));
    }
    if let Some(kept) = engine.options.keep_trajectories {
        let deleting = delete_trajectories(engine.store.clone(), kept, stopping.clone());
        tasks.push(tokio::spawn(deleting));
    }
    if let Some(kept) = engine.options.keep_names {
        let redacting = redact_names(engine.store.clone(), kept, stopping.clone());
        tasks.push(tokio::spawn(redacting));
    }
    tasks
}

async fn release_held(store: Store, stopping: CancellationToken) {
    while tokio::time::timeout(RELEASE, stopping.cancelled())
        .await
        .is_err()
    {
        if let Err(error) = store.release_overdue(Timestamp::now()).await {
            tracing::warn!(%error, "overdue held batches could not be released");
        }
    }
}

#[derive(Clone)]
struct Worker {
    engine: Engine,
}

impl Worker {
    async fn run(self, stopping: CancellationToken) {
        while !stopping.is_cancelled() {
            match self.engine.store.claim_job(now(), LEASE).await {
                Ok(Some(job)) => self.process_job(job, &stopping).await,
                Ok(None) => idle(&self.engine.store, &stopping).await,
                Err(error) => {
                    tracing::warn!(%error, "no job could be claimed");
                    pause(&stopping).await;
                }
            }
        }
    }

    async fn process_job(&self, job: ClaimedJob, stopping: &CancellationToken) {
        let (job_id, generation, route) = (job.job_id, job.generation, job.route_id.clone());
        let Err(error) = self.attempt(job).await else {
            return;
        };
        if matches!(self.engine.store.route(&route).await, Ok(None)) {
            tracing::info!(%route, job_id, "the route was deleted while a batch of it was processed");
            return;
        }
        let reason = format!("{error:#}");
        let failure = Failure::of(&error);
        tracing::error!(%route, job_id, reason, ?failure, "a batch could not be processed");
        while let Err(error) = self
            .record_failure(job_id, generation, &reason, failure)
            .await
        {
            tracing::error!(%route, job_id, %error, "the failure could not be recorded");
            if stopping.is_cancelled() {
                return;
            }
            pause(stopping).await;
        }
    }

    async fn record_failure(
        &self,
        job_id: i64,
        generation: i64,
        reason: &str,
        failure: Failure,
    ) -> Result<(), StoreError> {
        let (store, now) = (&self.engine.store, Timestamp::now());
        match failure {
            Failure::OfStore => store.return_job(job_id, generation, now).await,
            Failure::OfBatch => store.fail_job(job_id, generation, reason, now).await,
            Failure::ForGood => store.give_up_job(job_id, generation, reason, now).await,
        }
    }

    /// Loads, computes and saves; again if a decision changed the route meanwhile.
    async fn attempt(&self, job: ClaimedJob) -> anyhow::Result<()> {
        let job = Arc::new(job);
        let route = &job.route_id;
        let _turn = self.engine.turn(route).await;
        for _ in 0..COMPUTATIONS_MAX {
            let (workspace, result) = self.compute_watched(&job).await?;
            let base_revision = result.base_revision;
            match self.engine.store.apply_result(result).await? {
                Applied::Committed => {
                    let saved = workspace.saved();
                    self.engine.workspaces.put_back(route.clone(), saved);
                    return Ok(());
                }
                Applied::Stale if self.is_at(route, base_revision).await? => {
                    return Err(anyhow!("another worker has claimed the job meanwhile"));
                }
                Applied::Stale => {}
            }
        }
        Err(anyhow!(
            "the route kept changing while the job was computed"
        ))
    }

    /// Computes a job, interrupted if its route is deleted or it takes too long.
    async fn compute_watched(
        &self,
        job: &Arc<ClaimedJob>,
    ) -> anyhow::Result<(Workspace, JobResult)> {
        let interrupt = Interrupt::default();
        let watch = Watch {
            store: self.engine.store.clone(),
            job: Arc::clone(job),
            interrupt: interrupt.clone(),
        };
        let _watching = AbortOnDropHandle::new(tokio::spawn(watch.keep()));
        let computed = compute(&self.engine, job, &interrupt).await;
        // A result computed to the end may still rest on an interrupted solve.
        match interrupt.is_raised() {
            true => Err(TookTooLong.into()),
            false => computed,
        }
    }

    async fn is_at(&self, route: &RouteId, revision: i64) -> Result<bool, StoreError> {
        let route = self.engine.store.route(route).await?;
        Ok(route.is_none_or(|route| route.revision == revision))
    }
}

/// Loads what a job needs, archives nodes that are no longer needed, and computes the job.
pub(super) async fn compute(
    engine: &Engine,
    job: &Arc<ClaimedJob>,
    interrupt: &Interrupt,
) -> anyhow::Result<(Workspace, JobResult)> {
    let Engine { store, options, .. } = engine;
    let own = job.entries.last().context("a job without batches")?;
    let (trip, options) = (own.batch.trip_id.clone(), *options);
    let (route, kept_job) = (&job.route_id, Arc::clone(job));
    let vehicle = &own.batch.vehicle_id;
    if let Some(quarantine) = store.quarantine(route, vehicle).await? {
        return refuse(engine, job, of_quarantine(job, vehicle, &quarantine)).await;
    }
    let processed = match own.batch.kind {
        BatchKind::Scans => {
            let reactivated = reactivate_trip(store, route, &trip).await?;
            let mut workspace = engine.workspaces.take(store, route).await?;
            workspace.map.heed(interrupt);
            let known = known_start(store, &workspace, job).await?;
            let work = move || {
                solve_reactivated(&mut workspace.map, &reactivated);
                archive(&mut workspace, &trip, &[], &options)?;
                process(workspace, &kept_job, &known)
            };
            engine.compute(work).await??
        }
        BatchKind::Edges => {
            let decoded = Arc::clone(job);
            let mut edges = engine.compute(move || EdgeJob::decode(&decoded)).await??;
            edges.look_up(store, job).await?;
            let named = edges.named_nodes();
            let reactivated = reactivate_named(store, route, &named, &[]).await?;
            let mut workspace = engine.workspaces.take(store, route).await?;
            workspace.map.heed(interrupt);
            let work = move || {
                solve_reactivated(&mut workspace.map, &reactivated);
                archive(&mut workspace, &trip, &named, &options)?;
                process_edges(workspace, &kept_job, &edges)
            };
            engine.compute(work).await??
        }
    };
    match processed {
        Processed::Taken(taken) => Ok(*taken),
        Processed::Refused(refusal) => refuse(engine, job, refusal).await,
    }
}

/// A job was interrupted.
#[derive(Debug, thiserror::Error)]
#[error("processing it took far longer than a batch of its size should take, and was broken off")]
struct TookTooLong;

/// What failed, and whether the job is tried again.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Failure {
    /// The store failed, not the batch: the job is tried again.
    OfStore,
    /// The job is tried again a few times.
    OfBatch,
    /// Another attempt would not help.
    ForGood,
}

impl Failure {
    fn of(error: &anyhow::Error) -> Self {
        match is_passing(error) {
            true => Self::OfStore,
            false if error.is::<TookTooLong>() => Self::ForGood,
            false => Self::OfBatch,
        }
    }
}

async fn idle(store: &Store, stopping: &CancellationToken) {
    tokio::select! {
        () = store.job_hint() => {}
        () = tokio::time::sleep(POLL) => {}
        () = stopping.cancelled() => {}
    }
}

async fn pause(stopping: &CancellationToken) {
    tokio::select! {
        () = tokio::time::sleep(POLL) => {}
        () = stopping.cancelled() => {}
    }
}
