//! Archived nodes: those that do not take part in the optimisation any more, and how they are reactivated.

use sqlx::SqliteConnection;

use super::columns::json_text;
use super::error::StoreError;
use super::query::Query;
use super::request::Request;
use super::{Store, archive};
use crate::ids::{EdgeId, NodeId, RouteId, TripId};

impl Store {
    /// The archived nodes among the last `length` of a trip, ascending.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn archived_tail(
        &self,
        route: &RouteId,
        trip: &TripId,
        length: usize,
    ) -> Result<Vec<NodeId>, StoreError> {
        let tail = ArchivedTail {
            route,
            trip,
            length,
        };
        self.read(tail).await
    }

    /// The archived nodes among some nodes and the ends of some edges, ascending.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn archived_among(
        &self,
        route: &RouteId,
        nodes: &[NodeId],
        edges: &[EdgeId],
    ) -> Result<Vec<NodeId>, StoreError> {
        let among = ArchivedAmong {
            route,
            nodes,
            edges,
        };
        self.read(among).await
    }

    /// Makes archived nodes active again, with the poses that they had and their edges to other active
    /// nodes. The route's revision is raised if any of them was archived.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn reactivate_nodes(
        &self,
        route: &RouteId,
        nodes: Vec<NodeId>,
    ) -> Result<(), StoreError> {
        let route = route.clone();
        self.work(Reactivate { route, nodes }).await
    }
}

/// The archived nodes among the last of a trip.
struct ArchivedTail<'a> {
    route: &'a RouteId,
    trip: &'a TripId,
    length: usize,
}

impl Query for ArchivedTail<'_> {
    type Answer = Vec<NodeId>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        // The trip's newest uploads first, as many as hold that many nodes.
        let ids = sqlx::query_scalar(
            "SELECT node_id FROM ( \
                 SELECT node_id, active FROM routes JOIN batches USING (route_key) \
                 CROSS JOIN nodes ON nodes.batch_key = batches.batch_key \
                 WHERE routes.id = $1 AND batches.trip_id = $2 \
                 ORDER BY batches.sequence DESC, node_id DESC LIMIT $3) \
             WHERE NOT active ORDER BY node_id",
        )
        .bind(self.route.as_str())
        .bind(self.trip.as_str())
        .bind(i64::try_from(self.length).unwrap_or(i64::MAX))
        .fetch_all(reader)
        .await?;
        Ok(ids.into_iter().map(NodeId).collect())
    }
}

/// The archived nodes among some nodes and the ends of some edges.
struct ArchivedAmong<'a> {
    route: &'a RouteId,
    nodes: &'a [NodeId],
    edges: &'a [EdgeId],
}

impl Query for ArchivedAmong<'_> {
    type Answer = Vec<NodeId>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
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
        .bind(self.route.as_str())
        .bind(json_text(self.nodes)?)
        .bind(json_text(self.edges)?)
        .fetch_all(reader)
        .await?;
        Ok(ids.into_iter().map(NodeId).collect())
    }
}

/// Makes archived nodes active again.
struct Reactivate {
    route: RouteId,
    nodes: Vec<NodeId>,
}

impl Request for Reactivate {
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
