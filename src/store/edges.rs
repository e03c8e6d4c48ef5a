//! Reading edges.

use sqlx::SqliteConnection;

use super::Store;
use super::columns::json_text;
use super::edge_columns::{edge_of, select_edges};
use super::error::StoreError;
use super::query::Query;
use super::records::{EdgeFilter, EdgeRecord};
use crate::graph::{EdgeKind, EdgeStatus};
use crate::ids::{EdgeId, RouteId};

impl Store {
    /// Every edge, by id: for tests. The service reads pages of edges, or exports the graph.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn edges(&self, route: &RouteId) -> Result<Vec<EdgeRecord>, StoreError> {
        self.read(EveryEdge(route)).await
    }

    /// By id, after `after`, at most `limit`.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn edge_page(
        &self,
        route: &RouteId,
        filter: EdgeFilter,
        after: Option<EdgeId>,
        limit: u32,
    ) -> Result<Vec<EdgeRecord>, StoreError> {
        let page = EdgePage {
            route,
            filter,
            after,
            limit,
        };
        self.read(page).await
    }

    /// Those of some edges that are there, by id.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn edges_named(
        &self,
        route: &RouteId,
        ids: &[EdgeId],
    ) -> Result<Vec<EdgeRecord>, StoreError> {
        self.read(EdgesNamed { route, ids }).await
    }

    /// One edge.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn edge(
        &self,
        route: &RouteId,
        id: EdgeId,
    ) -> Result<Option<EdgeRecord>, StoreError> {
        self.read(OneEdge { route, id }).await
    }
}

/// Every edge of a route, by id.
struct EveryEdge<'a>(&'a RouteId);

impl Query for EveryEdge<'_> {
    type Answer = Vec<EdgeRecord>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let rows = sqlx::query(select_edges!("ORDER BY edges.edge_id"))
            .bind(self.0.as_str())
            .fetch_all(reader)
            .await?;
        rows.iter().map(edge_of).collect()
    }
}

/// Edges by id, after `after`, at most `limit`.
pub(super) struct EdgePage<'a> {
    pub(super) route: &'a RouteId,
    pub(super) filter: EdgeFilter,
    pub(super) after: Option<EdgeId>,
    pub(super) limit: u32,
}

impl Query for EdgePage<'_> {
    type Answer = Vec<EdgeRecord>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let filter = self.filter;
        // Few edges are not active, and an index has them alone.
        let statement = match filter.status {
            Some(EdgeStatus::Retired | EdgeStatus::Quarantined) => {
                select_edges!(
                    "CROSS JOIN edges INDEXED BY edges_by_status USING (route_key)",
                    "AND edges.edge_id > $2 AND ($3 IS NULL OR edges.kind = $3) \
                     AND edges.status = $4 AND edges.status <> 'active' \
                     ORDER BY edges.edge_id LIMIT $5"
                )
            }
            Some(EdgeStatus::Active) | None => {
                select_edges!(
                    "CROSS JOIN edges USING (route_key)",
                    "AND edges.edge_id > $2 AND ($3 IS NULL OR edges.kind = $3) \
                     AND ($4 IS NULL OR edges.status = $4) ORDER BY edges.edge_id LIMIT $5"
                )
            }
        };
        let rows = sqlx::query(statement)
            .bind(self.route.as_str())
            .bind(self.after.map_or(-1, |id| id.0))
            .bind(filter.kind.map(EdgeKind::name))
            .bind(filter.status.map(EdgeStatus::name))
            .bind(self.limit)
            .fetch_all(reader)
            .await?;
        rows.iter().map(edge_of).collect()
    }
}

/// Those of some edges that are there, by id.
struct EdgesNamed<'a> {
    route: &'a RouteId,
    ids: &'a [EdgeId],
}

impl Query for EdgesNamed<'_> {
    type Answer = Vec<EdgeRecord>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let rows = sqlx::query(select_edges!(
            "CROSS JOIN edges USING (route_key)",
            "AND edges.edge_id IN (SELECT value FROM json_each($2)) ORDER BY edges.edge_id"
        ))
        .bind(self.route.as_str())
        .bind(json_text(self.ids)?)
        .fetch_all(reader)
        .await?;
        rows.iter().map(edge_of).collect()
    }
}

/// One edge.
struct OneEdge<'a> {
    route: &'a RouteId,
    id: EdgeId,
}

impl Query for OneEdge<'_> {
    type Answer = Option<EdgeRecord>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let row = sqlx::query(select_edges!("AND edges.edge_id = $2"))
            .bind(self.route.as_str())
            .bind(self.id.0)
            .fetch_optional(reader)
            .await?;
        row.as_ref().map(edge_of).transpose()
    }
}
