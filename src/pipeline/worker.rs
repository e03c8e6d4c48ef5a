//! Tasks that claim jobs and see them through.

use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, anyhow};
use jiff::Timestamp;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;
use tokio_util::task::AbortOnDropHandle;

use super::clock::{are_on_time, steadily_behind_ns};
use super::edges::{EdgeJob, process_edges};
use super::engine::{Engine, now};
use super::process::{Known, process};
use super::refusal::{Processed, of_quarantine, refuse};
use super::retention::{delete_bodies, delete_trajectories};
use super::settle::{recall_named, recall_trip, settle, solve_recalled};
use super::watch::Watch;
use super::workspace::Workspace;
use crate::ids::{RouteId, TripId, VehicleId};
use crate::model::{BatchKind, Detector};
use crate::solver::Interrupt;
use crate::store::{Applied, ClaimedJob, JobResult, JournalEntry, Store, StoreError, TripStart};

/// A worker that is lost gives its route back after this time.
const LEASE: Duration = Duration::from_secs(600);
/// How often a job is computed before somebody's decisions in between count as a failure.
const COMPUTATIONS_MAX: usize = 4;
/// How often work is looked for without a hint.
const LOOK: Duration = Duration::from_secs(1);
/// How often held batches are looked through.
const RELEASE: Duration = Duration::from_secs(5);

/// Starts as many workers as there are cores, the task that releases held batches, and those
/// that delete old bodies and trajectories. They end soon after `stopping` is cancelled; a batch under way is finished
/// first, unless the drain time ends before it; then it is claimed again at the next start.
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
    tasks
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
    engine: Engine,
}

impl Worker {
    async fn run(self, stopping: CancellationToken) {
        while !stopping.is_cancelled() {
            match self.engine.store.claim_job(now(), LEASE).await {
                Ok(Some(job)) => self.see_through(job, &stopping).await,
                Ok(None) => idle(&self.engine.store, &stopping).await,
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
        if matches!(self.engine.store.route(&route).await, Ok(None)) {
            tracing::info!(%route, job_id, "the route was deleted while a batch of it was processed");
            return;
        }
        let reason = format!("{error:#}");
        let failure = Failure::of(&error);
        tracing::error!(%route, job_id, reason, ?failure, "a batch could not be processed");
        while let Err(error) = self.hand_back(job_id, generation, &reason, failure).await {
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
        failure: Failure,
    ) -> Result<(), StoreError> {
        let (store, now) = (&self.engine.store, Timestamp::now());
        match failure {
            Failure::OfStore => store.return_job(job_id, generation, now).await,
            Failure::OfBatch => store.fail_job(job_id, generation, reason, now).await,
            Failure::ForGood => store.give_up_job(job_id, generation, reason, now).await,
        }
    }

    /// Load, compute, save; anew if somebody's decision came in between.
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
                    return Err(anyhow!("the job is somebody else's by now"));
                }
                Applied::Stale => {}
            }
        }
        Err(anyhow!("the route has moved on meanwhile"))
    }

    /// Computes a job, and no longer than while somebody waits for it.
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
        // What was computed to its end may rest on a solve that was broken off.
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

/// Loads what a job needs and computes it, after what has settled has left the map.
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
            let recalled = recall_trip(store, route, &trip).await?;
            let mut workspace = engine.workspaces.take(store, route).await?;
            workspace.map.heed(interrupt);
            let known = known_start(store, &workspace, job).await?;
            let work = move || {
                solve_recalled(&mut workspace.map, &recalled);
                settle(&mut workspace, &trip, &[], &options)?;
                process(workspace, &kept_job, &known)
            };
            engine.compute(work).await??
        }
        BatchKind::Edges => {
            let decoded = Arc::clone(job);
            let mut edges = engine.compute(move || EdgeJob::decode(&decoded)).await??;
            edges.look_up(store, job).await?;
            let named = edges.named_nodes();
            let recalled = recall_named(store, route, &named, &[]).await?;
            let mut workspace = engine.workspaces.take(store, route).await?;
            workspace.map.heed(interrupt);
            let work = move || {
                solve_recalled(&mut workspace.map, &recalled);
                settle(&mut workspace, &trip, &named, &options)?;
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

/// What is known of a job's trip: decided when it began, by what its vehicle's trips had said by then
/// in the order of the jobs.
pub(super) async fn known_start(
    store: &Store,
    workspace: &Workspace,
    job: &ClaimedJob,
) -> Result<Known, StoreError> {
    let Some(JournalEntry { batch, .. }) = job.entries.last() else {
        return Ok(Known::Decided {
            start: TripStart::default(),
            behind_ns: None,
        });
    };
    let (route, trip, vehicle) = (&job.route_id, &batch.trip_id, &batch.vehicle_id);
    if let Some(start) = store.trip_start(route, trip).await? {
        let is_believed = start.clock_ahead_ns == 0 && !workspace.clock_faults.has(trip);
        let behind_ns = match is_believed && workspace.detector == Detector::Fused {
            true => found_behind_ns(store, route, vehicle, trip).await?,
            false => None,
        };
        return Ok(Known::Decided { start, behind_ns });
    }
    let newest = workspace.calibrations.newest_trip(vehicle);
    let before = match newest {
        Some(trip) => store.trip_start(route, trip).await?,
        None => None,
    };
    Ok(Known::Before {
        corrections: before.unwrap_or_default().corrections,
        uploads: store.upload_lags(route, vehicle, trip).await?,
    })
}

/// How far the clock of a trip that is driven is behind, by its batches so far and the vehicles that are on
/// time, nanoseconds.
async fn found_behind_ns(
    store: &Store,
    route: &RouteId,
    vehicle: &VehicleId,
    trip: &TripId,
) -> Result<Option<i64>, StoreError> {
    let own = store.trip_lags(route, trip).await?;
    let Some(behind_ns) = steadily_behind_ns(&own) else {
        return Ok(None);
    };
    let others = store.lags_of_others(route, vehicle, trip).await?;
    Ok(Some(behind_ns).filter(|_| are_on_time(&others)))
}

/// A job was interrupted.
#[derive(Debug, thiserror::Error)]
#[error("processing it took far longer than a batch of its size should take, and was broken off")]
struct TookTooLong;

/// What to do about a job that failed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Failure {
    /// The store was in the way, and not the batch: it is tried again.
    OfStore,
    /// It is tried again, a few times.
    OfBatch,
    /// Another try would not help.
    ForGood,
}

impl Failure {
    fn of(error: &anyhow::Error) -> Self {
        let of_store = error.downcast_ref::<StoreError>();
        match of_store.is_some_and(StoreError::is_passing) {
            true => Self::OfStore,
            false if error.is::<TookTooLong>() => Self::ForGood,
            false => Self::OfBatch,
        }
    }
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
