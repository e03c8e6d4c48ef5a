//! Nodes that have left the active graph: what of them is still asked for, and their way back.

use sqlx::sqlite::SqliteRow;
use sqlx::{Row, SqliteConnection, SqlitePool};

use super::archive;
use super::columns::{json_text, name};
use super::error::StoreError;
use super::graph::{edge_of, select_edges};
use super::records::{EdgeRecord, SETTLED_CLOSURES_MAX, SettledClosure};
use super::request::Request;
use super::{Store, named};
use crate::ids::{EdgeId, NodeId, RouteId, TripId};

impl Store {
    /// The nodes that have left the active graph among the last `length` of a trip.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn settled_tail(
        &self,
        route: &RouteId,
        trip: &TripId,
        length: usize,
    ) -> Result<Vec<NodeId>, StoreError> {
        named(tail(&self.shared.readers, route, trip, length).await)
    }

    /// The nodes that have left the active graph among some nodes and the ends of some edges.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn settled_among(
        &self,
        route: &RouteId,
        nodes: &[NodeId],
        edges: &[EdgeId],
    ) -> Result<Vec<NodeId>, StoreError> {
        named(among(&self.shared.readers, route, nodes, edges).await)
    }

    /// Takes nodes back into the active graph, where they were, with their edges to other active
    /// nodes. The route's revision is raised if any had left.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn recall_nodes(
        &self,
        route: &RouteId,
        nodes: Vec<NodeId>,
    ) -> Result<(), StoreError> {
        let route = route.clone();
        self.work(Recall { route, nodes }).await
    }

    /// How many nodes a route's active graph has.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn active_nodes(&self, route: &RouteId) -> Result<i64, StoreError> {
        named(count_active(&self.shared.readers, route).await)
    }
}

/// The edges between active nodes, by id.
pub(super) async fn active_edges(
    reader: &mut SqliteConnection,
    route: &RouteId,
) -> Result<Vec<EdgeRecord>, StoreError> {
    // By their newer nodes: a reference is the older node of every lap's closures, most of which
    // have left.
    let rows = sqlx::query(select_edges!(
        "CROSS JOIN nodes AS newer INDEXED BY nodes_active \
             ON newer.route_key = routes.route_key AND newer.active = 1 \
         CROSS JOIN edges INDEXED BY edges_by_to ON edges.route_key = newer.route_key AND edges.to_node = newer.node_id \
         JOIN nodes AS older ON older.route_key = edges.route_key \
             AND older.node_id = edges.from_node AND older.active = 1",
        "ORDER BY edges.edge_id"
    ))
    .bind(route.as_str())
    .fetch_all(reader)
    .await?;
    rows.iter().map(edge_of).collect()
}

/// The first closures that have left, by id.
pub(super) async fn first_closures(
    reader: &mut SqliteConnection,
    route: &RouteId,
) -> Result<Vec<SettledClosure>, StoreError> {
    let rows = sqlx::query(
        "SELECT edges.edge_id, from_node, to_node, edges.subgraph_id, delta_f, vehicle_id, \
             closures.edge_id IS NULL AS given \
         FROM routes CROSS JOIN edges USING (route_key) \
         LEFT JOIN closures ON closures.route_key = edges.route_key \
             AND closures.edge_id = edges.edge_id \
         JOIN nodes AS older ON older.route_key = edges.route_key \
             AND older.node_id = edges.from_node \
         JOIN nodes AS newer ON newer.route_key = edges.route_key \
             AND newer.node_id = edges.to_node \
         JOIN batches ON batches.batch_key = \
             iif(edges.to_node > edges.from_node, newer.batch_key, older.batch_key) \
         WHERE routes.id = $1 AND delta_f IS NOT NULL AND NOT (older.active AND newer.active) \
         ORDER BY edges.edge_id LIMIT $2",
    )
    .bind(route.as_str())
    .bind(i64::try_from(SETTLED_CLOSURES_MAX).unwrap_or(i64::MAX))
    .fetch_all(reader)
    .await?;
    let closure = |row: &SqliteRow| {
        Ok(SettledClosure {
            id: EdgeId(row.try_get("edge_id")?),
            from: NodeId(row.try_get("from_node")?),
            to: NodeId(row.try_get("to_node")?),
            subgraph_id: row.try_get("subgraph_id")?,
            delta_f: row.try_get("delta_f")?,
            vehicle_id: name(row, "vehicle_id")?,
            given: row.try_get("given")?,
        })
    };
    rows.iter().map(closure).collect()
}

/// The nodes that have left among the last of a trip.
pub(super) async fn tail(
    readers: &SqlitePool,
    route: &RouteId,
    trip: &TripId,
    tail: usize,
) -> Result<Vec<NodeId>, StoreError> {
    // The trip's newest uploads first, as far as it takes.
    let ids = sqlx::query_scalar(
        "SELECT node_id FROM ( \
             SELECT node_id, active FROM routes JOIN batches USING (route_key) \
             CROSS JOIN nodes ON nodes.batch_key = batches.batch_key \
             WHERE routes.id = ? AND batches.trip_id = ? \
             ORDER BY batches.sequence DESC, node_id DESC LIMIT ?) \
         WHERE NOT active ORDER BY node_id",
    )
    .bind(route.as_str())
    .bind(trip.as_str())
    .bind(i64::try_from(tail).unwrap_or(i64::MAX))
    .fetch_all(readers)
    .await?;
    Ok(ids.into_iter().map(NodeId).collect())
}

/// The nodes that have left among some nodes and the ends of some edges.
pub(super) async fn among(
    readers: &SqlitePool,
    route: &RouteId,
    nodes: &[NodeId],
    edges: &[EdgeId],
) -> Result<Vec<NodeId>, StoreError> {
    let ids = sqlx::query_scalar(
        "SELECT node_id FROM nodes JOIN routes USING (route_key) \
         WHERE routes.id = ?1 AND NOT active AND node_id IN ( \
             SELECT value FROM json_each(?2) \
             UNION SELECT from_node FROM edges \
                 WHERE edges.route_key = (SELECT route_key FROM routes WHERE id = ?1) \
                 AND edge_id IN (SELECT value FROM json_each(?3)) \
             UNION SELECT to_node FROM edges \
                 WHERE edges.route_key = (SELECT route_key FROM routes WHERE id = ?1) \
                 AND edge_id IN (SELECT value FROM json_each(?3))) \
         ORDER BY node_id",
    )
    .bind(route.as_str())
    .bind(json_text(nodes)?)
    .bind(json_text(edges)?)
    .fetch_all(readers)
    .await?;
    Ok(ids.into_iter().map(NodeId).collect())
}

/// How many nodes take part in the optimisation.
pub(super) async fn count_active(readers: &SqlitePool, route: &RouteId) -> Result<i64, StoreError> {
    let count = sqlx::query_scalar(
        "SELECT count(*) FROM routes \
         CROSS JOIN nodes INDEXED BY nodes_active USING (route_key) \
         WHERE routes.id = $1 AND nodes.active = 1",
    )
    .bind(route.as_str())
    .fetch_one(readers)
    .await?;
    Ok(count)
}

/// Takes nodes back into the active graph.
pub(super) struct Recall {
    pub(super) route: RouteId,
    pub(super) nodes: Vec<NodeId>,
}

impl Request for Recall {
    type Outcome = ();
    const QUEUES_JOBS: bool = false;

    async fn execute(&self, transaction: &mut SqliteConnection) -> Result<(), StoreError> {
        let reactivated: Vec<(i64, i64)> = sqlx::query_as(
            "UPDATE nodes SET active = 1 \
             WHERE route_key = (SELECT route_key FROM routes WHERE id = $1) AND active = 0 \
             AND node_id IN (SELECT value FROM json_each($2)) RETURNING route_key, node_id",
        )
        .bind(self.route.as_str())
        .bind(json_text(&self.nodes)?)
        .fetch_all(&mut *transaction)
        .await?;
        let Some(&(route_key, _)) = reactivated.first() else {
            return Ok(());
        };
        let nodes: Vec<NodeId> = reactivated.iter().map(|(_, node)| NodeId(*node)).collect();
        archive::take_reactivated(transaction, route_key, &nodes).await?;
        sqlx::query("UPDATE routes SET revision = revision + 1 WHERE route_key = $1")
            .bind(route_key)
            .execute(transaction)
            .await?;
        Ok(())
    }
}
