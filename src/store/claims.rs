//! Claiming jobs under a lease.

use std::time::Duration;

use jiff::Timestamp;
use sqlx::sqlite::SqliteRow;
use sqlx::{Row, SqliteConnection};

use super::columns::{micros, name, text};
use super::error::Corruption;
use super::error::StoreError;
use super::jobs::{Job, TRIES_MAX, give_up, job_of};
use super::records::ClaimedJob;
use super::request::Request;
use super::trips::Place;
use super::{Store, failures};
use crate::ids::{BatchId, RouteId};
use crate::model::BatchKind;

impl Store {
    /// The oldest job whose time has come on a route that no live lease holds; its batch is
    /// `processing` from now on. A batch whose body has rotted is quarantined on the way.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn claim_job(
        &self,
        now: Timestamp,
        lease: Duration,
    ) -> Result<Option<ClaimedJob>, StoreError> {
        while let Some(claim) = self.work(ClaimJob { now, lease }).await? {
            let (job_id, generation) = (claim.job_id, claim.generation);
            match self.load_entries(claim).await {
                Err(StoreError::Corrupt(Corruption::Body { route_id, batch_id })) => {
                    tracing::error!(%route_id, %batch_id, "a stored body is corrupt");
                    let request = failures::QuarantineRotten {
                        job_id,
                        generation,
                        batch_id,
                        now,
                    };
                    self.work(request).await?;
                }
                Err(error) => {
                    self.return_job(job_id, generation, now).await?;
                    return Err(error);
                }
                Ok(job) => return Ok(Some(job)),
            }
        }
        Ok(None)
    }

    async fn load_entries(&self, claim: Claim) -> Result<ClaimedJob, StoreError> {
        let mut entries = Vec::with_capacity(claim.batch_ids.len());
        for batch_id in &claim.batch_ids {
            // Gone only if the route was deleted a moment ago; the fence will say so.
            entries.extend(self.journal_entry(&claim.route_id, batch_id).await?);
        }
        Ok(ClaimedJob {
            job_id: claim.job_id,
            generation: claim.generation,
            attempts: claim.attempts,
            route_id: claim.route_id,
            entries,
            after_gap: claim.after_gap,
        })
    }
}

/// Batches of edges without a tie to the map that a job takes along, at most.
pub(super) const TAKEN_ALONG_MAX: i64 = 63;

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
        let (entries, after_gap) = match kind(transaction, &job.place).await? {
            BatchKind::Scans => {
                let entries = entries(transaction, &job.place).await?;
                let first = entries.first().map_or(job.place.sequence, |entry| entry.1);
                let after_gap = first > 0 && !is_used(transaction, &job.place, first - 1).await?;
                (entries, after_gap)
            }
            BatchKind::Edges => (entries_of_edges(transaction, &job.place).await?, false),
        };
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
        "SELECT id, sequence FROM batches \
         WHERE (route_key = ?1 AND trip_id = ?2 AND status = 'unanchored' AND sequence < ?3) \
         OR batch_key = ?4 ORDER BY sequence",
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

async fn kind(transaction: &mut SqliteConnection, place: &Place) -> Result<BatchKind, StoreError> {
    let row = sqlx::query("SELECT kind FROM batches WHERE batch_key = ?")
        .bind(place.batch_key)
        .fetch_one(transaction)
        .await?;
    text(&row, "kind")
}

/// The newest batches of edges of the job's vehicle that are not tied to the map yet, in the order
/// of arrival, and the job's own, with their sequences.
async fn entries_of_edges(
    transaction: &mut SqliteConnection,
    place: &Place,
) -> Result<Vec<(BatchId, i64)>, StoreError> {
    let rows = sqlx::query(
        "SELECT id, sequence FROM batches \
         WHERE batch_key = ?1 OR batch_key IN (SELECT batch_key FROM batches \
             WHERE route_key = ?2 AND status = 'unanchored' AND kind = 'edges' \
             AND vehicle_id = (SELECT vehicle_id FROM batches WHERE batch_key = ?1) \
             ORDER BY batch_key DESC LIMIT ?3) \
         ORDER BY batch_key = ?1, batch_key",
    )
    .bind(place.batch_key)
    .bind(place.route_key)
    .bind(TAKEN_ALONG_MAX)
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
