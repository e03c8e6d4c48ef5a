//! Nodes by the names that vehicles have for them.

use sqlx::{Row, SqlitePool};

use super::columns::json_text;
use super::error::StoreError;
use super::{Store, named};
use crate::ids::{NodeId, RouteId, VehicleId};

impl Store {
    /// The nodes of a vehicle's uploads of edges that it calls by some names, by name.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn client_nodes(
        &self,
        route: &RouteId,
        vehicle: &VehicleId,
        names: &[String],
    ) -> Result<Vec<(String, NodeId)>, StoreError> {
        named(client_nodes(&self.shared.readers, route, vehicle, names).await)
    }
}

/// The nodes of a vehicle's uploads of edges that it calls by some names, by name. Left to itself SQLite
/// reads every node of the route for each name.
pub(super) async fn client_nodes(
    readers: &SqlitePool,
    route: &RouteId,
    vehicle: &VehicleId,
    names: &[String],
) -> Result<Vec<(String, NodeId)>, StoreError> {
    let rows = sqlx::query(
        "SELECT client_id, node_id FROM json_each($3) AS name \
         CROSS JOIN nodes INDEXED BY nodes_by_client_id \
             ON nodes.route_key = (SELECT route_key FROM routes WHERE id = $1) \
             AND client_id = name.value \
         CROSS JOIN batches ON batches.batch_key = nodes.batch_key \
         WHERE vehicle_id = $2 ORDER BY client_id",
    )
    .bind(route.as_str())
    .bind(vehicle.as_str())
    .bind(json_text(names)?)
    .fetch_all(readers)
    .await?;
    let pair = |row: &sqlx::sqlite::SqliteRow| {
        Ok((row.try_get("client_id")?, NodeId(row.try_get("node_id")?)))
    };
    rows.iter().map(pair).collect()
}
