//! Trips with a gap: held batches whose predecessor does not come.

use jiff::Timestamp;
use sqlx::SqliteConnection;

use super::Store;
use super::columns::micros;
use super::error::StoreError;
use super::failures::PAUSE_MAX_US;
use super::request::Request;
use super::trips::{Place, skip_gap};

impl Store {
    /// Queues held batches whose `hold_s` is over, at most 256 of them; returns how many.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn release_overdue(&self, now: Timestamp) -> Result<u64, StoreError> {
        self.work(ReleaseOverdue { now }).await
    }
}

/// Held batches that are queued in one write, at most.
const RELEASED_MAX: i64 = 256;

/// Queues held batches that have waited for their predecessor long enough.
pub(super) struct ReleaseOverdue {
    pub(super) now: Timestamp,
}

impl Request for ReleaseOverdue {
    type Outcome = u64;
    const QUEUES_JOBS: bool = true;

    async fn execute(&self, transaction: &mut SqliteConnection) -> Result<u64, StoreError> {
        self.follow_clock(transaction).await?;
        // A trip with a job has no gap: its held batches wait for a turn that will end.
        // SQLite takes the bare columns from the row with the least sequence.
        let rows: Vec<(i64, i64, String, i64)> = sqlx::query_as(
            "SELECT batch_key, batches.route_key, trip_id, min(sequence) \
             FROM batches JOIN routes USING (route_key) WHERE status = 'held' \
             AND NOT EXISTS (SELECT 1 FROM jobs WHERE jobs.route_key = batches.route_key \
                 AND jobs.trip_id = batches.trip_id) \
             GROUP BY batches.route_key, trip_id \
             HAVING coalesce(held_since_us, received_at_us) + hold_s * 1000000 <= $1 \
             ORDER BY batch_key LIMIT $2",
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

impl ReleaseOverdue {
    /// After the clock was put back: a batch that was received at a time that is now in the future is
    /// held from now on, and a job with a pause longer than the longest may run now.
    async fn follow_clock(&self, transaction: &mut SqliteConnection) -> Result<(), StoreError> {
        let now_us = micros(self.now);
        sqlx::query(
            "UPDATE batches SET held_since_us = $1 \
             WHERE status = 'held' AND coalesce(held_since_us, received_at_us) > $1",
        )
        .bind(now_us)
        .execute(&mut *transaction)
        .await?;
        sqlx::query(
            "UPDATE jobs SET run_after_us = $1 WHERE state = 'queued' AND run_after_us > $1 + $2",
        )
        .bind(now_us)
        .bind(PAUSE_MAX_US)
        .execute(transaction)
        .await?;
        Ok(())
    }
}
