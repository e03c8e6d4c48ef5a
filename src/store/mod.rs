//! The only place that speaks SQL: routes, the durable journal of uploads, jobs, graphs.
//!
//! An embedded SQLite in a directory that one process holds. Everything that writes is a
//! request to the one writer task, which executes what has queued up in one transaction
//! and answers after the commit has reached the disk; a caller that goes away meanwhile changes
//! nothing. Reads run on a few connections of their own, short and side by side.

mod acceptances;
mod alert_records;
mod alert_rows;
mod alerts;
mod archive;
mod body;
mod claims;
mod client_nodes;
mod columns;
mod connection;
mod decisions;
mod error;
mod export;
mod failures;
mod gaps;
mod graph;
mod graph_rows;
mod inbox;
mod intermediate_scans;
mod jobs;
mod journal;
mod lock;
mod map_versions;
mod migrations;
mod records;
mod request;
mod results;
mod retention;
mod routes;
mod series_closures;
mod settled;
mod trips;
mod vehicles;
mod webhook_attempts;
mod webhook_deliveries;
mod webhook_records;
mod webhooks;
mod writer;

pub use alert_records::*;
pub use archive::SubgraphSums;
pub use error::{Corruption, StoreError};
pub use export::{GraphPart, Pieces, Within};
pub use records::*;
pub use series_closures::{SeriesClosure, SeriesClosures};
pub use vehicles::{LidarRecord, TripCalibrationRecord, VehicleRecord};
pub use webhook_records::*;

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use jiff::Timestamp;
use sqlx::SqlitePool;
use tokio::sync::{Mutex, Notify, watch};
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;

use crate::ids::{AlertId, BatchId, EdgeId, NodeId, RouteId, TripId, VehicleId};
use connection::Database;
use inbox::Outbox;
use lock::DirectoryLock;
use request::Reply;
use writer::{Health, Writer};

/// Where and how to open the store.
#[derive(Debug, Clone)]
pub struct StoreOptions {
    /// The directory that holds the database; created if missing, locked while open.
    pub data_dir: PathBuf,
}

/// The store; cheap to clone.
#[derive(Clone)]
pub struct Store {
    shared: Arc<Shared>,
}

struct Shared {
    database: Database,
    outbox: Outbox,
    readers: SqlitePool,
    health: watch::Receiver<Health>,
    jobs: Arc<Notify>,
    shutdown: CancellationToken,
    writer: Mutex<Option<JoinHandle<Result<(), StoreError>>>>,
    // After the readers: whoever takes the lock next finds no connection of ours.
    _lock: Arc<DirectoryLock>,
}

/// Whether a PUT made something new.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Put {
    /// It was not there before.
    Created,
    /// It was changed.
    Updated,
}

impl Store {
    /// Locks the directory, brings the schema up to date, gives back the jobs of a process that
    /// died, and starts the writer on the current runtime.
    ///
    /// # Errors
    /// [`StoreError::Locked`] if another process holds the directory.
    pub async fn open(options: StoreOptions) -> Result<Self, StoreError> {
        let data_dir = options.data_dir.clone();
        let lock = tokio::task::spawn_blocking(move || DirectoryLock::acquire(&data_dir))
            .await
            .map_err(|_| StoreError::Unavailable)??;
        let lock = Arc::new(lock);
        let database = Database::in_directory(&options.data_dir);
        let mut connection = database.open_writer().await?;
        let migrated = database.migrate(&mut connection).await?;
        if migrated.rates_set > 0 {
            tracing::warn!(
                routes = migrated.rates_set,
                false_alarm_rate = RouteSettings::default().false_alarm_rate,
                "false_alarm_rate means false alerts per lap now: every route was set to the default"
            );
        }
        jobs::release_orphans(&mut connection).await?;
        let readers = database.open_readers().await?;

        let (outbox, inbox) = inbox::queues();
        let (health_sender, health) = watch::channel(Health::Ready);
        let jobs = Arc::new(Notify::new());
        let shutdown = CancellationToken::new();
        let writer = Writer {
            database: database.clone(),
            connection: Some(connection),
            inbox,
            health: health_sender,
            jobs: Arc::clone(&jobs),
            shutdown: shutdown.clone(),
            lock: Arc::clone(&lock),
        };
        let shared = Shared {
            database,
            outbox,
            readers,
            health,
            jobs,
            shutdown,
            writer: Mutex::new(Some(tokio::spawn(writer.run()))),
            _lock: lock,
        };
        Ok(Self {
            shared: Arc::new(shared),
        })
    }

    /// Waits for the writes that were taken and closes the database. Other clones get
    /// [`StoreError::Unavailable`] from now on.
    ///
    /// # Errors
    /// [`StoreError`] if the log could not be moved into the database; nothing acknowledged is
    /// lost by that.
    pub async fn close(self) -> Result<(), StoreError> {
        self.shared.shutdown.cancel();
        let writer = self.shared.writer.lock().await.take();
        let closed = match writer {
            Some(writer) => writer.await.map_err(|_| StoreError::Unavailable)?,
            None => Ok(()),
        };
        self.shared.readers.close().await;
        closed.map_err(StoreError::named)
    }

    /// Whether the writer takes writes and a reader answers; the error says why not.
    ///
    /// # Errors
    /// [`StoreError::Full`], [`StoreError::Unavailable`], [`StoreError::Corrupt`].
    pub async fn check_ready(&self) -> Result<(), StoreError> {
        if self.shared.shutdown.is_cancelled() {
            return Err(StoreError::Unavailable);
        }
        let health = *self.shared.health.borrow();
        if let Some(refusal) = health.refusal() {
            return Err(refusal);
        }
        self.routes(None, 1).await.map(|_| ())
    }

    /// Resolves when a job may be ready to claim (a hint: [`Store::claim_job`] decides). A hint
    /// may be missed, and a job may become ready by time alone: look from time to time as well.
    pub async fn job_hint(&self) {
        self.shared.jobs.notified().await;
    }

    /// Creates a route or changes it.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn put_route(
        &self,
        id: &RouteId,
        update: RouteUpdate,
        now: Timestamp,
    ) -> Result<Put, StoreError> {
        let id = id.clone();
        self.work(routes::PutRoute { id, update, now }).await
    }

    /// One route.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn route(&self, id: &RouteId) -> Result<Option<RouteRecord>, StoreError> {
        named(routes::route(&self.shared.readers, id).await)
    }

    /// By id, after `after`, at most `limit`.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn routes(
        &self,
        after: Option<&RouteId>,
        limit: u32,
    ) -> Result<Vec<RouteRecord>, StoreError> {
        named(routes::routes(&self.shared.readers, after, limit).await)
    }

    /// Deletes a route with its uploads, jobs and graph. Returns whether it was there.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn delete_route(&self, id: &RouteId) -> Result<bool, StoreError> {
        self.work(routes::DeleteRoute(id.clone())).await
    }

    /// Stores an upload and, if it is its turn in its trip, its job. Returns after the commit has
    /// reached the disk. What is wrong with its place in its trip becomes its status.
    ///
    /// # Errors
    /// [`StoreError::UnknownRoute`], [`StoreError::Full`], [`StoreError::Unavailable`].
    pub async fn journal_batch(&self, mut batch: NewBatch) -> Result<Journaled, StoreError> {
        let body = std::mem::take(&mut batch.body);
        // Compressing a large body takes milliseconds: not on the async threads, not in the
        // writer.
        let body = tokio::task::spawn_blocking(move || body::SealedBody::seal(&body))
            .await
            .map_err(|_| StoreError::Unavailable)??;
        let request = journal::Journal { batch, body };
        let reply = self.shared.outbox.send_upload(request).await?;
        let journaled = outcome::<journal::Journal>(reply).await?;
        journaled.ok_or(StoreError::UnknownRoute)
    }

    /// One upload.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn batch(
        &self,
        route: &RouteId,
        id: &BatchId,
    ) -> Result<Option<BatchRecord>, StoreError> {
        named(journal::batch(&self.shared.readers, route, id).await)
    }

    /// One upload with its body; `None` also if the body was deleted when its time was over.
    ///
    /// # Errors
    /// [`StoreError::Corrupt`] with [`Corruption::Body`] if the body has lost its checksum.
    pub async fn journal_entry(
        &self,
        route: &RouteId,
        id: &BatchId,
    ) -> Result<Option<JournalEntry>, StoreError> {
        named(journal::entry(&self.shared.readers, route, id).await)
    }

    /// In the order of arrival, after `after`, at most `limit`; none if `after` is not there.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn batches(
        &self,
        route: &RouteId,
        filter: &BatchFilter,
        after: Option<&BatchId>,
        limit: u32,
    ) -> Result<Vec<BatchRecord>, StoreError> {
        named(journal::batches(&self.shared.readers, route, filter, after, limit).await)
    }

    /// The oldest job whose time has come on a route that no live lease holds; its batch is
    /// `processing` from now on. A batch whose body has rotted is quarantined on the way.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn claim_job(
        &self,
        now: Timestamp,
        lease: Duration,
    ) -> Result<Option<ClaimedJob>, StoreError> {
        while let Some(claim) = self.work(claims::ClaimJob { now, lease }).await? {
            let (job_id, generation) = (claim.job_id, claim.generation);
            match self.load_entries(claim).await {
                Err(StoreError::Corrupt(Corruption::Body { route_id, batch_id })) => {
                    tracing::error!(%route_id, %batch_id, "a stored body is corrupt");
                    let request = failures::QuarantineRotten {
                        job_id,
                        generation,
                        batch_id,
                        now,
                    };
                    self.work(request).await?;
                }
                Err(error) => {
                    self.return_job(job_id, generation, now).await?;
                    return Err(error);
                }
                Ok(job) => return Ok(Some(job)),
            }
        }
        Ok(None)
    }

    /// Writes a job's result, ends its batches, and queues what their end lets run: all or
    /// nothing. After [`Applied::Stale`] the job is still held if the route alone has moved on:
    /// it may be computed again from [`Store::load_graph`].
    ///
    /// # Errors
    /// [`StoreError::InvalidResult`] if the result contradicts itself or the store.
    pub async fn apply_result(&self, result: JobResult) -> Result<Applied, StoreError> {
        self.work(results::ApplyResult(result)).await
    }

    /// Puts a failed job back with a delay (1, 4, 16, 64 s), or quarantines its batch after the
    /// fifth try. A job that this worker does not hold any more is left alone.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn fail_job(
        &self,
        job_id: i64,
        generation: i64,
        reason: &str,
        now: Timestamp,
    ) -> Result<(), StoreError> {
        let reason = reason.to_owned();
        let request = failures::FailJob {
            job_id,
            generation,
            reason,
            now,
        };
        self.work(request).await
    }

    /// Puts a job back for a second later without counting a try: the store or the machine was
    /// in the way, not the batch.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn return_job(
        &self,
        job_id: i64,
        generation: i64,
        now: Timestamp,
    ) -> Result<(), StoreError> {
        let request = failures::ReturnJob {
            job_id,
            generation,
            now,
        };
        self.work(request).await
    }

    /// Queues held batches whose `hold_s` is over, at most 256 of them; returns how many.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn release_overdue(&self, now: Timestamp) -> Result<u64, StoreError> {
        self.work(gaps::ReleaseOverdue { now }).await
    }

    /// Deletes the bodies of batches that were merged before a time, at most a few of them. Bodies
    /// of batches that are not in the map are kept.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn delete_bodies(&self, before: Timestamp) -> Result<DeletedBodies, StoreError> {
        self.work(retention::DeleteBodies { before }).await
    }

    /// How long the database is on the disk, bytes, its log included.
    pub fn file_bytes(&self) -> u64 {
        self.shared.database.file_bytes()
    }

    /// A route's active graph, read at one instant.
    ///
    /// # Errors
    /// [`StoreError::Corrupt`] with [`Corruption::Scan`] if a scan has lost its checksum.
    pub async fn load_graph(&self, route: &RouteId) -> Result<Option<RouteGraph>, StoreError> {
        named(graph::load(&self.shared.readers, route).await)
    }

    /// The nodes that have left the active graph among the last `tail` of a trip.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn settled_tail(
        &self,
        route: &RouteId,
        trip: &TripId,
        tail: usize,
    ) -> Result<Vec<NodeId>, StoreError> {
        named(settled::tail(&self.shared.readers, route, trip, tail).await)
    }

    /// The nodes that have left the active graph among some nodes and the ends of some edges.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn settled_among(
        &self,
        route: &RouteId,
        nodes: &[NodeId],
        edges: &[EdgeId],
    ) -> Result<Vec<NodeId>, StoreError> {
        named(settled::among(&self.shared.readers, route, nodes, edges).await)
    }

    /// The nodes of a vehicle's uploads of edges that it calls by some names, by name.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn client_nodes(
        &self,
        route: &RouteId,
        vehicle: &VehicleId,
        names: &[String],
    ) -> Result<Vec<(String, NodeId)>, StoreError> {
        named(client_nodes::client_nodes(&self.shared.readers, route, vehicle, names).await)
    }

    /// Takes nodes back into the active graph, where they were, with their edges to other active
    /// nodes. The route's revision is raised if any had left.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn recall_nodes(
        &self,
        route: &RouteId,
        nodes: Vec<NodeId>,
    ) -> Result<(), StoreError> {
        let route = route.clone();
        self.work(settled::Recall { route, nodes }).await
    }

    /// How many nodes a route's active graph has.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn active_nodes(&self, route: &RouteId) -> Result<i64, StoreError> {
        named(settled::count_active(&self.shared.readers, route).await)
    }

    /// Every node, by id.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn nodes(&self, route: &RouteId) -> Result<Vec<NodeRecord>, StoreError> {
        named(graph::nodes(&self.shared.readers, route).await)
    }

    /// By id, after `after`, at most `limit`.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn node_page(
        &self,
        route: &RouteId,
        after: Option<NodeId>,
        limit: u32,
    ) -> Result<Vec<NodeRecord>, StoreError> {
        named(graph::node_page(&self.shared.readers, route, after, limit).await)
    }

    /// Those of some nodes that are there, by id.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn nodes_named(
        &self,
        route: &RouteId,
        ids: &[NodeId],
    ) -> Result<Vec<NodeRecord>, StoreError> {
        named(graph::nodes_named(&self.shared.readers, route, ids).await)
    }

    /// One node.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn node(
        &self,
        route: &RouteId,
        id: NodeId,
    ) -> Result<Option<NodeRecord>, StoreError> {
        named(graph::node(&self.shared.readers, route, id).await)
    }

    /// Every active node with its scan and those behind it, by id: what a map picture is drawn
    /// from.
    ///
    /// # Errors
    /// [`StoreError::Corrupt`] with [`Corruption::Scan`] if a scan has lost its checksum.
    pub async fn nodes_with_scans(&self, route: &RouteId) -> Result<Vec<NodeWithScan>, StoreError> {
        named(graph::nodes_with_scans(&self.shared.readers, route).await)
    }

    /// The scan of a node: the bytes of [`crate::scan::encode_scan`].
    ///
    /// # Errors
    /// [`StoreError::Corrupt`] with [`Corruption::Scan`] if it has lost its checksum.
    pub async fn node_scan(
        &self,
        route: &RouteId,
        id: NodeId,
    ) -> Result<Option<Vec<u8>>, StoreError> {
        named(graph::node_scan(&self.shared.readers, route, id).await)
    }

    /// The nodes of a trip, active or not, in the order of their scans.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn trip_nodes(
        &self,
        route: &RouteId,
        trip: &TripId,
    ) -> Result<Vec<NodeRecord>, StoreError> {
        named(graph::trip_nodes(&self.shared.readers, route, trip).await)
    }

    /// Where a trip was at each of its scans, keyframes and those between them, active or not, in
    /// the order of time.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn trajectory(
        &self,
        route: &RouteId,
        trip: &TripId,
    ) -> Result<Vec<TrajectoryPose>, StoreError> {
        named(intermediate_scans::trajectory(&self.shared.readers, route, trip).await)
    }

    /// Every edge, by id.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn edges(&self, route: &RouteId) -> Result<Vec<EdgeRecord>, StoreError> {
        named(graph::edges(&self.shared.readers, route).await)
    }

    /// By id, after `after`, at most `limit`.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn edge_page(
        &self,
        route: &RouteId,
        filter: EdgeFilter,
        after: Option<EdgeId>,
        limit: u32,
    ) -> Result<Vec<EdgeRecord>, StoreError> {
        named(graph::edge_page(&self.shared.readers, route, filter, after, limit).await)
    }

    /// Those of some edges that are there, by id.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn edges_named(
        &self,
        route: &RouteId,
        ids: &[EdgeId],
    ) -> Result<Vec<EdgeRecord>, StoreError> {
        named(graph::edges_named(&self.shared.readers, route, ids).await)
    }

    /// One edge.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn edge(
        &self,
        route: &RouteId,
        id: EdgeId,
    ) -> Result<Option<EdgeRecord>, StoreError> {
        named(graph::edge(&self.shared.readers, route, id).await)
    }

    /// One alert.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn alert(&self, id: AlertId) -> Result<Option<AlertRecord>, StoreError> {
        named(alerts::alert(&self.shared.readers, id).await)
    }

    /// The newest first, raised before `before`, at most `limit`.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn alert_page(
        &self,
        filter: &AlertFilter,
        before: Option<AlertId>,
        limit: u32,
    ) -> Result<Vec<AlertRecord>, StoreError> {
        named(alerts::alert_page(&self.shared.readers, filter, before, limit).await)
    }

    /// The alerts with a node or an edge that came with a batch, by id.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn batch_alerts(
        &self,
        route: &RouteId,
        batch: &BatchId,
    ) -> Result<Vec<AlertId>, StoreError> {
        named(alerts::batch_alerts(&self.shared.readers, route, batch).await)
    }

    /// The alerts of each of some batches, by id; batches without any are left out.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn alerts_by_batch(
        &self,
        route: &RouteId,
        batches: &[BatchId],
    ) -> Result<BTreeMap<BatchId, Vec<AlertId>>, StoreError> {
        named(alerts::alerts_by_batch(&self.shared.readers, route, batches).await)
    }

    /// What happened to alerts after the event `after` (0 for the first), in order, at most
    /// `limit`; of one route, or of all.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn alert_events(
        &self,
        route: Option<&RouteId>,
        after: i64,
        limit: u32,
    ) -> Result<Vec<AlertEvent>, StoreError> {
        named(alerts::alert_events(&self.shared.readers, route, after, limit).await)
    }

    /// The sequence of the last event; 0 before the first.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn last_alert_event(&self) -> Result<i64, StoreError> {
        named(alerts::last_alert_event(&self.shared.readers).await)
    }

    /// The changes that a route's map has taken in, in the order of acceptance.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn accepted_changes(
        &self,
        route: &RouteId,
    ) -> Result<Vec<AcceptedChange>, StoreError> {
        let mut reader = self.shared.readers.acquire().await?;
        named(acceptances::accepted_changes(&mut reader, route).await)
    }

    /// An accepted change with what takes it back; `None` if the alert's is not in the map.
    ///
    /// # Errors
    /// [`StoreError::Corrupt`] if what takes it back has lost its checksum.
    pub async fn acceptance(&self, alert: AlertId) -> Result<Option<Acceptance>, StoreError> {
        named(acceptances::acceptance(&self.shared.readers, alert).await)
    }

    /// Writes a decision, all or nothing.
    ///
    /// # Errors
    /// [`StoreError::InvalidResult`] if the decision contradicts itself or the store.
    pub async fn apply_decision(&self, decision: Decision) -> Result<Decided, StoreError> {
        let sealed = tokio::task::spawn_blocking(|| decisions::ApplyDecision::seal(decision));
        let request = sealed.await.map_err(|_| StoreError::Unavailable)??;
        self.work(request).await
    }

    /// The versions of a route's map after `after`, the oldest first, at most `limit`; the
    /// present one is the last.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn map_versions(
        &self,
        route: &RouteId,
        after: i64,
        limit: u32,
    ) -> Result<Vec<MapVersionRecord>, StoreError> {
        named(map_versions::map_versions(&self.shared.readers, route, after, limit).await)
    }

    /// The picture of a version that another one has followed.
    ///
    /// # Errors
    /// [`StoreError::Corrupt`] if it has lost its checksum.
    pub async fn map_version_picture(
        &self,
        route: &RouteId,
        version: i64,
    ) -> Result<Option<MapPicture>, StoreError> {
        named(map_versions::picture(&self.shared.readers, route, version).await)
    }

    async fn work<R: request::Request>(&self, request: R) -> Result<R::Outcome, StoreError> {
        outcome::<R>(self.shared.outbox.send_work(request).await?).await
    }

    async fn load_entries(&self, claim: claims::Claim) -> Result<ClaimedJob, StoreError> {
        let mut entries = Vec::with_capacity(claim.batch_ids.len());
        for batch_id in &claim.batch_ids {
            // Gone only if the route was deleted a moment ago; the fence will say so.
            entries.extend(self.journal_entry(&claim.route_id, batch_id).await?);
        }
        Ok(ClaimedJob {
            job_id: claim.job_id,
            generation: claim.generation,
            attempts: claim.attempts,
            route_id: claim.route_id,
            entries,
            after_gap: claim.after_gap,
        })
    }
}

/// Waits for what became of a request; the writer drops it unanswered only when it is lost itself.
async fn outcome<R: request::Request>(reply: Reply<R>) -> Result<R::Outcome, StoreError> {
    let outcome = reply.await.map_err(|_| StoreError::Unavailable)?;
    outcome.map_err(StoreError::named)
}

fn named<T>(read: Result<T, StoreError>) -> Result<T, StoreError> {
    read.map_err(StoreError::named)
}
