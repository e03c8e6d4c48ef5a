//! The nodes about a place, active or not, and their scans.

use sqlx::{Connection, SqliteConnection, SqlitePool};

use super::columns::json_text;
use super::error::StoreError;
use super::export::Within;
use super::intermediate_scans::IntermediateBehind;
use super::node_columns::{node_columns, node_of, node_with_scan_of, select_nodes};
use super::query::Query;
use super::records::{NodeRecord, NodeWithScan};
use super::{Store, named};
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
        named(nodes_within(&self.shared.readers, route, within).await)
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
        let mut reader = self.reader().await?;
        named(scans_of_nodes(&mut reader, route, ids, behind_max).await)
    }
}

async fn nodes_within(
    readers: &SqlitePool,
    route: &RouteId,
    Within { x, y }: Within,
) -> Result<Vec<NodeRecord>, StoreError> {
    let rows = sqlx::query(select_nodes!(
        "",
        "",
        "AND nodes.x BETWEEN $2 AND $3 AND nodes.y BETWEEN $4 AND $5 \
         ORDER BY stamp_ns, nodes.node_id"
    ))
    .bind(route.as_str())
    .bind(x[0])
    .bind(x[1])
    .bind(y[0])
    .bind(y[1])
    .fetch_all(readers)
    .await?;
    rows.iter().map(node_of).collect()
}

async fn scans_of_nodes(
    reader: &mut SqliteConnection,
    route: &RouteId,
    ids: &[NodeId],
    behind_max: u32,
) -> Result<Vec<NodeWithScan>, StoreError> {
    // One snapshot: a node and the scans behind it come together.
    let mut snapshot = reader.begin().await?;
    let rows = sqlx::query(select_nodes!(
        ", scan, scan_sha256, lidar",
        "LEFT JOIN node_scans ON node_scans.route_key = nodes.route_key \
         AND node_scans.node_id = nodes.node_id",
        "AND nodes.node_id IN (SELECT value FROM json_each($2)) ORDER BY nodes.node_id"
    ))
    .bind(route.as_str())
    .bind(json_text(ids)?)
    .fetch_all(&mut *snapshot)
    .await?;
    let behind = IntermediateBehind {
        route,
        nodes: ids,
        behind_max,
    };
    let mut behind = behind.answer(&mut snapshot).await?;
    snapshot.commit().await?;
    let with_scans = |row| {
        let mut node = node_with_scan_of(row, route)?;
        node.intermediate = behind.remove(&node.node.id).unwrap_or_default();
        Ok(node)
    };
    rows.iter().map(with_scans).collect()
}
