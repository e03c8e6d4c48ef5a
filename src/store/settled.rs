//! Nodes that have left the active graph: what of them is still asked for, and their way back.

use sqlx::{SqliteConnection, SqlitePool};

use super::archive;
use super::columns::json_text;
use super::error::StoreError;
use super::graph::{edge_of, select_edges};
use super::records::EdgeRecord;
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

    /// The loop closures among some edges that are not retired, whether their nodes are active or have
    /// left, ascending.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn active_closures_among(
        &self,
        route: &RouteId,
        edges: &[EdgeId],
    ) -> Result<Vec<EdgeId>, StoreError> {
        named(closures_among(&self.shared.readers, route, edges).await)
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

/// Joins the edges between active nodes to `routes`, as `edges` from `older` to `newer`: by their
/// newer nodes, since a reference is the older node of every lap's closures, most of which have
/// left. Left to itself SQLite reads every edge of the route for each active node.
macro_rules! join_active_edges {
    () => {
        "CROSS JOIN nodes AS newer INDEXED BY nodes_active \
             ON newer.route_key = routes.route_key AND newer.active = 1 \
         CROSS JOIN edges INDEXED BY edges_by_to \
             ON edges.route_key = newer.route_key AND edges.to_node = newer.node_id \
         JOIN nodes AS older ON older.route_key = edges.route_key \
             AND older.node_id = edges.from_node AND older.active = 1"
    };
}
pub(super) use join_active_edges;

/// The edges between active nodes, by id.
pub(super) async fn active_edges(
    reader: &mut SqliteConnection,
    route: &RouteId,
) -> Result<Vec<EdgeRecord>, StoreError> {
    let rows = sqlx::query(select_edges!(
        join_active_edges!(),
        "ORDER BY edges.edge_id"
    ))
    .bind(route.as_str())
    .fetch_all(reader)
    .await?;
    rows.iter().map(edge_of).collect()
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
             WHERE routes.id = $1 AND batches.trip_id = $2 \
             ORDER BY batches.sequence DESC, node_id DESC LIMIT $3) \
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
         WHERE routes.id = $1 AND NOT active AND node_id IN ( \
             SELECT value FROM json_each($2) \
             UNION SELECT from_node FROM edges \
                 WHERE edges.route_key = (SELECT route_key FROM routes WHERE id = $1) \
                 AND edge_id IN (SELECT value FROM json_each($3)) \
             UNION SELECT to_node FROM edges \
                 WHERE edges.route_key = (SELECT route_key FROM routes WHERE id = $1) \
                 AND edge_id IN (SELECT value FROM json_each($3))) \
         ORDER BY node_id",
    )
    .bind(route.as_str())
    .bind(json_text(nodes)?)
    .bind(json_text(edges)?)
    .fetch_all(readers)
    .await?;
    Ok(ids.into_iter().map(NodeId).collect())
}

/// The closures among some edges that are optimised while their nodes are active.
async fn closures_among(
    readers: &SqlitePool,
    route: &RouteId,
    edges: &[EdgeId],
) -> Result<Vec<EdgeId>, StoreError> {
    let ids = sqlx::query_scalar(
        "SELECT edge_id FROM routes JOIN edges USING (route_key) \
         WHERE routes.id = $1 AND edge_id IN (SELECT value FROM json_each($2)) \
         AND kind = 'loop_closure' AND status = 'active' ORDER BY edge_id",
    )
    .bind(route.as_str())
    .bind(json_text(edges)?)
    .fetch_all(readers)
    .await?;
    Ok(ids.into_iter().map(EdgeId).collect())
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
