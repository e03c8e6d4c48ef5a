//! The only place that speaks SQL: routes, the durable journal of uploads, jobs, graphs.
//!
//! An embedded SQLite in a directory that one process holds. Everything that writes is a
//! request to the one writer task, which executes what has queued up in one transaction
//! and answers after the commit has reached the disk; a caller that goes away meanwhile changes
//! nothing. Reads run on a few connections of their own, short and side by side.

mod acceptances;
mod active_graph;
mod adoption;
mod alert_columns;
mod alert_events;
mod alert_records;
mod alert_rows;
mod alerts;
mod archive;
mod archived;
mod assignments;
mod audit;
mod backlog;
mod backup;
mod batch_ends;
mod body;
mod checkup;
mod claim_without;
mod claims;
mod client_nodes;
mod clock_faults;
mod columns;
mod comments;
mod comparison;
mod connection;
mod decisions;
mod edge_columns;
mod edges;
mod error;
mod export;
mod failures;
mod figures;
mod files;
mod fsck;
mod gaps;
mod graph;
mod graph_rows;
mod handling;
mod inbox;
mod inputs;
mod intermediate_scans;
mod jobs;
mod journal;
mod key_records;
mod keys;
mod laws;
mod lock;
mod map_layers;
mod map_versions;
mod marker;
mod members;
mod migrations;
mod mutes;
mod name_retention;
mod news;
mod node_columns;
mod nodes;
mod notices;
mod opening;
mod operation_records;
mod operations;
mod pending;
mod place_nodes;
mod place_scans;
mod quarantines;
mod query;
mod rebuild;
mod recordings;
mod records;
mod releases;
mod removal_records;
mod removals;
mod repeat;
mod report;
mod request;
mod restore;
mod result_checks;
mod results;
mod retention;
mod retries;
mod route_audit;
mod route_copy;
mod routes;
mod row_sums;
mod scan_columns;
mod secrets;
mod series_closures;
mod sessions;
mod space;
mod subgraphs;
mod trajectory_retention;
mod trip_calibrations;
mod trip_records;
mod trip_starts;
mod trips;
mod unanchored;
mod upload_lags;
mod uploads;
mod vehicle_states;
mod vehicles;
mod webhook_attempts;
mod webhook_audit;
mod webhook_deliveries;
mod webhook_records;
mod webhook_secrets;
mod webhooks;
mod withheld;
mod writer;
mod zone_audit;
mod zone_records;
mod zones;

pub use adoption::Adoption;
pub use alert_records::*;
pub use archive::SubgraphSums;
pub use audit::{AuditFilter, AuditRecord};
pub use backup::{Contents, SchemaAge, back_up, backup_contents, contents};
pub use checkup::{Backlog, Checkup, FailingWebhook, checkup};
pub use clock_faults::ClockFault;
pub use comments::CommentRecord;
pub use comparison::{AlertApart, AlertCounts, Comparison, PosesApart, RowsApart, There, compare};
pub use error::{Corruption, StoreError};
pub use export::{GraphPart, Pieces, Within};
pub use figures::{DiskUse, Figures, NOT_IN_A_MAP, schema_version};
pub use fsck::{Fault, FsckReport, OnProgress, check_backup, fsck};
pub use inputs::{AcceptedInput, Input, InputRecord, JobInput};
pub use key_records::*;
pub use map_layers::{ActiveClosure, TripTrack};
pub use opening::StoreOptions;
pub use operation_records::*;
pub use place_nodes::TimesOfChange;
pub use quarantines::Quarantine;
pub use rebuild::InputsToRepeat;
pub use recordings::{RecordedBatches, RecordingJournaled};
pub use records::*;
pub use removal_records::*;
pub use report::{DecidedRecord, DismissalCount, Report, ReportCounts};
pub use restore::HeldDirectory;
pub use retries::Retried;
pub use secrets::{KeyText, NoKey, Secret};
pub use series_closures::{SeriesClosure, SeriesClosures};
pub use trip_calibrations::{LidarRecord, TripCalibrationRecord};
pub use trip_records::TripRecord;
pub use upload_lags::UploadLag;
pub use vehicle_states::KeptOut;
pub use vehicles::VehicleRecord;
pub use webhook_records::*;
pub use zone_records::*;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64};

use sqlx::SqlitePool;
use tokio::sync::{Mutex, Notify, watch};
use tokio::task::JoinHandle;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

use connection::Database;
use inbox::Outbox;
use lock::DirectoryLock;
use query::{Query, in_snapshot};
use request::Reply;
use space::Space;
use writer::Health;

/// The store; cheap to clone.
#[derive(Clone)]
pub struct Store {
    shared: Arc<Shared>,
}

struct Shared {
    data_dir: PathBuf,
    database: Database,
    outbox: Outbox,
    readers: SqlitePool,
    health: watch::Receiver<Health>,
    jobs: Arc<Notify>,
    space: Space,
    shutdown: CancellationToken,
    writer: Mutex<Option<JoinHandle<Result<(), StoreError>>>>,
    opened: Instant,
    /// Whether a key was ever made.
    has_keys: AtomicBool,
    /// How many keys were revoked since the start.
    revocations: AtomicU64,
    // After the readers: whoever takes the lock next finds no connection of ours.
    _lock: Arc<DirectoryLock>,
}

/// Writes a copy of the database of a data directory into another, which is made if it is missing. A
/// service may hold the directory.
///
/// # Errors
/// [`StoreError`], also if there is a database in that directory.
pub async fn copy(data_dir: &Path, into: &Path) -> Result<(), StoreError> {
    let copied = Database::in_directory(data_dir).copy_into(into).await;
    copied.map_err(StoreError::named)
}

/// What became of a PUT.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Put {
    /// It was not there before.
    Created,
    /// It was changed.
    Updated,
    /// It is not what was expected, or not there; nothing was written.
    Stale,
    /// It has batches, and its detector cannot change any more; nothing was written.
    DetectorFixed,
}

/// What became of a deletion.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Deleted {
    /// It is gone.
    Done,
    /// It was not there.
    NotThere,
    /// It is not what was expected; nothing was deleted.
    Stale,
}

impl Store {
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

    /// How long the database is on the disk, bytes, its log included.
    pub fn file_bytes(&self) -> u64 {
        self.shared.database.file_bytes()
    }

    /// What a query answers now.
    async fn read<Q: Query>(&self, query: Q) -> Result<Q::Answer, StoreError> {
        let reader = self.shared.readers.acquire().await;
        let mut reader = reader.map_err(|error| StoreError::from(error).named())?;
        if !Q::ONE_SNAPSHOT {
            return query.answer(&mut reader).await.map_err(StoreError::named);
        }
        let answer = in_snapshot(&mut reader, &query).await;
        if answer.is_err() {
            // SQLite may have rolled back by itself, which the driver does not notice: the connection
            // is not trusted with a transaction again.
            reader.close_on_drop();
        }
        answer.map_err(StoreError::named)
    }

    /// What became of a request, once the writer has committed it.
    async fn work<R: request::Request>(&self, request: R) -> Result<R::Outcome, StoreError> {
        outcome::<R>(self.shared.outbox.send_work(request).await?).await
    }
}

/// Waits for what became of a request; the writer drops it unanswered only when it is lost itself.
async fn outcome<R: request::Request>(reply: Reply<R>) -> Result<R::Outcome, StoreError> {
    let outcome = reply.await.map_err(|_| StoreError::Unavailable)?;
    outcome.map_err(StoreError::named)
}
