//! How the store is opened and closed.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64};

use jiff::Timestamp;
use sqlx::{Connection, SqliteConnection};
use tokio::sync::{Mutex, Notify, watch};
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

use super::connection::{Database, Migrated};
use super::error::StoreError;
use super::keys::AnyKey;
use super::lock::DirectoryLock;
use super::marker::{self, Marker};
use super::query::Query;
use super::records::RouteSettings;
use super::route_copy::remove_copies;
use super::space::Space;
use super::writer::{Health, Writer};
use super::{Shared, Store, inbox, jobs};

/// Where and how to open the store.
#[derive(Debug, Clone)]
pub struct StoreOptions {
    /// The directory that holds the database; created if missing, locked while open.
    pub data_dir: PathBuf,
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

/// Says what a migration did that the keepers of routes should know of.
fn report(migrated: Migrated) {
    if migrated.rates_set > 0 {
        tracing::warn!(
            routes = migrated.rates_set,
            false_alarm_rate = RouteSettings::default().false_alarm_rate,
            "false_alarm_rate means false alerts per lap now: every route was set to the default"
        );
    }
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
        remove_copies(&options.data_dir);
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
        report(database.migrate(&mut connection).await?);
        jobs::release_orphans(&mut connection, Timestamp::now()).await?;
        let has_keys = AnyKey.answer(&mut connection).await?;
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
}
