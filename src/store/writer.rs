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

use super::connection::{Database, WAL_BYTES_MAX, detach, truncate_wal};
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
/// How often the space on the disk is measured.
const SPACE_CHECK: Duration = Duration::from_millis(500);

/// Whether writes are taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Health {
    /// They are.
    Ready,
    /// Only those that make room or note a state; the disk is full.
    Full,
    /// Not before a connection works again.
    Recovering,
    /// Not any more: the file is corrupt. Reads go on.
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
    /// Notified when jobs were queued.
    pub(super) jobs: Arc<Notify>,
    /// Ends the task after everything that was taken is written.
    pub(super) shutdown: CancellationToken,
    /// Held while anything may be written.
    pub(super) lock: Arc<DirectoryLock>,
    /// Notes every commit.
    pub(super) marker: Marker,
    /// The disk that is written to.
    pub(super) space: Space,
}

impl Writer {
    /// Writes until the store shuts down or nobody is left to send.
    ///
    /// # Errors
    /// [`StoreError`] if the log could not be moved into the database, or that not closed.
    pub(super) async fn run(mut self) -> Result<(), StoreError> {
        let mut recovery = tokio::time::interval(RECOVERY_PAUSE);
        let mut space_check = tokio::time::interval(SPACE_CHECK);
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
                _ = space_check.tick() => self.check_space(),
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

    /// Refuses uploads while the disk is nearly full, and takes them again when there is space.
    fn check_space(&self) {
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
        if group.len() > 1 && group.iter().any(|write| write.other_database().is_some()) {
            return self.write_one_by_one(group).await;
        }
        if group.is_empty() {
            return;
        }
        let Err((mut group, error)) = self.commit(group).await else {
            return;
        };
        let reads_other = group.iter().any(|write| write.other_database().is_some());
        let severity = match error.severity() {
            // It may be the other database's.
            Severity::Corrupt | Severity::Io if reads_other => Severity::Statement,
            severity => severity,
        };
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

    /// After one write made a group fail: only that one is refused. Also where one needs another database.
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
            // All that wait, and the next one: a worker may have found no job and not wait yet.
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
                self.check_space();
                match self.database.open_writer().await {
                    Ok(connection) => self.connection = Some(connection),
                    Err(error) => self.set_health(health_after(&error)),
                }
            }
        }
    }

    /// Opens a new connection and moves the whole log into the database: only if that succeeds is
    /// it known what the disk holds.
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

/// Executes a group in one transaction, beside the other database that it reads. Returns how many
/// commits there are with it, if it has changed anything.
async fn execute(
    connection: &mut SqliteConnection,
    group: &mut [Box<dyn Write>],
) -> Result<Option<i64>, StoreError> {
    let other = group.iter().find_map(|write| write.other_database());
    let Some(other) = other.map(Database::at) else {
        return execute_in_one(connection, group).await;
    };
    other.attach_to(connection).await?;
    let executed = execute_in_one(connection, group).await;
    // If it stays attached, the next one cannot be, and the connection is opened anew.
    let _ = detach(connection).await;
    executed
}

async fn execute_in_one(
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
mod tests;
