//! The queue of jobs: the fence, and the ways in which a job ends without a result.

use jiff::Timestamp;
use sqlx::sqlite::SqliteRow;
use sqlx::{Connection, Row, SqliteConnection};

use super::batch_ends::batch_ended;
use super::columns::micros;
use super::error::StoreError;
use super::inputs;
use super::news::GivenUp;
use super::request::Request;
use super::trips::{Place, end_turn};

/// How often a job is tried before its batch is quarantined.
pub(super) const TRIES_MAX: i64 = 5;

/// A batch is quarantined after this many processes were lost with its job: beside the first one other
/// jobs may have run, in the others it ran alone.
const LOST_MAX: i64 = 4;

/// A job as its table has it.
pub(super) struct Job {
    pub(super) job_id: i64,
    /// How often it was claimed.
    pub(super) attempts: i64,
    /// With how many processes it was lost.
    pub(super) orphaned: i64,
    /// Of its batch.
    pub(super) place: Place,
}

/// The job in a row.
pub(super) fn job_of(row: &SqliteRow) -> Result<Job, StoreError> {
    Ok(Job {
        job_id: row.try_get("job_id")?,
        attempts: row.try_get("attempts")?,
        orphaned: row.try_get("orphaned")?,
        place: Place::of(row, row.try_get("route_key")?)?,
    })
}

/// The job that a worker holds; `None` if its claim has another generation by now.
pub(super) async fn held_job(
    transaction: &mut SqliteConnection,
    job_id: i64,
    generation: i64,
) -> Result<Option<Job>, StoreError> {
    let row = sqlx::query(
        "SELECT job_id, attempts, orphaned, batch_key, route_key, trip_id, sequence FROM jobs \
         WHERE job_id = $1 AND generation = $2 AND state = 'running'",
    )
    .bind(job_id)
    .bind(generation)
    .fetch_optional(transaction)
    .await?;
    row.as_ref().map(job_of).transpose()
}

/// Gives a job back, to be claimed again after a time.
pub(super) async fn put_back(
    transaction: &mut SqliteConnection,
    job: &Job,
    run_after_us: i64,
) -> Result<(), StoreError> {
    sqlx::query(
        "UPDATE jobs SET state = 'queued', lease_expires_us = NULL, run_after_us = $1 \
         WHERE job_id = $2",
    )
    .bind(run_after_us)
    .bind(job.job_id)
    .execute(transaction)
    .await?;
    Ok(())
}

/// Quarantines a batch for good and lets its successor have its turn.
pub(super) async fn give_up(
    transaction: &mut SqliteConnection,
    place: &Place,
    reason: &str,
    now: Timestamp,
) -> Result<GivenUp, StoreError> {
    let given_up = quarantine(transaction, place.batch_key, reason, now).await?;
    end_turn(transaction, place).await?;
    Ok(given_up)
}

/// Quarantines a batch; its turn is not ended by that.
pub(super) async fn quarantine(
    transaction: &mut SqliteConnection,
    batch_key: i64,
    reason: &str,
    now: Timestamp,
) -> Result<GivenUp, StoreError> {
    let (route_id, batch_id) = sqlx::query_as(
        "UPDATE batches SET status = 'quarantined', reason = $1, processed_at_us = $2 \
         WHERE batch_key = $3 RETURNING \
         (SELECT id FROM routes WHERE routes.route_key = batches.route_key), id",
    )
    .bind(reason)
    .bind(micros(now))
    .bind(batch_key)
    .fetch_one(&mut *transaction)
    .await?;
    inputs::note_kept_out(transaction, batch_key, now).await?;
    batch_ended(transaction, batch_key, now).await?;
    let reason = reason.to_owned();
    Ok(GivenUp {
        route_id,
        batch_id,
        reason,
    })
}

/// Gives back the jobs of a process that was lost; the directory must be locked. The cause of the loss
/// is not known: such a job is tried again alone, later after the start each time (`claims.rs`), and in
/// the end given up.
pub(super) async fn release_orphans(
    connection: &mut SqliteConnection,
    now: Timestamp,
) -> Result<(), StoreError> {
    let mut transaction = connection.begin_with("BEGIN IMMEDIATE").await?;
    let rows = sqlx::query(
        "UPDATE jobs SET orphaned = orphaned + 1 WHERE state = 'running' \
         RETURNING job_id, attempts, orphaned, batch_key, route_key, trip_id, sequence",
    )
    .fetch_all(&mut *transaction)
    .await?;
    give_back_running(&mut transaction).await?;
    let mut given_up = Vec::new();
    for row in &rows {
        let job = job_of(row)?;
        let (orphaned, batch_key) = (job.orphaned, job.place.batch_key);
        tracing::warn!(batch_key, orphaned, "a process was lost with a batch");
        if orphaned >= LOST_MAX {
            let reason = format!(
                "the service's process was lost {orphaned} times while it processed this batch, but for \
                 the first time with nothing beside it"
            );
            given_up.push(give_up(&mut transaction, &job.place, &reason, now).await?);
        }
    }
    transaction.commit().await?;
    given_up.iter().for_each(GivenUp::report);
    Ok(())
}

/// Gives back every job that is held; none of them counts as tried.
async fn give_back_running(transaction: &mut SqliteConnection) -> Result<(), StoreError> {
    sqlx::query(
        "UPDATE batches SET status = 'queued' \
         WHERE batch_key IN (SELECT batch_key FROM jobs WHERE state = 'running')",
    )
    .execute(&mut *transaction)
    .await?;
    sqlx::query(
        "UPDATE jobs SET state = 'queued', lease_expires_us = NULL, attempts = attempts - 1 \
         WHERE state = 'running'",
    )
    .execute(transaction)
    .await?;
    Ok(())
}

/// Gives back every job before an orderly end.
pub(super) struct ReturnAll;

impl Request for ReturnAll {
    type Outcome = ();
    const QUEUES_JOBS: bool = false;
    const WHILE_FULL: bool = true;

    async fn execute(&self, transaction: &mut SqliteConnection) -> Result<(), StoreError> {
        give_back_running(transaction).await
    }
}
