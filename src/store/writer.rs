//! The one task that writes.
//!
//! It takes whatever has queued up, executes it in one transaction, commits (which syncs the log
//! to the disk), and only then answers everyone. A connection is never used again after an error:
//! SQLite may have rolled back by itself, which the driver does not notice.

use std::sync::Arc;
use std::time::Duration;

use sqlx::{Connection, SqliteConnection};
use tokio::sync::{Notify, watch};
use tokio::time::{Instant, MissedTickBehavior};
use tokio_util::sync::CancellationToken;

use super::connection::{Database, WAL_BYTES_MAX, truncate_wal};
use super::error::{Corruption, Severity, StoreError};
use super::inbox::Inbox;
use super::lock::DirectoryLock;
use super::request::Write;

/// Pause between two attempts to recover from an I/O error.
const RECOVERY_PAUSE: Duration = Duration::from_millis(250);
/// Pause before the log is truncated again after a reader was in the way.
const TRUNCATION_PAUSE: Duration = Duration::from_secs(5);

/// Whether writes are taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Health {
    /// They are.
    Ready,
    /// Not before a sound connection is back; the disk is full.
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
}

impl Writer {
    /// Writes until it is told to shut down or nobody is left to send.
    ///
    /// # Errors
    /// [`StoreError`] if the database could not be closed soundly.
    pub(super) async fn run(mut self) -> Result<(), StoreError> {
        let mut recovery = tokio::time::interval(RECOVERY_PAUSE);
        recovery.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let mut truncate_not_before = Instant::now();
        let mut closing = false;
        loop {
            let recovering = matches!(self.health(), Health::Full | Health::Recovering);
            tokio::select! {
                biased;
                () = self.shutdown.cancelled(), if !closing => {
                    self.inbox.close();
                    closing = true;
                }
                _ = recovery.tick(), if recovering => self.recover().await,
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

    async fn write(&mut self, group: Vec<Box<dyn Write>>) {
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
        if let Err(error) = execute(connection, &mut group).await {
            return Err((group, error));
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
                self.set_health(Health::Ready);
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
        truncate_wal(&mut connection).await?;
        connection.close().await?;
        drop(self.lock);
        Ok(())
    }
}

/// Executes a group in one transaction.
async fn execute(
    connection: &mut SqliteConnection,
    group: &mut [Box<dyn Write>],
) -> Result<(), StoreError> {
    let mut transaction = connection.begin_with("BEGIN IMMEDIATE").await?;
    for write in group {
        if let Err(error) = write.execute(&mut transaction).await {
            if error.severity() == Severity::Write {
                transaction.rollback().await?;
            }
            return Err(error);
        }
    }
    Ok(transaction.commit().await?)
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
