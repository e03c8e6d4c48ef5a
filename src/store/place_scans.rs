//! The nodes about a place, active or not, and their scans.

use sqlx::SqliteConnection;

use super::Store;
use super::columns::json_text;
use super::error::StoreError;
use super::export::Within;
use super::intermediate_scans::IntermediateBehind;
use super::node_columns::{node_columns, node_of, node_with_scan_of, select_nodes};
use super::query::Query;
use super::records::{NodeRecord, NodeWithScan};
use crate::ids::{NodeId, RouteId};

impl Store {
    /// The nodes within a rectangle, active or not, in the order of their stamps.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn nodes_within(
        &self,
        route: &RouteId,
        within: Within,
    ) -> Result<Vec<NodeRecord>, StoreError> {
        self.read(NodesWithin { route, within }).await
    }

    /// Those of some nodes that are there, by id, with their scans and of those behind each the first
    /// `behind_max`. A scan that has lost its checksum is left out.
    ///
    /// # Errors
    /// [`StoreError::Corrupt`] if a node has.
    pub async fn scans_of_nodes(
        &self,
        route: &RouteId,
        ids: &[NodeId],
        behind_max: u32,
    ) -> Result<Vec<NodeWithScan>, StoreError> {
        let scans = ScansOfNodes {
            route,
            ids,
            behind_max,
        };
        self.read(scans).await
    }
}

/// The nodes within a rectangle, in the order of their stamps.
struct NodesWithin<'a> {
    route: &'a RouteId,
    within: Within,
}

impl Query for NodesWithin<'_> {
    type Answer = Vec<NodeRecord>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let Within { x, y } = self.within;
        let rows = sqlx::query(select_nodes!(
            "",
            "",
            "AND nodes.x BETWEEN $2 AND $3 AND nodes.y BETWEEN $4 AND $5 \
             ORDER BY stamp_ns, nodes.node_id"
        ))
        .bind(self.route.as_str())
        .bind(x[0])
        .bind(x[1])
        .bind(y[0])
        .bind(y[1])
        .fetch_all(reader)
        .await?;
        rows.iter().map(node_of).collect()
    }
}

/// Some nodes with their scans and the first scans behind each.
struct ScansOfNodes<'a> {
    route: &'a RouteId,
    ids: &'a [NodeId],
    behind_max: u32,
}

impl Query for ScansOfNodes<'_> {
    type Answer = Vec<NodeWithScan>;
    const ONE_SNAPSHOT: bool = true;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let Self {
            route,
            ids,
            behind_max,
        } = *self;
        let rows = sqlx::query(select_nodes!(
            ", scan, scan_sha256, lidar",
            "LEFT JOIN node_scans ON node_scans.route_key = nodes.route_key \
             AND node_scans.node_id = nodes.node_id",
            "AND nodes.node_id IN (SELECT value FROM json_each($2)) ORDER BY nodes.node_id"
        ))
        .bind(route.as_str())
        .bind(json_text(ids)?)
        .fetch_all(&mut *reader)
        .await?;
        let behind = IntermediateBehind {
            route,
            nodes: ids,
            behind_max,
        };
        let mut behind = behind.answer(reader).await?;
        let with_scans = |row| {
            let mut node = node_with_scan_of(row, route)?;
            node.intermediate = behind.remove(&node.node.id).unwrap_or_default();
            Ok(node)
        };
        rows.iter().map(with_scans).collect()
    }
}
