//! Claiming jobs under a lease.

use std::time::Duration;

use jiff::Timestamp;
use sqlx::SqliteConnection;

use super::backlog::{self, Taken};
use super::columns::{micros, name};
use super::error::Corruption;
use super::error::StoreError;
use super::jobs::{Job, TRIES_MAX, give_up, job_of};
use super::news::GivenUp;
use super::records::ClaimedJob;
use super::request::Request;
use super::{Store, failures};
use crate::ids::{BatchId, RouteId};

impl Store {
    /// The oldest job whose time has come on a route that no live lease holds; its batch is
    /// `processing` from now on. A batch whose body is found corrupt is quarantined.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn claim_job(
        &self,
        now: Timestamp,
        lease: Duration,
    ) -> Result<Option<ClaimedJob>, StoreError> {
        let request = || ClaimJob {
            now,
            lease,
            open: self.shared.opened.elapsed(),
        };
        while let Some(claim) = self.work(request()).await?.claim {
            let (job_id, generation) = (claim.job_id, claim.generation);
            match self.load_entries(claim).await {
                Err(StoreError::Corrupt(Corruption::Body { route_id, batch_id })) => {
                    tracing::error!(%route_id, %batch_id, "a stored body is corrupt");
                    let request = failures::QuarantineCorrupt {
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

    pub(super) async fn load_entries(&self, claim: Claim) -> Result<ClaimedJob, StoreError> {
        let mut entries = Vec::with_capacity(claim.batch_ids.len());
        for batch_id in &claim.batch_ids {
            // Missing only if the route was deleted a moment ago; the job's generation is then refused.
            entries.extend(self.journal_entry(&claim.route_id, batch_id).await?);
        }
        Ok(ClaimedJob {
            job_id: claim.job_id,
            generation: claim.generation,
            attempts: claim.attempts,
            route_id: claim.route_id,
            entries,
            after_gap: claim.after_gap,
            apart: claim.apart,
            at: claim.at,
        })
    }
}

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
    /// Whether the job's own batch is tried alone, before those that it would have taken along.
    pub(super) apart: bool,
    /// When it was claimed.
    pub(super) at: Timestamp,
}

/// What became of the search for a job.
#[derive(Default)]
pub(super) struct Search {
    /// The job that was found.
    pub(super) claim: Option<Claim>,
    /// Batches that have been tried often enough.
    given_up: Vec<GivenUp>,
}

/// Takes the oldest job whose time has come.
pub(super) struct ClaimJob {
    pub(super) now: Timestamp,
    pub(super) lease: Duration,
    /// How long the store has been open.
    pub(super) open: Duration,
}

impl Request for ClaimJob {
    type Outcome = Search;
    const QUEUES_JOBS: bool = false;

    async fn execute(&self, transaction: &mut SqliteConnection) -> Result<Search, StoreError> {
        let now_us = micros(self.now);
        let mut search = Search::default();
        while let Some(job) = candidate(transaction, now_us, self.open).await? {
            if job.attempts >= TRIES_MAX {
                // No worker reported these failures: each was lost during the job.
                let reason = format!("processing was broken off {} times", job.attempts);
                let given_up = give_up(transaction, &job.place, &reason, self.now).await?;
                search.given_up.push(given_up);
            } else if job.orphaned > 0 && is_any_running(transaction, now_us).await? {
                // It runs alone, and nothing begins before it.
                return Ok(search);
            } else if let Some(taken) = backlog::take(transaction, &job, self.now).await? {
                search.claim = Some(self.claim(transaction, &job, taken).await?);
                return Ok(search);
            }
        }
        Ok(search)
    }

    fn committed(&self, search: &Search) {
        search.given_up.iter().for_each(GivenUp::report);
    }
}

macro_rules! select_candidate {
    ($rest:literal) => {
        concat!(
            "SELECT job_id, attempts, orphaned, batch_key, route_key, trip_id, sequence \
             FROM jobs AS job \
             WHERE (CASE state WHEN 'queued' THEN run_after_us ELSE lease_expires_us END) <= $1 \
             AND route_key NOT IN (SELECT route_key FROM jobs \
                 WHERE state = 'running' AND lease_expires_us > $1) \
             AND NOT EXISTS (SELECT 1 FROM jobs AS earlier \
                 WHERE earlier.route_key = job.route_key \
                 AND earlier.trip_id = job.trip_id AND earlier.sequence < job.sequence) ",
            $rest,
            " ORDER BY batch_key LIMIT 1"
        )
    };
}

/// The oldest job that may run: on a route that no live lease holds, and not before an earlier
/// batch of its trip, which may be waiting for its next try.
///
/// A job during which a process was lost comes first, and its route waits for it. Nothing else runs
/// beside it: if the process is lost again, that job was the cause. It waits until the service has run
/// for 1 s, the next time for 8 s, then for 64 s: a service that is killed again and again, or whose
/// power flickers, is not lost during the same job each time.
async fn candidate(
    transaction: &mut SqliteConnection,
    now_us: i64,
    open: Duration,
) -> Result<Option<Job>, StoreError> {
    let row = sqlx::query(select_candidate!(
        "AND orphaned > 0 AND 1 << (3 * (orphaned - 1)) <= $2"
    ))
    .bind(now_us)
    .bind(i64::try_from(open.as_secs()).unwrap_or(i64::MAX))
    .fetch_optional(&mut *transaction)
    .await?;
    let row = match row {
        Some(row) => Some(row),
        None => sqlx::query(select_candidate!(
            "AND orphaned = 0 AND NOT EXISTS (SELECT 1 FROM jobs AS lost WHERE lost.orphaned > 0 \
                 AND ((lost.state = 'running' AND lost.lease_expires_us > $1) \
                     OR (lost.route_key = job.route_key AND lost.batch_key < job.batch_key)))"
        ))
        .bind(now_us)
        .fetch_optional(transaction)
        .await?,
    };
    row.as_ref().map(job_of).transpose()
}

async fn is_any_running(
    transaction: &mut SqliteConnection,
    now_us: i64,
) -> Result<bool, StoreError> {
    let is_any = sqlx::query_scalar(
        "SELECT EXISTS (SELECT 1 FROM jobs WHERE state = 'running' AND lease_expires_us > $1)",
    )
    .bind(now_us)
    .fetch_one(transaction)
    .await?;
    Ok(is_any)
}

impl ClaimJob {
    async fn claim(
        &self,
        transaction: &mut SqliteConnection,
        job: &Job,
        taken: Taken,
    ) -> Result<Claim, StoreError> {
        let lease_us = i64::try_from(self.lease.as_micros()).unwrap_or(i64::MAX);
        let (generation, attempts): (i64, i64) = sqlx::query_as(
            "UPDATE jobs SET state = 'running', generation = generation + 1, \
             attempts = attempts + 1, lease_expires_us = $1 WHERE job_id = $2 \
             RETURNING generation, attempts",
        )
        .bind(micros(self.now).saturating_add(lease_us))
        .bind(job.job_id)
        .fetch_one(&mut *transaction)
        .await?;
        sqlx::query("UPDATE batches SET status = 'processing' WHERE batch_key = $1")
            .bind(job.place.batch_key)
            .execute(&mut *transaction)
            .await?;
        Ok(Claim {
            job_id: job.job_id,
            generation,
            attempts,
            route_id: route_id(transaction, job.place.route_key).await?,
            batch_ids: taken.batch_ids,
            after_gap: taken.after_gap,
            apart: taken.apart,
            at: self.now,
        })
    }
}

async fn route_id(
    transaction: &mut SqliteConnection,
    route_key: i64,
) -> Result<RouteId, StoreError> {
    let row = sqlx::query("SELECT id FROM routes WHERE route_key = $1")
        .bind(route_key)
        .fetch_one(transaction)
        .await?;
    name(&row, "id")
}
