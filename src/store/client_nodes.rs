//! Nodes by the names that vehicles have for them.

use sqlx::{Row, SqliteConnection};

use super::Store;
use super::columns::json_text;
use super::error::StoreError;
use super::query::Query;
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
        let nodes = ClientNodes {
            route,
            vehicle,
            names,
        };
        self.read(nodes).await
    }
}

/// The nodes of a vehicle's uploads of edges that it calls by some names, by name.
struct ClientNodes<'a> {
    route: &'a RouteId,
    vehicle: &'a VehicleId,
    names: &'a [String],
}

impl Query for ClientNodes<'_> {
    type Answer = Vec<(String, NodeId)>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        // CROSS JOIN: left to itself SQLite reads every node of the route for each name.
        let rows = sqlx::query(
            "SELECT client_id, node_id FROM json_each($3) AS name \
             CROSS JOIN nodes INDEXED BY nodes_by_client_id \
                 ON nodes.route_key = (SELECT route_key FROM routes WHERE id = $1) \
                 AND client_id = name.value \
             CROSS JOIN batches ON batches.batch_key = nodes.batch_key \
             WHERE vehicle_id = $2 ORDER BY client_id",
        )
        .bind(self.route.as_str())
        .bind(self.vehicle.as_str())
        .bind(json_text(self.names)?)
        .fetch_all(reader)
        .await?;
        let pair = |row: &sqlx::sqlite::SqliteRow| {
            Ok((row.try_get("client_id")?, NodeId(row.try_get("node_id")?)))
        };
        rows.iter().map(pair).collect()
    }
}
