//! The scans of some nodes, active or not.

use sqlx::{Connection, SqliteConnection};

use super::columns::json_text;
use super::error::StoreError;
use super::graph::{node_columns, node_with_scan_of, select_nodes};
use super::intermediate_scans::intermediate_behind;
use super::records::NodeWithScan;
use super::{Store, named};
use crate::ids::{NodeId, RouteId};

impl Store {
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
    let mut behind = intermediate_behind(&mut snapshot, route, ids, behind_max).await?;
    snapshot.commit().await?;
    let with_scans = |row| {
        let mut node = node_with_scan_of(row, route)?;
        node.intermediate = behind.remove(&node.node.id).unwrap_or_default();
        Ok(node)
    };
    rows.iter().map(with_scans).collect()
}
