//! Making a route's map anew from its journal of inputs: what is cleared away before it, each
//! input's way back in, and what is put back after it. Only for a copy of a database, on which no
//! pipeline runs.

use jiff::Timestamp;
use sqlx::{Row, SqliteConnection};

use super::Store;
use super::claims::Claim;
use super::columns::{json_text, micros, name};
use super::error::StoreError;
use super::inputs::JobInput;
use super::records::{ClaimedJob, RouteSettings};
use super::request::Request;
use super::trips::{Place, queue};
use crate::ids::{BatchId, RouteId};
use crate::model::{BatchFlag, BatchStatus, OperationKind, OperationStatus, Stage};

/// Flags that processing sets.
const SET_BY_PROCESSING: [BatchFlag; 3] = [
    BatchFlag::Gap,
    BatchFlag::MapMended,
    BatchFlag::NotLocalised,
];

/// Rows that a rebuild does not make are set aside …
const SET_ASIDE: [&str; 7] = [
    "CREATE TABLE rebuild_batches AS SELECT batches.*, 0 AS touched FROM batches WHERE route_key = $1",
    "CREATE TABLE rebuild_jobs AS SELECT * FROM jobs WHERE route_key = $1",
    "CREATE TABLE rebuild_events AS SELECT alert_events.*, alerts.id AS alert_id \
     FROM alerts JOIN alert_events USING (alert_key) WHERE route_key = $1",
    "CREATE TABLE rebuild_deliveries AS SELECT webhook_deliveries.*, alerts.id AS alert_id \
     FROM alerts JOIN webhook_deliveries USING (alert_key) WHERE alerts.route_key = $1",
    "CREATE TABLE rebuild_handling AS SELECT alert_handling.*, alerts.id AS alert_id \
     FROM alerts JOIN alert_handling USING (alert_key) WHERE route_key = $1",
    "CREATE TABLE rebuild_comments AS SELECT alert_comments.*, alerts.id AS alert_id \
     FROM alerts JOIN alert_comments USING (alert_key) WHERE route_key = $1",
    "CREATE TABLE rebuild_marks AS SELECT revision, updated_at_us, \
     (SELECT coalesce(max(audit_key), 0) FROM audit) AS audit_key, \
     (SELECT coalesce(max(input_key), 0) FROM inputs) AS input_key, \
     (SELECT coalesce(max(delivery_key), 0) FROM webhook_deliveries) AS delivery_key \
     FROM routes WHERE route_key = $1",
];

/// … and what it makes is cleared away.
const CLEAR: [&str; 11] = [
    "DELETE FROM jobs WHERE route_key = $1",
    "DELETE FROM alerts WHERE route_key = $1",
    "DELETE FROM edges WHERE route_key = $1",
    "DELETE FROM nodes WHERE route_key = $1",
    "DELETE FROM map_versions WHERE route_key = $1",
    "DELETE FROM archive_sums WHERE route_key = $1",
    "DELETE FROM lidar_calibrations WHERE route_key = $1",
    "DELETE FROM clock_faults WHERE route_key = $1",
    "DELETE FROM vehicle_quarantines WHERE route_key = $1",
    "DELETE FROM vehicle_states WHERE route_key = $1",
    "UPDATE trips SET corrections = NULL, clock_ahead_ns = 0 WHERE route_key = $1",
];

/// Puts back what was set aside. Batches that no input names, and those that wait, are as they were.
const PUT_BACK: [&str; 15] = [
    "UPDATE batches SET (status, reason, flags, nodes_added, loop_closures, nodes_at_try, \
         processed_at_us) = (SELECT status, reason, flags, nodes_added, loop_closures, \
         nodes_at_try, processed_at_us FROM rebuild_batches AS was \
         WHERE was.batch_key = batches.batch_key) \
     WHERE route_key = $1 AND batch_key IN (SELECT batch_key FROM rebuild_batches \
         WHERE NOT touched OR status IN ('queued', 'processing', 'held'))",
    "UPDATE batches SET status = 'unanchored' WHERE route_key = $1 \
     AND status IN ('queued', 'processing') AND batch_key NOT IN (SELECT batch_key FROM rebuild_jobs)",
    "DELETE FROM jobs WHERE route_key = $1",
    "INSERT INTO jobs SELECT * FROM rebuild_jobs WHERE route_key = $1",
    "DELETE FROM alert_handling WHERE alert_key IN \
         (SELECT alert_key FROM alerts WHERE route_key = $1)",
    "INSERT INTO alert_handling (alert_key, changes, assignee, comments, muted_until_us, withheld_from) \
     SELECT alerts.alert_key, changes, assignee, comments, muted_until_us, withheld_from \
     FROM rebuild_handling AS was JOIN alerts ON alerts.id = was.alert_id WHERE route_key = $1",
    "INSERT INTO alert_comments (comment_key, alert_key, at_us, by_whom, text) \
     SELECT comment_key, alerts.alert_key, at_us, by_whom, text \
     FROM rebuild_comments AS was JOIN alerts ON alerts.id = was.alert_id WHERE route_key = $1",
    "UPDATE routes SET open_alerts = (SELECT count(*) FROM alerts \
         WHERE alerts.route_key = $1 AND status IN ('open', 'acknowledged') \
         AND NOT EXISTS (SELECT 1 FROM alert_handling AS handling \
             WHERE handling.alert_key = alerts.alert_key AND muted_until_us IS NOT NULL)) \
     WHERE route_key = $1",
    "DELETE FROM alert_events WHERE (SELECT (id, revision) IN (SELECT alert_id, was.revision \
         FROM rebuild_events AS was) FROM alerts \
         WHERE alerts.alert_key = alert_events.alert_key AND route_key = $1)",
    "INSERT INTO alert_events (sequence, alert_key, revision, at_us, is_decision) \
     SELECT sequence, alerts.alert_key, was.revision, at_us, is_decision FROM rebuild_events AS was \
     JOIN alerts ON alerts.id = was.alert_id AND was.revision <= alerts.revision \
         + coalesce((SELECT changes FROM alert_handling AS handling \
             WHERE handling.alert_key = alerts.alert_key), 0) \
     WHERE route_key = $1",
    "DELETE FROM webhook_deliveries WHERE $1 = $1 \
         AND delivery_key > (SELECT delivery_key FROM rebuild_marks)",
    "UPDATE rebuild_deliveries SET alert_key = (SELECT alert_key FROM alerts \
         WHERE alerts.id = alert_id AND route_key = $1)",
    "DELETE FROM inputs WHERE route_key = $1 AND input_key > (SELECT input_key FROM rebuild_marks)",
    "DELETE FROM audit WHERE $1 = $1 AND audit_key > (SELECT audit_key FROM rebuild_marks)",
    "UPDATE routes SET revision = max(revision, (SELECT revision FROM rebuild_marks)), \
         updated_at_us = max(updated_at_us, (SELECT updated_at_us FROM rebuild_marks)) \
     WHERE route_key = $1",
];

const DROP: [&str; 9] = [
    "ALTER TABLE rebuild_deliveries DROP COLUMN alert_id",
    "INSERT INTO webhook_deliveries SELECT * FROM rebuild_deliveries WHERE alert_key IS NOT NULL",
    "DROP TABLE rebuild_deliveries",
    "DROP TABLE rebuild_handling",
    "DROP TABLE rebuild_comments",
    "DROP TABLE rebuild_events",
    "DROP TABLE rebuild_jobs",
    "DROP TABLE rebuild_batches",
    "DROP TABLE rebuild_marks",
];

/// The inputs that a map is made anew from: what is repeated writes others behind them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct InputsToRepeat {
    /// How many there are.
    pub count: u64,
    /// The key of the last one.
    pub last: i64,
}

impl Store {
    /// Takes everything that was made of a route's uploads away, so that it can be made anew; says
    /// from which inputs.
    ///
    /// # Errors
    /// [`StoreError::UnknownRoute`].
    pub async fn begin_rebuild(&self, route: &RouteId) -> Result<InputsToRepeat, StoreError> {
        self.work(Begin(route.clone())).await
    }

    /// The job that an input tells of, held; `None` if none of its bodies are there any more. Those
    /// of its batches that have a body are its entries.
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

    /// Ends a batch as an input says that it ended.
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

    /// Gives a route the settings that an input says it had from then on.
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

    /// Puts back what [`Store::begin_rebuild`] set aside: batches that wait, events that were told,
    /// deliveries, the audit.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn end_rebuild(&self, route: &RouteId) -> Result<(), StoreError> {
        self.work(End(route.clone())).await
    }
}

async fn route_key(transaction: &mut SqliteConnection, route: &RouteId) -> Result<i64, StoreError> {
    let key = sqlx::query_scalar("SELECT route_key FROM routes WHERE id = $1")
        .bind(route.as_str())
        .fetch_optional(transaction)
        .await?;
    key.ok_or(StoreError::UnknownRoute)
}

async fn execute_all(
    transaction: &mut SqliteConnection,
    statements: &[&'static str],
    route_key: i64,
) -> Result<(), StoreError> {
    for &statement in statements {
        sqlx::query(statement)
            .bind(route_key)
            .execute(&mut *transaction)
            .await?;
    }
    Ok(())
}

struct Begin(RouteId);

impl Request for Begin {
    type Outcome = InputsToRepeat;
    const QUEUES_JOBS: bool = false;

    async fn execute(
        &self,
        transaction: &mut SqliteConnection,
    ) -> Result<InputsToRepeat, StoreError> {
        let route_key = route_key(transaction, &self.0).await?;
        execute_all(transaction, &SET_ASIDE, route_key).await?;
        execute_all(transaction, &CLEAR, route_key).await?;
        let flags = SET_BY_PROCESSING.map(BatchFlag::name);
        sqlx::query(
            "UPDATE batches SET status = $1, reason = NULL, nodes_added = 0, loop_closures = 0, \
                 nodes_at_try = NULL, processed_at_us = NULL, \
                 flags = (SELECT json_group_array(value) FROM json_each(flags) \
                     WHERE value NOT IN (SELECT value FROM json_each($2))) \
             WHERE route_key = $3",
        )
        .bind(BatchStatus::Queued.name())
        .bind(json_text(&flags)?)
        .bind(route_key)
        .execute(&mut *transaction)
        .await?;
        sqlx::query(
            "UPDATE operations SET status = $1, result = NULL, ended_at_us = NULL \
             WHERE route_key = $2 AND status = $3 AND kind = $4 \
             AND NOT json_extract(request, '$.dry_run')",
        )
        .bind(OperationStatus::Queued.name())
        .bind(route_key)
        .bind(OperationStatus::Succeeded.name())
        .bind(OperationKind::Removal.name())
        .execute(&mut *transaction)
        .await?;
        sqlx::query(
            "UPDATE routes SET stage = $1, map_version = 1, epoch = 1, revision = 0, \
                 next_node_id = 1, next_edge_id = 1, nodes = 0, edges = 0, loop_closures = 0, \
                 subgraphs = 0, open_alerts = 0, version_created_at_us = NULL, \
                 version_alert_id = NULL, version_action = NULL, version_by = NULL, \
                 version_note = NULL, version_max_displacement_m = NULL, \
                 updated_at_us = created_at_us \
             WHERE route_key = $2",
        )
        .bind(Stage::Mapping.name())
        .bind(route_key)
        .execute(&mut *transaction)
        .await?;
        let (count, last): (i64, i64) = sqlx::query_as(
            "SELECT count(*), coalesce(max(input_key), 0) FROM inputs WHERE route_key = $1",
        )
        .bind(route_key)
        .fetch_one(transaction)
        .await?;
        Ok(InputsToRepeat {
            count: count.unsigned_abs(),
            last,
        })
    }
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
        let place = Place {
            batch_key: own.try_get("batch_key")?,
            route_key,
            trip_id: own.try_get("trip_id")?,
            sequence: own.try_get("sequence")?,
        };
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

/// Notes that inputs name batches.
async fn touch(
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

/// Makes a job that is held for the batch at a place, which may take others along.
async fn hold(
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
             WHERE route_key = $5 AND id = $6",
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

struct End(RouteId);

impl Request for End {
    type Outcome = ();
    const QUEUES_JOBS: bool = false;

    async fn execute(&self, transaction: &mut SqliteConnection) -> Result<(), StoreError> {
        let route_key = route_key(transaction, &self.0).await?;
        execute_all(transaction, &PUT_BACK, route_key).await?;
        for statement in DROP {
            sqlx::query(statement).execute(&mut *transaction).await?;
        }
        Ok(())
    }
}
