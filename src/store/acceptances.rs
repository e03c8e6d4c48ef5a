//! Changes that people have accepted into maps.

use sqlx::sqlite::SqliteRow;
use sqlx::{Row, SqliteConnection};

use super::Store;
use super::alert_records::{Acceptance, AcceptedChange};
use super::body::{SealedBody, unseal};
use super::columns::{alert_id, corrupt, json, json_text, polygon, polygon_bytes};
use super::error::StoreError;
use super::query::Query;
use crate::ids::{AlertId, EdgeId, RouteId, StampNs};

impl Store {
    /// The changes that a route's map has taken in, in the order of acceptance.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn accepted_changes(
        &self,
        route: &RouteId,
    ) -> Result<Vec<AcceptedChange>, StoreError> {
        self.read(AcceptedChanges(route)).await
    }

    /// An accepted change with what takes it back; `None` if the alert's is not in the map.
    ///
    /// # Errors
    /// [`StoreError::Corrupt`] if what takes it back has lost its checksum.
    pub async fn acceptance(&self, alert: AlertId) -> Result<Option<Acceptance>, StoreError> {
        self.read(AcceptanceOf(alert)).await
    }
}

macro_rules! select_accepted {
    ($columns:literal, $rest:literal) => {
        concat!(
            "SELECT alerts.id, accepted_changes.region, accepted_changes.since_ns, \
             accepted_changes.map_version, accepted_changes.nodes, first_edge_id",
            $columns,
            " FROM accepted_changes JOIN alerts USING (alert_key) \
             JOIN routes ON routes.route_key = accepted_changes.route_key ",
            $rest
        )
    };
}

/// The accepted changes of a route, in the order of acceptance.
pub(super) struct AcceptedChanges<'a>(pub(super) &'a RouteId);

impl Query for AcceptedChanges<'_> {
    type Answer = Vec<AcceptedChange>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let rows = sqlx::query(select_accepted!(
            "",
            "WHERE routes.id = $1 ORDER BY accepted_changes.map_version, alerts.id"
        ))
        .bind(self.0.as_str())
        .fetch_all(reader)
        .await?;
        rows.iter().map(accepted_of).collect()
    }
}

/// The accepted change of an alert with what takes it back.
pub(super) struct AcceptanceOf(pub(super) AlertId);

impl Query for AcceptanceOf {
    type Answer = Option<Acceptance>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let row = sqlx::query(select_accepted!(
            ", undo, undo_bytes, undo_sha256",
            "WHERE alerts.id = $1"
        ))
        .bind(self.0.to_string())
        .fetch_optional(reader)
        .await?;
        let Some(row) = row else { return Ok(None) };
        let undo = unseal(
            row.try_get("undo")?,
            row.try_get("undo_bytes")?,
            row.try_get("undo_sha256")?,
        );
        Ok(Some(Acceptance {
            change: accepted_of(&row)?,
            undo: undo.ok_or_else(|| corrupt("undo"))?,
        }))
    }
}

fn accepted_of(row: &SqliteRow) -> Result<AcceptedChange, StoreError> {
    Ok(AcceptedChange {
        alert_id: alert_id(row, "id")?,
        region: polygon(row, "region")?,
        since: StampNs(row.try_get("since_ns")?),
        map_version: row.try_get("map_version")?,
        nodes: json(row, "nodes")?,
        first_edge_id: EdgeId(row.try_get("first_edge_id")?),
    })
}

/// Adds an accepted change of an alert that is stored.
pub(super) async fn insert(
    transaction: &mut SqliteConnection,
    route_key: i64,
    change: &AcceptedChange,
    undo: &SealedBody,
) -> Result<(), StoreError> {
    sqlx::query(
        "INSERT INTO accepted_changes (alert_key, route_key, region, since_ns, map_version, \
         nodes, first_edge_id, undo, undo_bytes, undo_sha256) \
         SELECT alert_key, $1, $2, $3, $4, $5, $6, $7, $8, $9 FROM alerts WHERE id = $10",
    )
    .bind(route_key)
    .bind(polygon_bytes(&change.region))
    .bind(change.since.0)
    .bind(change.map_version)
    .bind(json_text(&change.nodes)?)
    .bind(change.first_edge_id.0)
    .bind(undo.compressed.as_slice())
    .bind(undo.bytes)
    .bind(undo.sha256.as_slice())
    .bind(change.alert_id.to_string())
    .execute(transaction)
    .await?;
    Ok(())
}

/// Removes an alert's accepted change. Returns whether it was there.
pub(super) async fn remove(
    transaction: &mut SqliteConnection,
    alert: AlertId,
) -> Result<bool, StoreError> {
    let removed = sqlx::query(
        "DELETE FROM accepted_changes \
         WHERE alert_key = (SELECT alert_key FROM alerts WHERE id = $1)",
    )
    .bind(alert.to_string())
    .execute(transaction)
    .await?;
    Ok(removed.rows_affected() > 0)
}
