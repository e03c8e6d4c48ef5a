//! The one task that writes.
//!
//! It takes whatever has queued up, executes it in one transaction, commits (which syncs the log
//! to the disk), and only then answers everyone. A connection is never used again after an error:
//! SQLite may have rolled back by itself, which the driver does not notice.

use std::sync::Arc;
use std::time::Duration;

use sqlx::{Connection, SqliteConnection};
use tokio::sync::{Notify, watch};
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

use super::connection::{Database, WAL_BYTES_MAX, truncate_wal};
use super::error::{Corruption, Severity, StoreError};
use super::inbox::Inbox;
use super::lock::DirectoryLock;
use super::marker::{Marker, count_commit};
use super::request::Write;
use super::space::Space;

/// Pause between two attempts to recover from an I/O error.
const RECOVERY_PAUSE: Duration = Duration::from_millis(250);
/// Pause before the log is truncated again after a reader was in the way.
const TRUNCATION_PAUSE: Duration = Duration::from_secs(5);
/// How often the space on the disk is looked at.
const SPACE_LOOK: Duration = Duration::from_millis(500);

/// Whether writes are taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Health {
    /// They are.
    Ready,
    /// Only those that make room or note a state; the disk is full.
    Full,
    /// Not before a sound connection is back.
    Recovering,
    /// Never again: the file is corrupt. Reads go on.
    Corrupt,
}

impl Health {
    /// What a write gets that is not taken.
    pub(super) fn refusal(self) -> Option<StoreError> {
        match self {
            Self::Ready => None,
            Self::Full => Some(StoreError::Full),
            Self::Recovering => Some(StoreError::Unavailable),
            Self::Corrupt => Some(StoreError::Corrupt(Corruption::Database)),
        }
    }
}

/// The writer's parts.
pub(super) struct Writer {
    /// The file.
    pub(super) database: Database,
    /// `None` while it recovers.
    pub(super) connection: Option<SqliteConnection>,
    /// What is to be written.
    pub(super) inbox: Inbox,
    /// Read by the readiness check.
    pub(super) health: watch::Sender<Health>,
    /// Told when jobs were queued.
    pub(super) jobs: Arc<Notify>,
    /// Ends the task after everything that was taken is written.
    pub(super) shutdown: CancellationToken,
    /// Held as long as something may be written.
    pub(super) lock: Arc<DirectoryLock>,
    /// Told of every commit.
    pub(super) marker: Marker,
    /// Where it is written.
    pub(super) space: Space,
}

impl Writer {
    /// Writes until it is told to shut down or nobody is left to send.
    ///
    /// # Errors
    /// [`StoreError`] if the database could not be closed soundly.
    pub(super) async fn run(mut self) -> Result<(), StoreError> {
        let mut recovery = tokio::time::interval(RECOVERY_PAUSE);
        let mut space_look = tokio::time::interval(SPACE_LOOK);
        let mut truncate_not_before = Instant::now();
        let mut closing = false;
        loop {
            let recovering = self.connection.is_none() && self.health() != Health::Corrupt;
            tokio::select! {
                biased;
                () = self.shutdown.cancelled(), if !closing => {
                    self.inbox.close();
                    closing = true;
                }
                _ = recovery.tick(), if recovering => {
                    self.recover().await;
                    // A whole pause from now on, however long it took: writes are refused in it
                    // rather than left waiting.
                    recovery.reset();
                }
                _ = space_look.tick() => self.look_at_space(),
                group = self.inbox.next_group() => match group {
                    Some(group) => self.write(group).await,
                    None => break,
                }
            }
            if Instant::now() >= truncate_not_before && self.database.wal_bytes() > WAL_BYTES_MAX {
                truncate_not_before = Instant::now() + TRUNCATION_PAUSE;
                self.truncate().await;
            }
        }
        self.finish().await
    }

    fn health(&self) -> Health {
        *self.health.borrow()
    }

    /// Refuses uploads before the last of the space is gone, and takes them again when there is some.
    fn look_at_space(&self) {
        match (self.health(), self.space.has_room()) {
            (Health::Ready, false) => {
                tracing::warn!("the disk is full: only what deletes is written");
                self.set_health(Health::Full);
            }
            (Health::Full, true) if self.connection.is_some() => {
                tracing::info!("there is space on the disk again");
                self.set_health(Health::Ready);
            }
            _ => {}
        }
    }

    async fn write(&mut self, mut group: Vec<Box<dyn Write>>) {
        if self.health() == Health::Full {
            let refused = group.extract_if(.., |write| !write.runs_while_full());
            refuse_all(refused.collect(), || StoreError::Full);
        }
        if group.is_empty() {
            return;
        }
        let Err((mut group, error)) = self.commit(group).await else {
            return;
        };
        let severity = error.severity();
        if severity != Severity::Write {
            tracing::warn!(?severity, %error, cause = ?error, "a group of writes failed");
            self.reopen_after(severity).await;
        }
        match severity {
            Severity::Write | Severity::Statement if group.len() > 1 => {
                self.write_one_by_one(group).await;
            }
            Severity::Write | Severity::Statement => {
                if let Some(write) = group.pop() {
                    write.refuse(error);
                }
            }
            Severity::Full => refuse_all(group, || StoreError::Full),
            Severity::Corrupt => refuse_all(group, || StoreError::Corrupt(Corruption::Database)),
            Severity::Busy | Severity::Io => refuse_all(group, || StoreError::Unavailable),
        }
    }

    /// After one write spoilt a group: only that one is refused.
    async fn write_one_by_one(&mut self, group: Vec<Box<dyn Write>>) {
        for write in group {
            Box::pin(self.write(vec![write])).await;
        }
    }

    /// Executes a group in one transaction and acknowledges it, or gives it back.
    async fn commit(
        &mut self,
        mut group: Vec<Box<dyn Write>>,
    ) -> Result<(), (Vec<Box<dyn Write>>, StoreError)> {
        let Some(connection) = self.connection.as_mut() else {
            let health = self.health();
            refuse_all(group, || {
                health.refusal().unwrap_or(StoreError::Unavailable)
            });
            return Ok(());
        };
        match execute(connection, &mut group).await {
            Ok(Some(commits)) => self.marker.note(commits),
            Ok(None) => {}
            Err(error) => return Err((group, error)),
        }
        let queues_jobs = group.iter().any(|write| write.queues_jobs());
        for write in group {
            write.acknowledge();
        }
        if queues_jobs {
            // Everyone who waits, and the next to come: a worker may be between its look for a
            // job and its waiting.
            self.jobs.notify_waiters();
            self.jobs.notify_one();
        }
        Ok(())
    }

    async fn reopen_after(&mut self, severity: Severity) {
        self.connection = None;
        match severity {
            Severity::Write => {}
            Severity::Corrupt => self.set_health(Health::Corrupt),
            Severity::Io => self.set_health(Health::Recovering),
            Severity::Statement | Severity::Busy | Severity::Full => {
                self.look_at_space();
                match self.database.open_writer().await {
                    Ok(connection) => self.connection = Some(connection),
                    Err(error) => self.set_health(health_after(&error)),
                }
            }
        }
    }

    /// Opens a connection anew and moves the whole log into the database: only if that succeeds
    /// is it known again what the disk holds.
    async fn recover(&mut self) {
        match self.open_and_truncate().await {
            Ok(Some(connection)) => {
                self.connection = Some(connection);
                self.set_health(match self.space.has_room() {
                    true => Health::Ready,
                    false => Health::Full,
                });
                tracing::info!("the store takes writes again");
            }
            Ok(None) => {}
            Err(error) => {
                tracing::warn!(%error, cause = ?error, "the store could not recover");
                self.set_health(health_after(&error));
            }
        }
    }

    async fn open_and_truncate(&self) -> Result<Option<SqliteConnection>, StoreError> {
        let mut connection = self.database.open_writer().await?;
        let truncated = truncate_wal(&mut connection).await?;
        Ok(truncated.then_some(connection))
    }

    async fn truncate(&mut self) {
        let Some(connection) = self.connection.as_mut() else {
            return;
        };
        if let Err(error) = truncate_wal(connection).await {
            let error = StoreError::from(error);
            tracing::warn!(%error, cause = ?error, "the log could not be truncated");
            self.reopen_after(error.severity()).await;
        }
    }

    fn set_health(&self, health: Health) {
        self.health.send_replace(health);
    }

    async fn finish(mut self) -> Result<(), StoreError> {
        let connection = self.connection.take();
        let mut connection = connection.ok_or(StoreError::Unavailable)?;
        if truncate_wal(&mut connection).await? {
            self.marker.remove();
        }
        connection.close().await?;
        drop(self.lock);
        Ok(())
    }
}

/// Executes a group in one transaction. Returns how many commits there are with it, if it has
/// changed anything.
async fn execute(
    connection: &mut SqliteConnection,
    group: &mut [Box<dyn Write>],
) -> Result<Option<i64>, StoreError> {
    let mut transaction = connection.begin_with("BEGIN IMMEDIATE").await?;
    let before = total_changes(&mut transaction).await?;
    for write in group {
        if let Err(error) = write.execute(&mut transaction).await {
            if error.severity() == Severity::Write {
                transaction.rollback().await?;
            }
            return Err(error);
        }
    }
    let commits = match total_changes(&mut transaction).await? == before {
        true => None,
        false => Some(count_commit(&mut transaction).await?),
    };
    transaction.commit().await?;
    Ok(commits)
}

/// How many rows a connection has changed.
async fn total_changes(connection: &mut SqliteConnection) -> Result<i64, sqlx::Error> {
    sqlx::query_scalar("SELECT total_changes()")
        .fetch_one(connection)
        .await
}

fn refuse_all(group: Vec<Box<dyn Write>>, error: impl Fn() -> StoreError) {
    for write in group {
        write.refuse(error());
    }
}

fn health_after(error: &StoreError) -> Health {
    match error.severity() {
        Severity::Full => Health::Full,
        Severity::Corrupt => Health::Corrupt,
        _ => Health::Recovering,
    }
}

#[cfg(test)]
mod tests {
    use super::super::connection::{Database, truncate_wal};
    use super::super::inbox::{Outbox, queues};
    use super::super::request::Request;
    use super::*;
    use std::sync::atomic::{AtomicU64, Ordering};

    /// What a request of these tests does.
    #[derive(Clone, Copy)]
    enum Deed {
        /// Adds a row of this many bytes.
        Add(i64),
        /// Fails as if the driver's thread had died.
        LoseConnection,
        /// Fails as if the file were corrupt.
        FindCorruption,
    }

    impl Request for Deed {
        type Outcome = ();
        const QUEUES_JOBS: bool = false;

        async fn execute(&self, transaction: &mut SqliteConnection) -> Result<(), StoreError> {
            match self {
                Self::Add(bytes) => {
                    sqlx::query("INSERT INTO deeds VALUES (zeroblob($1))")
                        .bind(bytes)
                        .execute(transaction)
                        .await?;
                    Ok(())
                }
                Self::LoseConnection => Err(sqlx::Error::WorkerCrashed.into()),
                Self::FindCorruption => Err(StoreError::Corrupt(Corruption::Database)),
            }
        }
    }

    /// What is written on a full disk as well.
    struct MakeRoom;

    impl Request for MakeRoom {
        type Outcome = ();
        const QUEUES_JOBS: bool = false;
        const WHILE_FULL: bool = true;

        async fn execute(&self, transaction: &mut SqliteConnection) -> Result<(), StoreError> {
            sqlx::query("DELETE FROM deeds")
                .execute(transaction)
                .await?;
            Ok(())
        }
    }

    struct Bench {
        database: Database,
        free_bytes: Arc<AtomicU64>,
        outbox: Outbox,
        health: watch::Receiver<Health>,
        shutdown: CancellationToken,
        task: tokio::task::JoinHandle<Result<(), StoreError>>,
        _directory: tempfile::TempDir,
    }

    impl Bench {
        /// A writer whose first connection may let the file grow by so many pages.
        async fn new(free_pages: i64) -> Self {
            let directory = tempfile::tempdir().unwrap();
            let lock = DirectoryLock::acquire(directory.path()).unwrap();
            let database = Database::in_directory(directory.path());
            let mut connection = database.open_writer().await.unwrap();
            database.migrate(&mut connection).await.unwrap();
            sqlx::query("CREATE TABLE deeds (bytes BLOB NOT NULL) STRICT")
                .execute(&mut connection)
                .await
                .unwrap();
            let pages: i64 = sqlx::query_scalar("PRAGMA page_count")
                .fetch_one(&mut connection)
                .await
                .unwrap();
            let limit = format!("PRAGMA max_page_count = {}", pages + free_pages);
            sqlx::query(sqlx::AssertSqlSafe(limit))
                .execute(&mut connection)
                .await
                .unwrap();
            let (outbox, inbox) = queues();
            let (sender, health) = watch::channel(Health::Ready);
            let shutdown = CancellationToken::new();
            let free_bytes = Arc::new(AtomicU64::new(u64::MAX));
            let measured = Arc::clone(&free_bytes);
            let writer = Writer {
                database: database.clone(),
                connection: Some(connection),
                inbox,
                health: sender,
                jobs: Arc::new(Notify::new()),
                shutdown: shutdown.clone(),
                lock: Arc::new(lock),
                marker: Marker::create(directory.path(), 0).unwrap(),
                space: Space::measured_by(directory.path(), move || {
                    Ok(measured.load(Ordering::SeqCst))
                }),
            };
            Self {
                database,
                free_bytes,
                outbox,
                health,
                shutdown,
                task: tokio::spawn(writer.run()),
                _directory: directory,
            }
        }

        async fn ask<R: Request<Outcome = ()>>(&self, deed: R) -> Result<(), StoreError> {
            let reply = self.outbox.send_upload(deed).await?;
            reply.await.unwrap()
        }

        async fn rows(&self) -> i64 {
            let readers = self.database.open_readers().await.unwrap();
            sqlx::query_scalar("SELECT count(*) FROM deeds")
                .fetch_one(&readers)
                .await
                .unwrap()
        }

        async fn finish(self) -> Result<(), StoreError> {
            self.shutdown.cancel();
            self.task.await.unwrap()
        }
    }

    #[tokio::test]
    async fn a_full_disk_is_told_and_writing_goes_on_when_there_is_space() {
        let bench = Bench::new(4).await;
        bench.ask(Deed::Add(10)).await.unwrap();
        // SQLite rolls back by itself here; a connection used on would be wedged for ever.
        let full = bench.ask(Deed::Add(100_000)).await;
        assert!(matches!(full, Err(StoreError::Full)), "{full:?}");
        // The limit was the connection's: on the next one there is space again.
        bench.ask(Deed::Add(100_000)).await.unwrap();
        assert_eq!(bench.rows().await, 2);
        assert_eq!(*bench.health.borrow(), Health::Ready);
        bench.finish().await.unwrap();
    }

    #[tokio::test]
    async fn a_disk_that_others_fill_is_noticed_and_what_deletes_is_written() {
        let bench = Bench::new(1_000).await;
        let mut health = bench.health.clone();
        bench.ask(Deed::Add(10)).await.unwrap();
        bench.free_bytes.store(0, Ordering::SeqCst);
        health.wait_for(|now| *now == Health::Full).await.unwrap();
        let refused = bench.ask(Deed::Add(10)).await;
        assert!(matches!(refused, Err(StoreError::Full)), "{refused:?}");
        bench.ask(MakeRoom).await.unwrap();
        assert_eq!(bench.rows().await, 0);
        bench.free_bytes.store(u64::MAX, Ordering::SeqCst);
        health.wait_for(|now| *now == Health::Ready).await.unwrap();
        bench.ask(Deed::Add(10)).await.unwrap();
        bench.finish().await.unwrap();
    }

    #[tokio::test]
    async fn after_an_io_error_nothing_is_taken_before_the_log_is_safe() {
        let bench = Bench::new(1_000).await;
        bench.ask(Deed::Add(10)).await.unwrap();
        // A reader that needs the log keeps it from being truncated.
        let readers = bench.database.open_readers().await.unwrap();
        let mut reader = readers.begin().await.unwrap();
        let _: i64 = sqlx::query_scalar("SELECT count(*) FROM deeds")
            .fetch_one(&mut *reader)
            .await
            .unwrap();
        let lost = bench.ask(Deed::LoseConnection).await;
        assert!(matches!(lost, Err(StoreError::Unavailable)), "{lost:?}");
        for _ in 0..3 {
            let refused = bench.ask(Deed::Add(10)).await;
            assert!(matches!(refused, Err(StoreError::Unavailable)));
        }
        assert_eq!(*bench.health.borrow(), Health::Recovering);
        drop(reader);
        let mut health = bench.health.clone();
        health.wait_for(|now| *now == Health::Ready).await.unwrap();
        assert_eq!(bench.database.wal_bytes(), 0);
        bench.ask(Deed::Add(10)).await.unwrap();
        assert_eq!(bench.rows().await, 2);
        bench.finish().await.unwrap();
    }

    #[tokio::test]
    async fn a_corrupt_file_is_read_and_never_written_again() {
        let bench = Bench::new(1_000).await;
        bench.ask(Deed::Add(10)).await.unwrap();
        for deed in [Deed::FindCorruption, Deed::Add(10), Deed::Add(10)] {
            let refused = bench.ask(deed).await;
            let corrupt = StoreError::Corrupt(Corruption::Database).to_string();
            assert_eq!(refused.unwrap_err().to_string(), corrupt);
        }
        assert_eq!(*bench.health.borrow(), Health::Corrupt);
        assert_eq!(bench.rows().await, 1);
        assert!(bench.finish().await.is_err());
    }

    #[tokio::test]
    async fn someone_who_holds_the_file_too_long_costs_a_refusal_only() {
        let bench = Bench::new(1_000).await;
        let mut other = bench.database.open_writer().await.unwrap();
        let held = other.begin_with("BEGIN IMMEDIATE").await.unwrap();
        let refused = bench.ask(Deed::Add(10)).await;
        assert!(matches!(refused, Err(StoreError::Unavailable)));
        held.rollback().await.unwrap();
        bench.ask(Deed::Add(10)).await.unwrap();
        assert!(truncate_wal(&mut other).await.unwrap());
        other.close().await.unwrap();
        bench.finish().await.unwrap();
    }
}
