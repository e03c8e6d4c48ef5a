//! The journal of everything that shaped a route's map, in the order in which it did. Each entry is
//! written in the transaction of its result.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use sqlx::sqlite::SqliteRow;
use sqlx::{Row, SqliteConnection};

use super::Store;
use super::columns::{json, json_text, micros, name, text, time};
use super::error::StoreError;
use super::query::Query;
use super::records::RouteSettings;
use crate::ids::{AlertId, BatchId, OperationId, RouteId, VehicleId};
use crate::model::{AlertAction, BatchStatus, DismissReason};

/// Something that shaped a map.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Input {
    /// The route was made, or its settings were changed: all of them as they are from then on.
    Settings(RouteSettings),
    /// Batches were processed together.
    Job(JobInput),
    /// A batch was kept out of the map, or left to wait, without being processed.
    KeptOut {
        /// The batch.
        batch: BatchId,
        /// How it ended.
        status: BatchStatus,
        /// Why, for people.
        reason: Option<String>,
    },
    /// Somebody decided about an alert.
    Decision {
        /// The alert.
        alert: AlertId,
        /// What was decided.
        action: AlertAction,
        /// Who decided, as they say.
        by: String,
        /// Why, for people.
        note: Option<String>,
        /// Why it was dismissed.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        reason: Option<DismissReason>,
    },
    /// Somebody accepted several alerts, which made one version of the map.
    AcceptedTogether {
        /// In the order in which the map took them in.
        alerts: Vec<AcceptedInput>,
    },
    /// Batches were taken out of the map.
    Removal {
        /// What asked for it.
        operation: OperationId,
        /// The batches.
        batches: Vec<BatchId>,
    },
    /// The map was made anew without everything that had been taken out of it.
    Rebuilt {
        /// The removal that asked for it.
        operation: OperationId,
    },
    /// From now on a vehicle is kept out of the map.
    VehicleQuarantined {
        /// The vehicle.
        vehicle: VehicleId,
        /// Why, for people.
        note: Option<String>,
    },
    /// A vehicle is no longer kept out of the map.
    VehicleReleased {
        /// The vehicle.
        vehicle: VehicleId,
    },
    /// The present version of the map was released for vehicles.
    VersionReleased {
        /// The version.
        version: i64,
        /// Who released it.
        by: String,
        /// Why, for people.
        note: Option<String>,
    },
    /// A released version of the map was withdrawn.
    VersionRetired {
        /// The version.
        version: i64,
    },
}

/// One of several alerts that were accepted together.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AcceptedInput {
    /// The alert.
    pub alert: AlertId,
    /// Who accepted it, as they say.
    pub by: String,
    /// Why, for people.
    pub note: Option<String>,
}

/// The batches of one job, and how they stood in their trip.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JobInput {
    /// In the order in which they were processed; the last is the job's own.
    pub batches: Vec<BatchId>,
    /// As [`super::ClaimedJob::after_gap`]: the predecessor was not waited for any longer.
    pub after_gap: bool,
    /// As [`super::ClaimedJob::apart`].
    pub apart: bool,
}

/// An entry of the journal.
#[derive(Debug, Clone, PartialEq)]
pub struct InputRecord {
    /// In the order of commits.
    pub key: i64,
    /// The time that its result is stamped with.
    pub at: Timestamp,
    /// What it was.
    pub input: Input,
}

impl Store {
    /// What shaped a route's map after the entry `after`, in that order, at most `limit` entries.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn inputs(
        &self,
        route: &RouteId,
        after: i64,
        limit: u32,
    ) -> Result<Vec<InputRecord>, StoreError> {
        let page = InputPage {
            route,
            after,
            limit,
        };
        self.read(page).await
    }
}

/// What shaped a route's map after the entry `after`, in that order, at most `limit` entries.
struct InputPage<'a> {
    route: &'a RouteId,
    after: i64,
    limit: u32,
}

impl Query for InputPage<'_> {
    type Answer = Vec<InputRecord>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let rows = sqlx::query(
            "SELECT input_key, at_us, input FROM routes JOIN inputs USING (route_key) \
             WHERE routes.id = $1 AND input_key > $2 ORDER BY input_key LIMIT $3",
        )
        .bind(self.route.as_str())
        .bind(self.after)
        .bind(self.limit)
        .fetch_all(reader)
        .await?;
        let input_of = |row: &SqliteRow| {
            Ok(InputRecord {
                key: row.try_get("input_key")?,
                at: time(row, "at_us")?,
                input: json(row, "input")?,
            })
        };
        rows.iter().map(input_of).collect()
    }
}

/// Writes an entry, in the transaction of its result.
pub(super) async fn note(
    transaction: &mut SqliteConnection,
    route_key: i64,
    at: Timestamp,
    input: &Input,
) -> Result<(), StoreError> {
    sqlx::query("INSERT INTO inputs (route_key, at_us, input) VALUES ($1, $2, $3)")
        .bind(route_key)
        .bind(micros(at))
        .bind(json_text(input)?)
        .execute(transaction)
        .await?;
    Ok(())
}

/// Writes an entry of a route by its name.
pub(super) async fn note_of_route(
    transaction: &mut SqliteConnection,
    route: &RouteId,
    at: Timestamp,
    input: &Input,
) -> Result<(), StoreError> {
    let route_key = sqlx::query_scalar("SELECT route_key FROM routes WHERE id = $1")
        .bind(route.as_str())
        .fetch_one(&mut *transaction)
        .await?;
    note(transaction, route_key, at, input).await
}

/// Writes that a batch was kept out of the map, or left to wait, as its row says now.
pub(super) async fn note_kept_out(
    transaction: &mut SqliteConnection,
    batch_key: i64,
    at: Timestamp,
) -> Result<(), StoreError> {
    let row = sqlx::query("SELECT route_key, id, status, reason FROM batches WHERE batch_key = $1")
        .bind(batch_key)
        .fetch_one(&mut *transaction)
        .await?;
    let input = Input::KeptOut {
        batch: name(&row, "id")?,
        status: text(&row, "status")?,
        reason: row.try_get("reason")?,
    };
    note(transaction, row.try_get("route_key")?, at, &input).await
}
