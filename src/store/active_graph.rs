//! Reads of the active graph: the nodes that take part in the optimisation, and the edges between them.

use sqlx::SqliteConnection;

use super::Store;
use super::columns::json_text;
use super::edge_columns::{edge_of, select_edges};
use super::error::StoreError;
use super::query::Query;
use super::records::EdgeRecord;
use crate::ids::{EdgeId, RouteId};

impl Store {
    /// How many nodes a route's active graph has.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn active_nodes(&self, route: &RouteId) -> Result<i64, StoreError> {
        self.read(CountActive(route)).await
    }

    /// The loop closures among some edges that are not retired, whether their nodes are active or
    /// archived, ascending.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn active_closures_among(
        &self,
        route: &RouteId,
        edges: &[EdgeId],
    ) -> Result<Vec<EdgeId>, StoreError> {
        self.read(ActiveClosuresAmong { route, edges }).await
    }
}

/// Joins the edges between active nodes to `routes`, as `edges` from `older` to `newer`: by their
/// newer nodes, since a reference is the older node of many closures whose newer nodes are archived.
/// Without these hints SQLite reads every edge of the route for each active node.
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
pub(super) struct ActiveEdges<'a>(pub(super) &'a RouteId);

impl Query for ActiveEdges<'_> {
    type Answer = Vec<EdgeRecord>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let rows = sqlx::query(select_edges!(
            join_active_edges!(),
            "ORDER BY edges.edge_id"
        ))
        .bind(self.0.as_str())
        .fetch_all(reader)
        .await?;
        rows.iter().map(edge_of).collect()
    }
}

/// How many nodes take part in the optimisation.
struct CountActive<'a>(&'a RouteId);

impl Query for CountActive<'_> {
    type Answer = i64;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let count = sqlx::query_scalar(
            "SELECT count(*) FROM routes \
             CROSS JOIN nodes INDEXED BY nodes_active USING (route_key) \
             WHERE routes.id = $1 AND nodes.active = 1",
        )
        .bind(self.0.as_str())
        .fetch_one(reader)
        .await?;
        Ok(count)
    }
}

/// The closures among some edges that are optimised while their nodes are active.
struct ActiveClosuresAmong<'a> {
    route: &'a RouteId,
    edges: &'a [EdgeId],
}

impl Query for ActiveClosuresAmong<'_> {
    type Answer = Vec<EdgeId>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let ids = sqlx::query_scalar(
            "SELECT edge_id FROM routes JOIN edges USING (route_key) \
             WHERE routes.id = $1 AND edge_id IN (SELECT value FROM json_each($2)) \
             AND kind = 'loop_closure' AND status = 'active' ORDER BY edge_id",
        )
        .bind(self.route.as_str())
        .bind(json_text(self.edges)?)
        .fetch_all(reader)
        .await?;
        Ok(ids.into_iter().map(EdgeId).collect())
    }
}
