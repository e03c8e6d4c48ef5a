//! The only place that speaks SQL: routes, the durable journal of uploads, jobs, graphs.

mod records;

pub use records::*;

use std::path::PathBuf;
use std::time::Duration;

use jiff::Timestamp;

use crate::ids::{BatchId, EdgeId, NodeId, RouteId, TripId};

/// Where and how to open the store.
#[derive(Debug, Clone)]
pub struct StoreOptions {
    /// The directory that holds the database; created if missing, locked while open.
    pub data_dir: PathBuf,
}

/// The store; cheap to clone.
#[derive(Clone)]
pub struct Store {}

/// Whether a PUT made something new.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Put {
    /// It was not there before.
    Created,
    /// It was changed.
    Updated,
}

/// Why the store could not do it.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// The disk is full; nothing was written.
    #[error("the disk is full")]
    Full,
    /// The writer is overloaded or shutting down; nothing was written.
    #[error("the store does not take writes at the moment")]
    Unavailable,
    /// The route is not there.
    #[error("there is no such route")]
    UnknownRoute,
    /// Another process holds the data directory.
    #[error("the data directory {0} is in use by another process")]
    Locked(PathBuf),
}

#[allow(clippy::todo, unused_variables, missing_docs)]
impl Store {
    pub async fn open(options: StoreOptions) -> Result<Self, StoreError> {
        todo!()
    }
    /// Waits for the writes that were taken and closes the database.
    pub async fn close(self) -> Result<(), StoreError> {
        todo!()
    }
    /// Whether the writer takes writes and a reader answers; the error says why not.
    pub async fn check_ready(&self) -> Result<(), StoreError> {
        todo!()
    }
    /// Resolves when a job may be ready to claim (a hint: claim_job decides).
    pub async fn job_hint(&self) {
        todo!()
    }

    pub async fn put_route(
        &self,
        id: &RouteId,
        update: RouteUpdate,
        now: Timestamp,
    ) -> Result<Put, StoreError> {
        todo!()
    }
    pub async fn route(&self, id: &RouteId) -> Result<Option<RouteRecord>, StoreError> {
        todo!()
    }
    /// By id, after `after`, at most `limit`.
    pub async fn routes(
        &self,
        after: Option<&RouteId>,
        limit: u32,
    ) -> Result<Vec<RouteRecord>, StoreError> {
        todo!()
    }
    /// Whether it was there.
    pub async fn delete_route(&self, id: &RouteId) -> Result<bool, StoreError> {
        todo!()
    }

    pub async fn journal_batch(&self, batch: NewBatch) -> Result<Journaled, StoreError> {
        todo!()
    }
    pub async fn batch(
        &self,
        route: &RouteId,
        id: &BatchId,
    ) -> Result<Option<BatchRecord>, StoreError> {
        todo!()
    }
    /// In the order of arrival.
    pub async fn batches(
        &self,
        route: &RouteId,
        filter: &BatchFilter,
        after: Option<&BatchId>,
        limit: u32,
    ) -> Result<Vec<BatchRecord>, StoreError> {
        todo!()
    }

    /// The oldest job whose time has come on a route that no live lease holds.
    pub async fn claim_job(
        &self,
        now: Timestamp,
        lease: Duration,
    ) -> Result<Option<ClaimedJob>, StoreError> {
        todo!()
    }
    pub async fn apply_result(&self, result: JobResult) -> Result<Applied, StoreError> {
        todo!()
    }
    /// Puts a failed job back with a delay, or quarantines its batch after the last try.
    pub async fn fail_job(
        &self,
        job_id: i64,
        generation: i64,
        reason: &str,
        now: Timestamp,
    ) -> Result<(), StoreError> {
        todo!()
    }
    /// Queues held batches whose `hold_s` is over; returns how many.
    pub async fn release_overdue(&self, now: Timestamp) -> Result<u64, StoreError> {
        todo!()
    }

    pub async fn load_graph(&self, route: &RouteId) -> Result<Option<RouteGraph>, StoreError> {
        todo!()
    }
    pub async fn nodes(&self, route: &RouteId) -> Result<Vec<NodeRecord>, StoreError> {
        todo!()
    }
    pub async fn node(
        &self,
        route: &RouteId,
        id: NodeId,
    ) -> Result<Option<NodeRecord>, StoreError> {
        todo!()
    }
    /// Every active node with its scan, by id: what a map picture is drawn from.
    pub async fn nodes_with_scans(&self, route: &RouteId) -> Result<Vec<NodeWithScan>, StoreError> {
        todo!()
    }
    pub async fn node_scan(
        &self,
        route: &RouteId,
        id: NodeId,
    ) -> Result<Option<Vec<u8>>, StoreError> {
        todo!()
    }
    pub async fn trip_nodes(
        &self,
        route: &RouteId,
        trip: &TripId,
    ) -> Result<Vec<NodeRecord>, StoreError> {
        todo!()
    }
    pub async fn edges(&self, route: &RouteId) -> Result<Vec<EdgeRecord>, StoreError> {
        todo!()
    }
    pub async fn edge(
        &self,
        route: &RouteId,
        id: EdgeId,
    ) -> Result<Option<EdgeRecord>, StoreError> {
        todo!()
    }
}
