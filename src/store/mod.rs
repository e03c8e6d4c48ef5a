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
mod audit;
mod backlog;
mod backup;
mod body;
mod checkup;
mod claims;
mod client_nodes;
mod columns;
mod comparison;
mod connection;
mod decisions;
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
mod lock;
mod map_layers;
mod map_versions;
mod marker;
mod migrations;
mod news;
mod notices;
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
mod report;
mod request;
mod results;
mod retention;
mod retries;
mod route_audit;
mod routes;
mod row_sums;
mod secrets;
mod series_closures;
mod sessions;
mod settled;
mod space;
mod trip_records;
mod trips;
mod upload_lags;
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
mod zones;

pub use alert_records::*;
pub use archive::SubgraphSums;
pub use audit::{AuditFilter, AuditRecord};
pub use backup::{Contents, HeldDirectory, SchemaAge, back_up, backup_contents, contents};
pub use checkup::{Backlog, Checkup, FailingWebhook, checkup};
pub use comparison::{AlertApart, AlertCounts, Comparison, PosesApart, RowsApart, There, compare};
pub use error::{Corruption, StoreError};
pub use export::{GraphPart, Pieces, Within};
pub use figures::{DiskUse, Figures, NOT_IN_A_MAP, schema_version};
pub use fsck::{Fault, FsckReport, OnProgress, check_backup, fsck};
pub use handling::{CommentRecord, Handling, Muted};
pub use inputs::{AcceptedInput, Input, InputRecord, JobInput};
pub use key_records::*;
pub use map_layers::{ActiveClosure, TripTrack};
pub use operation_records::*;
pub use place_nodes::TimesOfChange;
pub use quarantines::Quarantine;
pub use rebuild::InputsToRepeat;
pub use recordings::{RecordedBatches, RecordingJournaled};
pub use records::*;
pub use removal_records::*;
pub use report::{DecidedRecord, DismissalCount, Report, ReportCounts, ReportScope};
pub use retries::Retried;
pub use secrets::{KeyText, NoKey, Secret};
pub use series_closures::{SeriesClosure, SeriesClosures};
pub use trip_records::TripRecord;
pub use upload_lags::UploadLag;
pub use vehicles::{KeptOut, LidarRecord, TripCalibrationRecord, VehicleRecord};
pub use webhook_records::*;
pub use zones::{ZONES_MAX, ZoneEdit, ZoneMade, ZoneRecord};

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64};

use jiff::Timestamp;
use sqlx::pool::PoolConnection;
use sqlx::{Connection, Sqlite, SqliteConnection, SqlitePool};
use tokio::sync::{Mutex, Notify, watch};
use tokio::task::JoinHandle;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

use connection::Database;
use inbox::Outbox;
use lock::DirectoryLock;
use marker::Marker;
use request::Reply;
use space::Space;
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

/// What is done with a database whose write-ahead log was lost.
#[derive(Clone, Copy, PartialEq, Eq)]
enum LostLog {
    /// It is not opened.
    Refused,
    /// It is opened as it is.
    Accepted,
}

impl LostLog {
    /// Before anything is written: the log may yet be put back.
    async fn check(
        self,
        directory: &Path,
        connection: &mut SqliteConnection,
    ) -> Result<(), StoreError> {
        let left = marker::commits(connection).await?;
        let commits = match marker::commits_before(directory) {
            Some(before) if before > left => before - left,
            _ => return Ok(()),
        };
        let directory = directory.to_path_buf();
        if self == Self::Refused {
            return Err(StoreError::LostLog { directory, commits });
        }
        let directory = directory.display();
        tracing::error!(%directory, commits, "the last commits are lost, and that was accepted");
        Ok(())
    }
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
    /// Locks the directory, brings the schema up to date, gives back the jobs of a process that
    /// died, and starts the writer on the current runtime.
    ///
    /// # Errors
    /// [`StoreError::Locked`] if another process holds the directory, [`StoreError::LostLog`] if
    /// something that was acknowledged is not there any more.
    pub async fn open(options: StoreOptions) -> Result<Self, StoreError> {
        Self::open_with(options, LostLog::Refused).await
    }

    /// Opens a store as [`Store::open`] does, even if something that was acknowledged is not there
    /// any more.
    ///
    /// # Errors
    /// As [`Store::open`], but for [`StoreError::LostLog`].
    pub async fn open_without_log(options: StoreOptions) -> Result<Self, StoreError> {
        Self::open_with(options, LostLog::Accepted).await
    }

    async fn open_with(options: StoreOptions, lost_log: LostLog) -> Result<Self, StoreError> {
        let data_dir = options.data_dir.clone();
        let lock = tokio::task::spawn_blocking(move || DirectoryLock::acquire(&data_dir))
            .await
            .map_err(|_| StoreError::Unavailable)??;
        let lock = Arc::new(lock);
        let database = Database::in_directory(&options.data_dir);
        let space = Space::of(&options.data_dir);
        let has_room = space.has_room();
        database.make_files()?;
        let mut connection = database.open_writer().await.map_err(StoreError::named)?;
        if let Err(lost) = lost_log.check(&options.data_dir, &mut connection).await {
            connection.close().await?;
            return Err(lost);
        }
        if !(has_room || database.is_up_to_date(&mut connection).await?) {
            return Err(StoreError::FullBeforeMigration);
        }
        let migrated = database.migrate(&mut connection).await?;
        if migrated.rates_set > 0 {
            tracing::warn!(
                routes = migrated.rates_set,
                false_alarm_rate = RouteSettings::default().false_alarm_rate,
                "false_alarm_rate means false alerts per lap now: every route was set to the default"
            );
        }
        jobs::release_orphans(&mut connection, Timestamp::now()).await?;
        let has_keys = keys::any(&mut connection).await?;
        let readers = database.open_readers().await?;
        let commits = marker::commits(&mut connection).await?;
        let marker = Marker::create(&options.data_dir, commits)?;

        let (outbox, inbox) = inbox::queues();
        let (health_sender, health) = watch::channel(match has_room {
            true => Health::Ready,
            false => Health::Full,
        });
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
            marker,
            space: space.clone(),
        };
        let shared = Shared {
            data_dir: options.data_dir,
            database,
            outbox,
            readers,
            health,
            jobs,
            space,
            shutdown,
            writer: Mutex::new(Some(tokio::spawn(writer.run()))),
            opened: Instant::now(),
            has_keys: AtomicBool::new(has_keys),
            revocations: AtomicU64::new(0),
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
        // Whoever holds a job still is cut off now; that is not the batch's fault. If it cannot be
        // noted, the next start takes it for a lost process.
        let _ = self.work(jobs::ReturnAll).await;
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

    /// How long the database is on the disk, bytes, its log included.
    pub fn file_bytes(&self) -> u64 {
        self.shared.database.file_bytes()
    }

    /// A connection for a read of several statements.
    async fn reader(&self) -> Result<PoolConnection<Sqlite>, StoreError> {
        named(
            self.shared
                .readers
                .acquire()
                .await
                .map_err(StoreError::from),
        )
    }

    async fn work<R: request::Request>(&self, request: R) -> Result<R::Outcome, StoreError> {
        outcome::<R>(self.shared.outbox.send_work(request).await?).await
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

/// What came of a read of several statements in one transaction. SQLite may have rolled back by
/// itself, which the driver does not notice: after an error a connection is not trusted with a
/// transaction again.
fn of_snapshot<T>(
    mut reader: PoolConnection<Sqlite>,
    read: Result<T, StoreError>,
) -> Result<T, StoreError> {
    if read.is_err() {
        reader.close_on_drop();
    }
    named(read)
}
