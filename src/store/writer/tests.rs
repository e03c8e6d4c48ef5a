//! The writer with a file that may grow so far, and a disk of which the test says how full it is.

use std::sync::atomic::{AtomicU64, Ordering};

use super::*;
use crate::store::inbox::{Outbox, queues};
use crate::store::request::Request;

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
            space: Space::measured_by(
                directory.path(),
                move || Ok(measured.load(Ordering::SeqCst)),
            ),
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
async fn a_full_disk_is_reported_and_writing_goes_on_when_there_is_space() {
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
