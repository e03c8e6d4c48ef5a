//! Reading nodes.

use sqlx::SqliteConnection;
use sqlx::sqlite::SqliteRow;

use super::Store;
use super::columns::json_text;
use super::error::StoreError;
use super::intermediate_scans::ActiveIntermediate;
use super::node_columns::{
    node_columns, node_of, node_with_scan_of, select_nodes, select_nodes_with_scans,
};
use super::query::Query;
use super::records::{NodeRecord, NodeWithScan};
use super::scan_columns::scan_of;
use crate::ids::{NodeId, RouteId, TripId};

impl Store {
    /// Every node, by id: for tests. The service reads pages of nodes, or exports the graph.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn nodes(&self, route: &RouteId) -> Result<Vec<NodeRecord>, StoreError> {
        self.read(EveryNode(route)).await
    }

    /// By id, after `after`, at most `limit`.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn node_page(
        &self,
        route: &RouteId,
        after: Option<NodeId>,
        limit: u32,
    ) -> Result<Vec<NodeRecord>, StoreError> {
        let page = NodePage {
            route,
            after,
            limit,
        };
        self.read(page).await
    }

    /// Those of some nodes that are there, by id.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn nodes_named(
        &self,
        route: &RouteId,
        ids: &[NodeId],
    ) -> Result<Vec<NodeRecord>, StoreError> {
        self.read(NodesNamed { route, ids }).await
    }

    /// One node.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn node(
        &self,
        route: &RouteId,
        id: NodeId,
    ) -> Result<Option<NodeRecord>, StoreError> {
        self.read(OneNode { route, id }).await
    }

    /// Every active node with its scan and those behind it, by id: what a map picture is drawn
    /// from. A scan that has lost its checksum is left out.
    ///
    /// # Errors
    /// [`StoreError::Corrupt`] if a node has.
    pub async fn nodes_with_scans(&self, route: &RouteId) -> Result<Vec<NodeWithScan>, StoreError> {
        self.read(NodesWithScans(route)).await
    }

    /// The scan of a node: the bytes of [`crate::scan::encode_scan`].
    ///
    /// # Errors
    /// [`StoreError::Corrupt`] with [`Corruption::Scan`](super::Corruption::Scan) if it has lost its
    /// checksum.
    pub async fn node_scan(
        &self,
        route: &RouteId,
        id: NodeId,
    ) -> Result<Option<Vec<u8>>, StoreError> {
        self.read(NodeScan { route, id }).await
    }

    /// The nodes of a trip, active or not, in the order of their scans: for tests. The service exports
    /// trajectories.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn trip_nodes(
        &self,
        route: &RouteId,
        trip: &TripId,
    ) -> Result<Vec<NodeRecord>, StoreError> {
        self.read(TripNodes { route, trip }).await
    }
}

/// Every node of a route, by id.
struct EveryNode<'a>(&'a RouteId);

impl Query for EveryNode<'_> {
    type Answer = Vec<NodeRecord>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let rows = sqlx::query(select_nodes!("", "", "ORDER BY nodes.node_id"))
            .bind(self.0.as_str())
            .fetch_all(reader)
            .await?;
        rows.iter().map(node_of).collect()
    }
}

/// Nodes by id, after `after`, at most `limit`.
pub(super) struct NodePage<'a> {
    pub(super) route: &'a RouteId,
    pub(super) after: Option<NodeId>,
    pub(super) limit: u32,
}

impl Query for NodePage<'_> {
    type Answer = Vec<NodeRecord>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let rows = sqlx::query(select_nodes!(
            "",
            "",
            "AND nodes.node_id > $2 ORDER BY nodes.node_id LIMIT $3"
        ))
        .bind(self.route.as_str())
        .bind(self.after.map_or(-1, |id| id.0))
        .bind(self.limit)
        .fetch_all(reader)
        .await?;
        rows.iter().map(node_of).collect()
    }
}

/// Those of some nodes that are there, by id.
struct NodesNamed<'a> {
    route: &'a RouteId,
    ids: &'a [NodeId],
}

impl Query for NodesNamed<'_> {
    type Answer = Vec<NodeRecord>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let rows = sqlx::query(select_nodes!(
            "",
            "",
            "AND nodes.node_id IN (SELECT value FROM json_each($2)) ORDER BY nodes.node_id"
        ))
        .bind(self.route.as_str())
        .bind(json_text(self.ids)?)
        .fetch_all(reader)
        .await?;
        rows.iter().map(node_of).collect()
    }
}

/// One node.
struct OneNode<'a> {
    route: &'a RouteId,
    id: NodeId,
}

impl Query for OneNode<'_> {
    type Answer = Option<NodeRecord>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let row = sqlx::query(select_nodes!("", "", "AND nodes.node_id = $2"))
            .bind(self.route.as_str())
            .bind(self.id.0)
            .fetch_optional(reader)
            .await?;
        row.as_ref().map(node_of).transpose()
    }
}

/// The nodes of a trip, active or not, in the order of their scans.
struct TripNodes<'a> {
    route: &'a RouteId,
    trip: &'a TripId,
}

impl Query for TripNodes<'_> {
    type Answer = Vec<NodeRecord>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        // CROSS JOIN keeps SQLite from reading all nodes of the route.
        let rows = sqlx::query(concat!(
            "SELECT ",
            node_columns!(),
            "FROM routes JOIN batches USING (route_key) \
             CROSS JOIN nodes ON nodes.batch_key = batches.batch_key \
             WHERE routes.id = $1 AND batches.trip_id = $2 ORDER BY stamp_ns, nodes.node_id"
        ))
        .bind(self.route.as_str())
        .bind(self.trip.as_str())
        .fetch_all(reader)
        .await?;
        rows.iter().map(node_of).collect()
    }
}

/// Every active node, by id, with the scans that it has.
pub(super) struct ActiveNodes<'a>(pub(super) &'a RouteId);

impl Query for ActiveNodes<'_> {
    type Answer = Vec<NodeWithScan>;
    const ONE_SNAPSHOT: bool = true;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let rows = sqlx::query(select_nodes_with_scans!(
            "LEFT JOIN",
            "AND nodes.active = 1 ORDER BY nodes.node_id"
        ))
        .bind(self.0.as_str())
        .fetch_all(&mut *reader)
        .await?;
        with_scans_behind(reader, self.0, &rows).await
    }
}

/// Every active node that has a scan, by id, with it and those behind it.
struct NodesWithScans<'a>(&'a RouteId);

impl Query for NodesWithScans<'_> {
    type Answer = Vec<NodeWithScan>;
    const ONE_SNAPSHOT: bool = true;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let rows = sqlx::query(select_nodes_with_scans!(
            "JOIN",
            "AND nodes.active = 1 ORDER BY nodes.node_id"
        ))
        .bind(self.0.as_str())
        .fetch_all(&mut *reader)
        .await?;
        with_scans_behind(reader, self.0, &rows).await
    }
}

/// The nodes of rows, each with the scans behind it.
async fn with_scans_behind(
    reader: &mut SqliteConnection,
    route: &RouteId,
    rows: &[SqliteRow],
) -> Result<Vec<NodeWithScan>, StoreError> {
    let mut behind = ActiveIntermediate(route).answer(reader).await?;
    let node = |row: &SqliteRow| {
        let mut node = node_with_scan_of(row, route)?;
        node.intermediate = behind.remove(&node.node.id).unwrap_or_default();
        Ok(node)
    };
    rows.iter().map(node).collect()
}

/// The scan of a node.
pub(super) struct NodeScan<'a> {
    pub(super) route: &'a RouteId,
    pub(super) id: NodeId,
}

impl Query for NodeScan<'_> {
    type Answer = Option<Vec<u8>>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let row = sqlx::query(
            "SELECT scan, scan_sha256 FROM routes JOIN node_scans USING (route_key) \
             WHERE routes.id = $1 AND node_id = $2",
        )
        .bind(self.route.as_str())
        .bind(self.id.0)
        .fetch_optional(reader)
        .await?;
        row.map(|row| scan_of(&row, self.route, self.id))
            .transpose()
    }
}
