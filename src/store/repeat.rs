//! The inputs of a route, repeated on a copy of its database: each writes what it once wrote.

use jiff::Timestamp;
use sqlx::SqliteConnection;

use super::Store;
use super::claims::Claim;
use super::columns::{json_text, micros, name};
use super::error::StoreError;
use super::inputs::JobInput;
use super::records::{ClaimedJob, RouteSettings};
use super::request::Request;
use super::trips::{Place, queue};
use crate::ids::{BatchId, RouteId};
use crate::model::BatchStatus;

impl Store {
    /// The job that an input names, claimed; `None` if none of its bodies are kept any more. Its
    /// entries are those of its batches that have a body.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn claim_again(
        &self,
        route: &RouteId,
        input: &JobInput,
        at: Timestamp,
    ) -> Result<Option<ClaimedJob>, StoreError> {
        let request = ClaimAgain {
            route: route.clone(),
            input: input.clone(),
            at,
        };
        match self.work(request).await? {
            Some(claim) => self.load_entries(claim).await.map(Some),
            None => Ok(None),
        }
    }

    /// Gives a batch the status that an input says it ended with.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn keep_out_again(
        &self,
        route: &RouteId,
        batch: &BatchId,
        status: BatchStatus,
        reason: Option<String>,
        at: Timestamp,
    ) -> Result<(), StoreError> {
        let request = KeepOutAgain {
            route: route.clone(),
            batch: batch.clone(),
            status,
            reason,
            at,
        };
        self.work(request).await
    }

    /// Gives a route the settings that an input has.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn set_again(
        &self,
        route: &RouteId,
        settings: RouteSettings,
        at: Timestamp,
    ) -> Result<(), StoreError> {
        let request = SetAgain {
            route: route.clone(),
            settings,
            at,
        };
        self.work(request).await
    }
}

/// The key of a route.
pub(super) async fn route_key(
    transaction: &mut SqliteConnection,
    route: &RouteId,
) -> Result<i64, StoreError> {
    let key = sqlx::query_scalar("SELECT route_key FROM routes WHERE id = $1")
        .bind(route.as_str())
        .fetch_optional(transaction)
        .await?;
    key.ok_or(StoreError::UnknownRoute)
}

struct ClaimAgain {
    route: RouteId,
    input: JobInput,
    at: Timestamp,
}

impl Request for ClaimAgain {
    type Outcome = Option<Claim>;
    const QUEUES_JOBS: bool = false;

    async fn execute(
        &self,
        transaction: &mut SqliteConnection,
    ) -> Result<Option<Claim>, StoreError> {
        let route_key = route_key(transaction, &self.route).await?;
        let batches = json_text(&self.input.batches)?;
        touch(transaction, route_key, &batches).await?;
        let rows = sqlx::query(
            "SELECT batch_key, batches.id, trip_id, sequence \
             FROM json_each($1) CROSS JOIN batches ON route_key = $2 AND batches.id = value \
             WHERE body_kept ORDER BY key",
        )
        .bind(&batches)
        .bind(route_key)
        .fetch_all(&mut *transaction)
        .await?;
        let Some(own) = rows.last() else {
            return Ok(None);
        };
        let place = Place::of(own, route_key)?;
        let ids = rows.iter().map(|row| name::<BatchId>(row, "id"));
        let batch_ids: Vec<BatchId> = ids.collect::<Result<_, _>>()?;
        let job_id = hold(transaction, &place, &json_text(&batch_ids)?).await?;
        Ok(Some(Claim {
            job_id,
            generation: 1,
            attempts: 1,
            route_id: self.route.clone(),
            batch_ids,
            after_gap: self.input.after_gap,
            apart: self.input.apart,
            at: self.at,
        }))
    }
}

/// Marks batches as named by an input: they are not put back as they were.
pub(super) async fn touch(
    transaction: &mut SqliteConnection,
    route_key: i64,
    batches: &str,
) -> Result<(), StoreError> {
    sqlx::query(
        "UPDATE rebuild_batches SET touched = 1 \
         WHERE route_key = $1 AND id IN (SELECT value FROM json_each($2))",
    )
    .bind(route_key)
    .bind(batches)
    .execute(transaction)
    .await?;
    Ok(())
}

/// Makes a claimed job of the batch at a place; `batches`, as JSON, are those it takes along and itself.
pub(super) async fn hold(
    transaction: &mut SqliteConnection,
    place: &Place,
    batches: &str,
) -> Result<i64, StoreError> {
    for make_wait in [
        "UPDATE batches SET status = 'unanchored' \
         WHERE route_key = $1 AND id IN (SELECT value FROM json_each($2))",
        "DELETE FROM jobs WHERE route_key = $1 AND batch_key IN (SELECT batch_key FROM batches \
         WHERE batches.route_key = $1 AND id IN (SELECT value FROM json_each($2)))",
    ] {
        sqlx::query(make_wait)
            .bind(place.route_key)
            .bind(batches)
            .execute(&mut *transaction)
            .await?;
    }
    queue(transaction, place).await?;
    let job_id = sqlx::query_scalar(
        "UPDATE jobs SET state = 'running', generation = 1, attempts = 1, \
         lease_expires_us = 9223372036854775807 WHERE batch_key = $1 RETURNING job_id",
    )
    .bind(place.batch_key)
    .fetch_one(transaction)
    .await?;
    Ok(job_id)
}

struct KeepOutAgain {
    route: RouteId,
    batch: BatchId,
    status: BatchStatus,
    reason: Option<String>,
    at: Timestamp,
}

impl Request for KeepOutAgain {
    type Outcome = ();
    const QUEUES_JOBS: bool = false;

    async fn execute(&self, transaction: &mut SqliteConnection) -> Result<(), StoreError> {
        let route_key = route_key(transaction, &self.route).await?;
        touch(transaction, route_key, &json_text(&[&self.batch])?).await?;
        sqlx::query(
            "UPDATE batches SET status = $1, reason = $2, processed_at_us = $3, \
                 nodes_at_try = iif($1 = $4, (SELECT nodes FROM routes \
                     WHERE routes.route_key = batches.route_key), NULL) \
             WHERE route_key = $5 AND id = $6 AND status <> 'merged'",
        )
        .bind(self.status.name())
        .bind(self.reason.as_deref())
        .bind(micros(self.at))
        .bind(BatchStatus::Unanchored.name())
        .bind(route_key)
        .bind(self.batch.as_str())
        .execute(transaction)
        .await?;
        Ok(())
    }
}

struct SetAgain {
    route: RouteId,
    settings: RouteSettings,
    at: Timestamp,
}

impl Request for SetAgain {
    type Outcome = ();
    const QUEUES_JOBS: bool = false;

    async fn execute(&self, transaction: &mut SqliteConnection) -> Result<(), StoreError> {
        sqlx::query(
            "UPDATE routes SET detector = $1, false_alarm_rate = $2, hold_s = $3, \
             max_shift_m = $4, updated_at_us = $5 WHERE id = $6",
        )
        .bind(self.settings.detector.name())
        .bind(self.settings.false_alarm_rate)
        .bind(self.settings.hold_s)
        .bind(self.settings.max_shift_m)
        .bind(micros(self.at))
        .bind(self.route.as_str())
        .execute(transaction)
        .await?;
        Ok(())
    }
}
