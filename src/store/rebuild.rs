//! Making a route's map anew from its journal of inputs: what is cleared away before the inputs are
//! repeated (`repeat.rs`), and what is put back afterwards. Only for a copy of a database, on which
//! no pipeline runs.

use sqlx::SqliteConnection;

use super::Store;
use super::columns::json_text;
use super::error::StoreError;
use super::query::Query;
use super::repeat::route_key;
use super::request::Request;
use crate::ids::RouteId;
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
    "INSERT INTO alert_handling (alert_key, changes, assignee, assigned_at_us, comments, \
         muted_until_us, withheld_from) \
     SELECT alerts.alert_key, changes, assignee, assigned_at_us, comments, muted_until_us, withheld_from \
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

/// The inputs that a map is made anew from: those that are written while they are repeated come
/// after the last of them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct InputsToRepeat {
    /// How many there are.
    pub count: u64,
    /// The key of the last one.
    pub last: i64,
}

impl Store {
    /// Clears away everything that was computed from a route's uploads; returns the inputs that it is
    /// made anew from.
    ///
    /// # Errors
    /// [`StoreError::UnknownRoute`].
    pub async fn begin_rebuild(&self, route: &RouteId) -> Result<InputsToRepeat, StoreError> {
        self.work(Begin(route.clone())).await
    }

    /// After [`Store::copy_route`] has copied more: makes new uploads as if they had just arrived.
    ///
    /// # Errors
    /// [`StoreError::UnknownRoute`].
    pub async fn go_on_with_rebuild(&self, route: &RouteId) -> Result<(), StoreError> {
        self.work(GoOn(route.clone())).await
    }

    /// The inputs of a route that there are at present.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn inputs_to_repeat(&self, route: &RouteId) -> Result<InputsToRepeat, StoreError> {
        self.read(JournalEnd(route)).await
    }

    /// Puts back what [`Store::begin_rebuild`] set aside: batches that wait, events as they were
    /// numbered, deliveries, the audit.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn end_rebuild(&self, route: &RouteId) -> Result<(), StoreError> {
        self.work(End(route.clone())).await
    }
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
        queue_anew(transaction, route_key, 0).await?;
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
        JournalEnd(&self.0).answer(transaction).await
    }
}

/// Makes batches as if they had just arrived: those with keys above `after`.
async fn queue_anew(
    transaction: &mut SqliteConnection,
    route_key: i64,
    after: i64,
) -> Result<(), StoreError> {
    let flags = SET_BY_PROCESSING.map(BatchFlag::name);
    sqlx::query(
        "UPDATE batches SET status = $1, reason = NULL, nodes_added = 0, loop_closures = 0, \
             nodes_at_try = NULL, processed_at_us = NULL, \
             flags = (SELECT json_group_array(value) FROM json_each(flags) \
                 WHERE value NOT IN (SELECT value FROM json_each($2))) \
         WHERE route_key = $3 AND batch_key > $4",
    )
    .bind(BatchStatus::Queued.name())
    .bind(json_text(&flags)?)
    .bind(route_key)
    .bind(after)
    .execute(transaction)
    .await?;
    Ok(())
}

/// The inputs that there are.
struct JournalEnd<'a>(&'a RouteId);

impl Query for JournalEnd<'_> {
    type Answer = InputsToRepeat;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let (count, last): (i64, i64) = sqlx::query_as(
            "SELECT count(*), coalesce(max(input_key), 0) \
             FROM routes JOIN inputs USING (route_key) WHERE routes.id = $1",
        )
        .bind(self.0.as_str())
        .fetch_one(reader)
        .await?;
        Ok(InputsToRepeat {
            count: count.unsigned_abs(),
            last,
        })
    }
}

/// Takes in what has been copied since [`Begin`].
struct GoOn(RouteId);

impl Request for GoOn {
    type Outcome = ();
    const QUEUES_JOBS: bool = false;

    async fn execute(&self, transaction: &mut SqliteConnection) -> Result<(), StoreError> {
        let route_key = route_key(transaction, &self.0).await?;
        let newest: i64 =
            sqlx::query_scalar("SELECT coalesce(max(batch_key), 0) FROM rebuild_batches")
                .fetch_one(&mut *transaction)
                .await?;
        queue_anew(transaction, route_key, newest).await?;
        sqlx::query(
            "INSERT INTO rebuild_batches SELECT batches.*, 0 FROM batches WHERE batch_key > $1",
        )
        .bind(newest)
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
