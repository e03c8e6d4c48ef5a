//! What workers and decisions share: the store, the maps in memory, the threads, a lock for each route.

use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Mutex, PoisonError};

use anyhow::{Context, anyhow};
use jiff::Timestamp;
use tokio::sync::{OwnedMutexGuard, oneshot};

use super::options::PipelineOptions;
use super::rebuild::hushed;
use super::workspace::Workspaces;
use crate::ids::RouteId;
use crate::store::{Store, StoreError};

/// Store, maps in memory, threads and locks; cheap to clone.
#[derive(Clone)]
pub(super) struct Engine {
    pub store: Store,
    pub workspaces: Arc<Workspaces>,
    pub options: PipelineOptions,
    pool: Arc<rayon::ThreadPool>,
    turns: Arc<Turns>,
}

impl Engine {
    /// An engine with as many threads as there are cores.
    ///
    /// # Errors
    /// If the threads cannot be started.
    pub fn new(store: &Store, options: PipelineOptions) -> anyhow::Result<Self> {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(Self::threads())
            .thread_name(|k| format!("map-{k}"))
            .build();
        Self::with_pool(store, options, pool)
    }

    /// An engine with one thread, of which neither the log nor the metrics tell.
    ///
    /// # Errors
    /// If the thread cannot be started.
    pub fn of_one_thread(store: &Store, options: PipelineOptions) -> anyhow::Result<Self> {
        let builder = rayon::ThreadPoolBuilder::new().num_threads(1);
        let builder = builder.spawn_handler(|thread| {
            let named = std::thread::Builder::new().name("rebuild-map".to_owned());
            named.spawn(|| hushed(|| thread.run())).map(drop)
        });
        Self::with_pool(store, options, builder.build())
    }

    fn with_pool(
        store: &Store,
        options: PipelineOptions,
        pool: Result<rayon::ThreadPool, rayon::ThreadPoolBuildError>,
    ) -> anyhow::Result<Self> {
        Ok(Self {
            store: store.clone(),
            workspaces: Arc::new(Workspaces::new(options.map_memory_bytes)),
            options,
            pool: Arc::new(pool.context("cannot start the worker threads")?),
            turns: Arc::new(Turns::default()),
        })
    }

    /// How many computations run in parallel.
    pub fn threads() -> usize {
        std::thread::available_parallelism().map_or(1, usize::from)
    }

    /// Runs a computation on the threads for it. A panic in it becomes an error.
    pub async fn compute<T: Send + 'static>(
        &self,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> anyhow::Result<T> {
        let (sender, receiver) = oneshot::channel();
        self.pool.spawn(move || {
            let outcome = catch_unwind(AssertUnwindSafe(work));
            // The receiver is gone at shutdown; its job is claimed again at the next start.
            let _ = sender.send(outcome);
        });
        match receiver.await.context("the worker thread is gone")? {
            Ok(value) => Ok(value),
            Err(panic) => Err(anyhow!("the computation panicked: {}", message_of(&*panic))),
        }
    }

    /// Locks a route's map, first come, first served. The store would refuse the second of two results
    /// anyway; this saves computing it.
    pub async fn turn(&self, route: &RouteId) -> OwnedMutexGuard<()> {
        self.turns.of(route).lock_owned().await
    }
}

/// The current time in the store's precision.
pub(super) fn now() -> Timestamp {
    as_kept(Timestamp::now())
}

/// A time in the store's precision (microseconds): the same before and after it was stored.
pub(super) fn as_kept(time: Timestamp) -> Timestamp {
    Timestamp::from_microsecond(time.as_microsecond()).unwrap_or(time)
}

/// Whether the store failed, and the same may succeed later.
pub(super) fn is_passing(error: &anyhow::Error) -> bool {
    let of_store = error.downcast_ref::<StoreError>();
    of_store.is_some_and(StoreError::is_passing)
}

/// One lock for each route.
#[derive(Default)]
struct Turns {
    by_route: Mutex<BTreeMap<RouteId, Arc<tokio::sync::Mutex<()>>>>,
}

impl Turns {
    fn of(&self, route: &RouteId) -> Arc<tokio::sync::Mutex<()>> {
        let mut turns = self.by_route.lock().unwrap_or_else(PoisonError::into_inner);
        turns.retain(|_, turn| Arc::strong_count(turn) > 1);
        Arc::clone(turns.entry(route.clone()).or_default())
    }
}

fn message_of(panic: &(dyn std::any::Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().map(|text| (*text).to_owned());
    text.or_else(|| panic.downcast_ref::<String>().cloned())
        .unwrap_or_else(|| "without a message".to_owned())
}
