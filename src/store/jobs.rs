//! The queue of jobs: the fence, and the ways in which a job ends without a result.

use jiff::Timestamp;
use sqlx::sqlite::SqliteRow;
use sqlx::{Row, SqliteConnection};

use super::columns::micros;
use super::error::StoreError;
use super::trips::{Place, end_turn};

/// How often a job is tried before its batch is quarantined.
pub(super) const TRIES_MAX: i64 = 5;

/// After so many processes that ended over a job, their ends count as tries.
const ORPHANED_MAX: i64 = 20;

/// A job as its table has it.
pub(super) struct Job {
    pub(super) job_id: i64,
    /// How often it was claimed.
    pub(super) attempts: i64,
    /// Of its batch.
    pub(super) place: Place,
}

/// The job in a row.
pub(super) fn job_of(row: &SqliteRow) -> Result<Job, StoreError> {
    Ok(Job {
        job_id: row.try_get("job_id")?,
        attempts: row.try_get("attempts")?,
        place: Place {
            batch_key: row.try_get("batch_key")?,
            route_key: row.try_get("route_key")?,
            trip_id: row.try_get("trip_id")?,
            sequence: row.try_get("sequence")?,
        },
    })
}

/// The job that a worker holds, if the fence lets it through.
pub(super) async fn held_job(
    transaction: &mut SqliteConnection,
    job_id: i64,
    generation: i64,
) -> Result<Option<Job>, StoreError> {
    let row = sqlx::query(
        "SELECT job_id, attempts, batch_key, route_key, trip_id, sequence FROM jobs \
         WHERE job_id = ? AND generation = ? AND state = 'running'",
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
        "UPDATE jobs SET state = 'queued', lease_expires_us = NULL, run_after_us = ? \
         WHERE job_id = ?",
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
) -> Result<(), StoreError> {
    quarantine(transaction, place.batch_key, reason, now).await?;
    end_turn(transaction, place).await
}

/// Quarantines a batch; its turn is not ended by that.
pub(super) async fn quarantine(
    transaction: &mut SqliteConnection,
    batch_key: i64,
    reason: &str,
    now: Timestamp,
) -> Result<(), StoreError> {
    sqlx::query(
        "UPDATE batches SET status = 'quarantined', reason = ?, processed_at_us = ? \
         WHERE batch_key = ?",
    )
    .bind(reason)
    .bind(micros(now))
    .bind(batch_key)
    .execute(transaction)
    .await?;
    Ok(())
}

/// Gives back the jobs that a dead process held: only right while the directory is locked. The
/// end of a process is not the batch's fault and no try, unless it happens again and again.
pub(super) async fn release_orphans(connection: &mut SqliteConnection) -> Result<u64, StoreError> {
    sqlx::query(
        "UPDATE batches SET status = 'queued' \
         WHERE batch_key IN (SELECT batch_key FROM jobs WHERE state = 'running')",
    )
    .execute(&mut *connection)
    .await?;
    let released = sqlx::query(
        "UPDATE jobs SET state = 'queued', lease_expires_us = NULL, orphaned = orphaned + 1, \
         attempts = attempts - (orphaned < ?) WHERE state = 'running'",
    )
    .bind(ORPHANED_MAX)
    .execute(connection)
    .await?;
    Ok(released.rows_affected())
}
