//! Taking over a map that was made anew in a copy of the route (`route_copy.rs`), in one transaction.

use std::path::{Path, PathBuf};

use jiff::Timestamp;
use sqlx::SqliteConnection;

use super::Store;
use super::alert_records::AlertRecord;
use super::alert_rows::write_alerts;
use super::columns::{micros, name};
use super::error::StoreError;
use super::inputs::{self, Input};
use super::operation_records::OperationResult;
use super::removal_records::RemovalResult;
use super::request::Request;
use super::vehicle_states::note_state;
use super::{news, operations};
use crate::ids::{OperationId, RouteId, VehicleId};

/// What becomes of the uploads that were repeated. Those that wait for another try wait on, unless they are
/// merged now; those that would be tried again in the copy wait for what comes next.
const BATCHES: [&str; 2] = [
    "UPDATE batches SET status = iif(made.status IN ('queued', 'processing'), 'unanchored', made.status), \
         reason = made.reason, flags = made.flags, nodes_added = made.nodes_added, \
         loop_closures = made.loop_closures, nodes_at_try = made.nodes_at_try, \
         processed_at_us = made.processed_at_us \
     FROM other.batches AS made WHERE made.batch_key = batches.batch_key AND batches.route_key = $1 \
     AND batches.batch_key IN (SELECT batch_key FROM other.rebuild_batches WHERE touched) \
     AND batches.status NOT IN ('held', 'removed') \
     AND (batches.status NOT IN ('queued', 'processing') OR made.status = 'merged')",
    "DELETE FROM jobs WHERE route_key = $1 \
     AND batch_key IN (SELECT batch_key FROM batches WHERE route_key = $1 AND status = 'merged')",
];

/// The map as it is goes …
const CLEAR: [&str; 6] = [
    "DELETE FROM accepted_changes WHERE route_key = $1",
    "DELETE FROM edges WHERE route_key = $1",
    "DELETE FROM nodes WHERE route_key = $1",
    "DELETE FROM archive_sums WHERE route_key = $1",
    "DELETE FROM lidar_calibrations WHERE route_key = $1",
    "DELETE FROM clock_faults WHERE route_key = $1",
];

/// … and what was made anew comes. Ids of nodes and edges are never used again.
const TAKE_OVER: [&str; 10] = [
    "INSERT INTO nodes SELECT * FROM other.nodes WHERE route_key = $1",
    "INSERT INTO node_scans SELECT * FROM other.node_scans WHERE route_key = $1",
    "INSERT INTO intermediate_scans SELECT * FROM other.intermediate_scans WHERE route_key = $1",
    "INSERT INTO edges SELECT * FROM other.edges WHERE route_key = $1",
    "INSERT INTO closures SELECT * FROM other.closures WHERE route_key = $1",
    "INSERT INTO archive_sums SELECT * FROM other.archive_sums WHERE route_key = $1",
    "INSERT INTO lidar_calibrations SELECT * FROM other.lidar_calibrations WHERE route_key = $1",
    "INSERT INTO clock_faults SELECT * FROM other.clock_faults WHERE route_key = $1",
    "UPDATE trips SET (corrections, clock_ahead_ns) = (SELECT corrections, clock_ahead_ns \
     FROM other.trips AS made WHERE made.route_key = $1 AND made.trip_id = trips.trip_id) \
     WHERE route_key = $1 \
     AND trip_id IN (SELECT trip_id FROM other.trips AS made WHERE made.route_key = $1)",
    "UPDATE routes SET stage = made.stage, nodes = made.nodes, edges = made.edges, \
         loop_closures = made.loop_closures, subgraphs = made.subgraphs, \
         next_node_id = max(routes.next_node_id, made.next_node_id), \
         next_edge_id = max(routes.next_edge_id, made.next_edge_id) \
     FROM other.routes AS made WHERE routes.route_key = $1 AND made.route_key = $1",
];

/// After the alerts are written, which these belong to.
const ACCEPTED: &str = "INSERT INTO accepted_changes (alert_key, route_key, region, since_ns, map_version, \
     nodes, first_edge_id, undo, undo_bytes, undo_sha256) \
     SELECT alerts.alert_key, $1, accepted.region, accepted.since_ns, accepted.map_version, \
     accepted.nodes, first_edge_id, undo, undo_bytes, undo_sha256 \
     FROM other.accepted_changes AS accepted \
     JOIN other.alerts AS made ON made.alert_key = accepted.alert_key \
     JOIN alerts ON alerts.id = made.id AND alerts.status = 'accepted' WHERE accepted.route_key = $1";

/// A map that was made anew, and what follows from it.
#[derive(Debug, Clone, PartialEq)]
pub struct Adoption {
    /// The removal that ends with it, unless it has ended.
    pub operation: OperationId,
    /// The route.
    pub route_id: RouteId,
    /// The route's revision that it was computed from.
    pub base_revision: i64,
    /// The database that holds the map.
    pub made_in: PathBuf,
    /// Whether everything in the route's map was repeated, or it is not adopted.
    pub is_whole: bool,
    /// Alerts that are new or change.
    pub alerts: Vec<AlertRecord>,
    /// What the operation's result says.
    pub result: RemovalResult,
    /// When.
    pub at: Timestamp,
}

impl Store {
    /// Puts a map that was made anew in the place of the route's; false if the route has moved on since.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn adopt(&self, adoption: Adoption) -> Result<bool, StoreError> {
        self.work(adoption).await
    }

    /// The file that holds the database.
    pub fn database_path(&self) -> &Path {
        self.shared.database.path()
    }
}

impl Request for Adoption {
    type Outcome = bool;
    const QUEUES_JOBS: bool = false;

    fn other_database(&self) -> Option<&Path> {
        Some(&self.made_in)
    }

    async fn execute(&self, transaction: &mut SqliteConnection) -> Result<bool, StoreError> {
        let route_key: Option<i64> = sqlx::query_scalar(
            "UPDATE main.routes SET revision = revision + 1, updated_at_us = $1 \
             WHERE id = $2 AND revision = $3 RETURNING route_key",
        )
        .bind(micros(self.at))
        .bind(self.route_id.as_str())
        .bind(self.base_revision)
        .fetch_optional(&mut *transaction)
        .await?;
        let Some(route_key) = route_key else {
            return Ok(false);
        };
        if self.is_whole {
            check_whole(transaction, route_key).await?;
        }
        for statement in BATCHES.into_iter().chain(CLEAR).chain(TAKE_OVER) {
            sqlx::query(statement)
                .bind(route_key)
                .execute(&mut *transaction)
                .await?;
        }
        write_alerts(transaction, route_key, &self.alerts).await?;
        sqlx::query(ACCEPTED)
            .bind(route_key)
            .execute(&mut *transaction)
            .await?;
        self.note_vehicles(transaction, route_key).await?;
        let input = Input::Rebuilt {
            operation: self.operation,
        };
        inputs::note(transaction, route_key, self.at, &input).await?;
        let outcome = Ok(OperationResult::Removal(self.result.clone()));
        // Where the journal is repeated, the operation ended with the removal.
        operations::end(transaction, self.operation, &outcome, self.at).await?;
        Ok(true)
    }

    fn committed(&self, is_adopted: &bool) {
        if *is_adopted {
            news::alerts_written(&self.alerts);
        }
    }
}

/// A body may have been deleted before it was copied.
async fn check_whole(transaction: &mut SqliteConnection, route_key: i64) -> Result<(), StoreError> {
    let missing: i64 = sqlx::query_scalar(
        "SELECT count(*) FROM batches WHERE route_key = $1 AND status = 'merged' \
         AND batch_key NOT IN (SELECT batch_key FROM other.rebuild_batches WHERE touched)",
    )
    .bind(route_key)
    .fetch_one(transaction)
    .await?;
    match missing {
        0 => Ok(()),
        _ => Err(StoreError::InvalidResult(format!(
            "{missing} batches in the map could not be repeated"
        ))),
    }
}

impl Adoption {
    /// Determines the states of the route's vehicles anew.
    async fn note_vehicles(
        &self,
        transaction: &mut SqliteConnection,
        route_key: i64,
    ) -> Result<(), StoreError> {
        let rows = sqlx::query(
            "SELECT DISTINCT vehicle_id FROM trips WHERE route_key = $1 ORDER BY vehicle_id",
        )
        .bind(route_key)
        .fetch_all(&mut *transaction)
        .await?;
        for row in &rows {
            let vehicle: VehicleId = name(row, "vehicle_id")?;
            note_state(transaction, route_key, &vehicle, self.at).await?;
        }
        Ok(())
    }
}
