//! The queue of jobs: claiming under a lease, failing, giving up.

use std::time::Duration;

use jiff::Timestamp;
use sqlx::sqlite::SqliteRow;
use sqlx::{Row, SqliteConnection};

use super::columns::{micros, name};
use super::error::StoreError;
use super::request::Request;
use super::trips::{Place, end_turn, skip_gap};
use crate::ids::{BatchId, RouteId};

/// How often a job is tried before its batch is quarantined.
const TRIES_MAX: i64 = 5;
/// Held batches that one sweep lets go: a bounded write.
const RELEASED_MAX: i64 = 256;
const MICROS_PER_SECOND: i64 = 1_000_000;

/// What a claim says; the bodies are read afterwards, outside the writer.
#[derive(Debug)]
pub(super) struct Claim {
    pub(super) job_id: i64,
    pub(super) generation: i64,
    pub(super) attempts: i64,
    pub(super) route_id: RouteId,
    /// The trip's unanchored batches in sequence, then the job's own.
    pub(super) batch_ids: Vec<BatchId>,
    /// Whether the batch before the first of them is in no way part of the trip.
    pub(super) after_gap: bool,
}

/// Takes the oldest job whose time has come.
pub(super) struct ClaimJob {
    pub(super) now: Timestamp,
    pub(super) lease: Duration,
}

impl Request for ClaimJob {
    type Outcome = Option<Claim>;
    const QUEUES_JOBS: bool = false;

    async fn execute(
        &self,
        transaction: &mut SqliteConnection,
    ) -> Result<Option<Claim>, StoreError> {
        while let Some(job) = candidate(transaction, micros(self.now)).await? {
            if job.attempts < TRIES_MAX {
                return self.claim(transaction, &job).await.map(Some);
            }
            // Nobody reported these failures: each time the worker was lost on the way.
            let reason = format!("processing was broken off {} times", job.attempts);
            give_up(transaction, &job.place, &reason, self.now).await?;
        }
        Ok(None)
    }
}

struct Job {
    job_id: i64,
    attempts: i64,
    place: Place,
}

fn job_of(row: &SqliteRow) -> Result<Job, StoreError> {
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

/// The oldest job that may run: on a route that no live lease holds, and not before an earlier
/// batch of its trip, which may be waiting for its next try.
async fn candidate(
    transaction: &mut SqliteConnection,
    now_us: i64,
) -> Result<Option<Job>, StoreError> {
    let row = sqlx::query(
        "SELECT job_id, attempts, batch_key, route_key, trip_id, sequence FROM jobs AS job \
         WHERE (CASE state WHEN 'queued' THEN run_after_us ELSE lease_expires_us END) <= ?1 \
         AND route_key NOT IN (SELECT route_key FROM jobs \
             WHERE state = 'running' AND lease_expires_us > ?1) \
         AND NOT EXISTS (SELECT 1 FROM jobs AS earlier WHERE earlier.route_key = job.route_key \
             AND earlier.trip_id = job.trip_id AND earlier.sequence < job.sequence) \
         ORDER BY batch_key LIMIT 1",
    )
    .bind(now_us)
    .fetch_optional(transaction)
    .await?;
    row.as_ref().map(job_of).transpose()
}

impl ClaimJob {
    async fn claim(
        &self,
        transaction: &mut SqliteConnection,
        job: &Job,
    ) -> Result<Claim, StoreError> {
        let lease_us = i64::try_from(self.lease.as_micros()).unwrap_or(i64::MAX);
        let (generation, attempts): (i64, i64) = sqlx::query_as(
            "UPDATE jobs SET state = 'running', generation = generation + 1, \
             attempts = attempts + 1, lease_expires_us = ? WHERE job_id = ? \
             RETURNING generation, attempts",
        )
        .bind(micros(self.now).saturating_add(lease_us))
        .bind(job.job_id)
        .fetch_one(&mut *transaction)
        .await?;
        sqlx::query("UPDATE batches SET status = 'processing' WHERE batch_key = ?")
            .bind(job.place.batch_key)
            .execute(&mut *transaction)
            .await?;
        let entries = entries(transaction, &job.place).await?;
        let first = entries.first().map_or(job.place.sequence, |entry| entry.1);
        let after_gap = first > 0 && !is_used(transaction, &job.place, first - 1).await?;
        Ok(Claim {
            job_id: job.job_id,
            generation,
            attempts,
            route_id: route_id(transaction, job.place.route_key).await?,
            batch_ids: entries.into_iter().map(|entry| entry.0).collect(),
            after_gap,
        })
    }
}

async fn route_id(
    transaction: &mut SqliteConnection,
    route_key: i64,
) -> Result<RouteId, StoreError> {
    let row = sqlx::query("SELECT id FROM routes WHERE route_key = ?")
        .bind(route_key)
        .fetch_one(transaction)
        .await?;
    name(&row, "id")
}

/// The trip's unanchored batches and the job's own, with their sequences.
async fn entries(
    transaction: &mut SqliteConnection,
    place: &Place,
) -> Result<Vec<(BatchId, i64)>, StoreError> {
    let rows = sqlx::query(
        "SELECT id, sequence FROM batches WHERE route_key = ?1 AND trip_id = ?2 \
         AND ((status = 'unanchored' AND sequence < ?3) OR batch_key = ?4) ORDER BY sequence",
    )
    .bind(place.route_key)
    .bind(&place.trip_id)
    .bind(place.sequence)
    .bind(place.batch_key)
    .fetch_all(transaction)
    .await?;
    let entry = |row: &SqliteRow| Ok((name(row, "id")?, row.try_get("sequence")?));
    rows.iter().map(entry).collect()
}

/// Whether a sequence of a trip is in the map, or at least waits for its anchor.
async fn is_used(
    transaction: &mut SqliteConnection,
    place: &Place,
    sequence: i64,
) -> Result<bool, StoreError> {
    let used = sqlx::query_scalar(
        "SELECT EXISTS (SELECT 1 FROM batches WHERE route_key = ? AND trip_id = ? \
         AND sequence = ? AND status IN ('merged', 'unanchored'))",
    )
    .bind(place.route_key)
    .bind(&place.trip_id)
    .bind(sequence)
    .fetch_one(transaction)
    .await?;
    Ok(used)
}

/// The job that a worker holds, if the fence lets it through.
async fn held_job(
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

/// The batch whose job a worker holds, if the fence lets it through.
pub(super) async fn held_place(
    transaction: &mut SqliteConnection,
    job_id: i64,
    generation: i64,
) -> Result<Option<Place>, StoreError> {
    let job = held_job(transaction, job_id, generation).await?;
    Ok(job.map(|job| job.place))
}

/// Puts a job back, or gives its batch up after the last try.
pub(super) struct FailJob {
    pub(super) job_id: i64,
    pub(super) generation: i64,
    pub(super) reason: String,
    pub(super) now: Timestamp,
}

impl Request for FailJob {
    type Outcome = ();
    const QUEUES_JOBS: bool = true;

    async fn execute(&self, transaction: &mut SqliteConnection) -> Result<(), StoreError> {
        let Some(job) = held_job(transaction, self.job_id, self.generation).await? else {
            return Ok(());
        };
        if job.attempts >= TRIES_MAX {
            return give_up(transaction, &job.place, &self.reason, self.now).await;
        }
        let run_after_us = micros(self.now) + backoff_us(job.attempts);
        put_back(transaction, &job, run_after_us).await?;
        sqlx::query(
            "UPDATE batches SET status = 'queued', reason = ?, processed_at_us = ? \
             WHERE batch_key = ?",
        )
        .bind(&self.reason)
        .bind(micros(self.now))
        .bind(job.place.batch_key)
        .execute(transaction)
        .await?;
        Ok(())
    }
}

/// 1 s, 4 s, 16 s, 64 s after the first, second, third, fourth try.
fn backoff_us(attempts: i64) -> i64 {
    let doublings = 2 * (attempts - 1).clamp(0, TRIES_MAX);
    MICROS_PER_SECOND << doublings
}

async fn put_back(
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
async fn give_up(
    transaction: &mut SqliteConnection,
    place: &Place,
    reason: &str,
    now: Timestamp,
) -> Result<(), StoreError> {
    quarantine(transaction, place.batch_key, reason, now).await?;
    end_turn(transaction, place).await
}

async fn quarantine(
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

/// Quarantines a batch whose body is corrupt, and gives back the job that would have used it.
pub(super) struct QuarantineRotten {
    pub(super) job_id: i64,
    pub(super) generation: i64,
    pub(super) batch_id: BatchId,
    pub(super) now: Timestamp,
}

impl Request for QuarantineRotten {
    type Outcome = ();
    const QUEUES_JOBS: bool = true;

    async fn execute(&self, transaction: &mut SqliteConnection) -> Result<(), StoreError> {
        let Some(job) = held_job(transaction, self.job_id, self.generation).await? else {
            return Ok(());
        };
        let batch_key: i64 =
            sqlx::query_scalar("SELECT batch_key FROM batches WHERE route_key = ? AND id = ?")
                .bind(job.place.route_key)
                .bind(self.batch_id.as_str())
                .fetch_one(&mut *transaction)
                .await?;
        let reason = "the stored body is corrupt on the disk";
        if batch_key == job.place.batch_key {
            return give_up(transaction, &job.place, reason, self.now).await;
        }
        quarantine(transaction, batch_key, reason, self.now).await?;
        put_back(transaction, &job, 0).await?;
        // The job itself did not fail.
        sqlx::query("UPDATE jobs SET attempts = attempts - 1 WHERE job_id = ?")
            .bind(job.job_id)
            .execute(&mut *transaction)
            .await?;
        sqlx::query("UPDATE batches SET status = 'queued' WHERE batch_key = ?")
            .bind(job.place.batch_key)
            .execute(transaction)
            .await?;
        Ok(())
    }
}

/// Gives back the jobs that a dead process held: only right while the directory is locked.
pub(super) async fn release_orphans(connection: &mut SqliteConnection) -> Result<u64, StoreError> {
    sqlx::query(
        "UPDATE batches SET status = 'queued' \
         WHERE batch_key IN (SELECT batch_key FROM jobs WHERE state = 'running')",
    )
    .execute(&mut *connection)
    .await?;
    let released = sqlx::query(
        "UPDATE jobs SET state = 'queued', lease_expires_us = NULL WHERE state = 'running'",
    )
    .execute(connection)
    .await?;
    Ok(released.rows_affected())
}

/// Queues held batches that have waited for their predecessor long enough.
pub(super) struct ReleaseOverdue {
    pub(super) now: Timestamp,
}

impl Request for ReleaseOverdue {
    type Outcome = u64;
    const QUEUES_JOBS: bool = true;

    async fn execute(&self, transaction: &mut SqliteConnection) -> Result<u64, StoreError> {
        // A trip with a job has no gap: its held batches wait for a turn that will end.
        // SQLite takes the bare columns from the row with the least sequence.
        let rows: Vec<(i64, i64, String, i64)> = sqlx::query_as(
            "SELECT batch_key, batches.route_key, trip_id, min(sequence) \
             FROM batches JOIN routes USING (route_key) WHERE status = 'held' \
             AND NOT EXISTS (SELECT 1 FROM jobs WHERE jobs.route_key = batches.route_key \
                 AND jobs.trip_id = batches.trip_id) \
             GROUP BY batches.route_key, trip_id \
             HAVING received_at_us + hold_s * 1000000 <= ? ORDER BY batch_key LIMIT ?",
        )
        .bind(micros(self.now))
        .bind(RELEASED_MAX)
        .fetch_all(&mut *transaction)
        .await?;
        let mut released = 0;
        for (batch_key, route_key, trip_id, sequence) in rows {
            let place = Place {
                batch_key,
                route_key,
                trip_id,
                sequence,
            };
            skip_gap(transaction, &place).await?;
            released += 1;
        }
        Ok(released)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_pauses_grow_fourfold() {
        let seconds: Vec<_> = (1..5).map(|k| backoff_us(k) / MICROS_PER_SECOND).collect();
        assert_eq!(seconds, [1, 4, 16, 64]);
    }
}
