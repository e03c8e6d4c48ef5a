//! The scans of some nodes, active or not.

use sqlx::SqliteConnection;

use super::Store;
use super::columns::json_text;
use super::error::StoreError;
use super::intermediate_scans::IntermediateBehind;
use super::node_columns::{node_columns, node_with_scan_of, select_nodes};
use super::query::Query;
use super::records::NodeWithScan;
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
        let scans = ScansOfNodes {
            route,
            ids,
            behind_max,
        };
        self.read(scans).await
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
