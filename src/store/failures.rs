//! Jobs that fail: another try after a pause, or the batch is given up.

use jiff::Timestamp;
use sqlx::SqliteConnection;

use super::Store;
use super::columns::micros;
use super::error::StoreError;
use super::jobs::{Job, TRIES_MAX, give_up, held_job, put_back, quarantine};
use super::news::GivenUp;
use super::request::Request;
use crate::ids::BatchId;

impl Store {
    /// Puts a failed job back with a delay (1, 4, 16, 64 s), or quarantines its batch after the
    /// fifth try. A job that this worker does not hold any more is left alone.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn fail_job(
        &self,
        job_id: i64,
        generation: i64,
        reason: &str,
        now: Timestamp,
    ) -> Result<(), StoreError> {
        self.fail_after(job_id, generation, reason, TRIES_MAX, now)
            .await
    }

    /// Quarantines the batch of a job that another try would not help. A job that this worker does not
    /// hold any more is left alone.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn give_up_job(
        &self,
        job_id: i64,
        generation: i64,
        reason: &str,
        now: Timestamp,
    ) -> Result<(), StoreError> {
        self.fail_after(job_id, generation, reason, 1, now).await
    }

    async fn fail_after(
        &self,
        job_id: i64,
        generation: i64,
        reason: &str,
        tries_max: i64,
        now: Timestamp,
    ) -> Result<(), StoreError> {
        let request = FailJob {
            job_id,
            generation,
            reason: reason.to_owned(),
            tries_max,
            now,
        };
        self.work(request).await.map(drop)
    }

    /// Puts a job back to run in a second, without counting a try: the store or the machine failed, not
    /// the batch.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn return_job(
        &self,
        job_id: i64,
        generation: i64,
        now: Timestamp,
    ) -> Result<(), StoreError> {
        let request = ReturnJob {
            job_id,
            generation,
            now,
        };
        self.work(request).await
    }
}

const MICROS_PER_SECOND: i64 = 1_000_000;
/// The longest pause before a job is tried again.
pub(super) const PAUSE_MAX_US: i64 = 64 * MICROS_PER_SECOND;

/// Puts a job back, or gives its batch up after the last try.
pub(super) struct FailJob {
    pub(super) job_id: i64,
    pub(super) generation: i64,
    pub(super) reason: String,
    pub(super) tries_max: i64,
    pub(super) now: Timestamp,
}

impl Request for FailJob {
    type Outcome = Option<GivenUp>;
    const QUEUES_JOBS: bool = true;
    const WHILE_FULL: bool = true;

    async fn execute(
        &self,
        transaction: &mut SqliteConnection,
    ) -> Result<Option<GivenUp>, StoreError> {
        let Some(job) = held_job(transaction, self.job_id, self.generation).await? else {
            return Ok(None);
        };
        if job.attempts >= self.tries_max {
            let given_up = give_up(transaction, &job.place, &self.reason, self.now).await?;
            return Ok(Some(given_up));
        }
        let run_after_us = micros(self.now) + backoff_us(job.attempts);
        put_back(transaction, &job, run_after_us).await?;
        sqlx::query(
            "UPDATE batches SET status = 'queued', reason = $1, processed_at_us = $2 \
             WHERE batch_key = $3",
        )
        .bind(&self.reason)
        .bind(micros(self.now))
        .bind(job.place.batch_key)
        .execute(transaction)
        .await?;
        Ok(None)
    }

    fn committed(&self, given_up: &Option<GivenUp>) {
        given_up.iter().for_each(GivenUp::report);
    }
}

/// 1 s, 4 s, 16 s, 64 s after the first, second, third, fourth try.
fn backoff_us(attempts: i64) -> i64 {
    let doublings = 2 * (attempts - 1).clamp(0, TRIES_MAX);
    MICROS_PER_SECOND << doublings
}

/// Puts a job back that could not be worked on for a reason outside of it: no try is counted.
pub(super) struct ReturnJob {
    pub(super) job_id: i64,
    pub(super) generation: i64,
    pub(super) now: Timestamp,
}

impl Request for ReturnJob {
    type Outcome = ();
    const QUEUES_JOBS: bool = true;
    const WHILE_FULL: bool = true;

    async fn execute(&self, transaction: &mut SqliteConnection) -> Result<(), StoreError> {
        let Some(job) = held_job(transaction, self.job_id, self.generation).await? else {
            return Ok(());
        };
        put_back(transaction, &job, micros(self.now) + MICROS_PER_SECOND).await?;
        uncount_try(transaction, &job).await
    }
}

/// Puts a batch back into the queue as if its job had not been tried.
async fn uncount_try(transaction: &mut SqliteConnection, job: &Job) -> Result<(), StoreError> {
    sqlx::query("UPDATE jobs SET attempts = attempts - 1 WHERE job_id = $1")
        .bind(job.job_id)
        .execute(&mut *transaction)
        .await?;
    sqlx::query("UPDATE batches SET status = 'queued' WHERE batch_key = $1")
        .bind(job.place.batch_key)
        .execute(transaction)
        .await?;
    Ok(())
}

/// Quarantines a batch whose body is corrupt, and gives back the job that would have used it.
pub(super) struct QuarantineCorrupt {
    pub(super) job_id: i64,
    pub(super) generation: i64,
    pub(super) batch_id: BatchId,
    pub(super) now: Timestamp,
}

impl Request for QuarantineCorrupt {
    type Outcome = Option<GivenUp>;
    const QUEUES_JOBS: bool = true;
    const WHILE_FULL: bool = true;

    async fn execute(
        &self,
        transaction: &mut SqliteConnection,
    ) -> Result<Option<GivenUp>, StoreError> {
        let Some(job) = held_job(transaction, self.job_id, self.generation).await? else {
            return Ok(None);
        };
        let batch_key: i64 =
            sqlx::query_scalar("SELECT batch_key FROM batches WHERE route_key = $1 AND id = $2")
                .bind(job.place.route_key)
                .bind(self.batch_id.as_str())
                .fetch_one(&mut *transaction)
                .await?;
        let reason = "the stored body is corrupt on the disk";
        if batch_key == job.place.batch_key {
            let given_up = give_up(transaction, &job.place, reason, self.now).await?;
            return Ok(Some(given_up));
        }
        let given_up = quarantine(transaction, batch_key, reason, self.now).await?;
        put_back(transaction, &job, 0).await?;
        uncount_try(transaction, &job).await?;
        Ok(Some(given_up))
    }

    fn committed(&self, given_up: &Option<GivenUp>) {
        given_up.iter().for_each(GivenUp::report);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_pauses_grow_fourfold() {
        let seconds: Vec<_> = (1..5).map(|k| backoff_us(k) / MICROS_PER_SECOND).collect();
        assert_eq!(seconds, [1, 4, 16, 64]);
        assert_eq!(backoff_us(TRIES_MAX - 1), PAUSE_MAX_US);
    }
}
