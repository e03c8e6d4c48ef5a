//! The columns of a node: the text that selects them, and the record that a row makes.

use sqlx::Row;
use sqlx::sqlite::SqliteRow;

use super::columns::{name, optional_name, pose, pose_sigma};
use super::error::{Corruption, StoreError};
use super::records::{NodeRecord, NodeWithScan};
use super::row_sums;
use super::scan_columns::{scan_of, sound_scan};
use crate::ids::{NodeId, RouteId, StampNs};

macro_rules! node_columns {
    () => {
        "nodes.node_id, batches.id AS batch_id, batches.vehicle_id, batches.trip_id, stamp_ns, \
         x, y, theta, sigma_x, sigma_y, sigma_theta, odom_x, odom_y, odom_theta, drift_m, \
         reference, active, subgraph_id, trip_order, client_id, nodes.checksum AS node_checksum "
    };
}

macro_rules! select_nodes {
    ($columns:literal, $joins:expr, $rest:expr) => {
        select_nodes!($columns, "JOIN nodes", $joins, $rest)
    };
    ($columns:literal, $from:literal, $joins:expr, $rest:expr) => {
        concat!(
            "SELECT ",
            node_columns!(),
            $columns,
            " FROM routes ",
            $from,
            " USING (route_key) \
             JOIN batches ON batches.batch_key = nodes.batch_key ",
            $joins,
            " WHERE routes.id = $1 ",
            $rest
        )
    };
}

macro_rules! select_nodes_with_scans {
    ($join:literal, $rest:literal) => {
        select_nodes!(
            ", scan, scan_sha256, lidar",
            "CROSS JOIN nodes INDEXED BY nodes_active",
            concat!(
                $join,
                " node_scans ON node_scans.route_key = nodes.route_key \
                 AND node_scans.node_id = nodes.node_id"
            ),
            $rest
        )
    };
}

pub(super) use {node_columns, select_nodes, select_nodes_with_scans};

/// The node of a row.
///
/// # Errors
/// [`StoreError::Corrupt`] with [`Corruption::Node`] if it has lost its checksum.
pub(super) fn node_of(row: &SqliteRow) -> Result<NodeRecord, StoreError> {
    let node = NodeRecord {
        id: NodeId(row.try_get("node_id")?),
        batch_id: name(row, "batch_id")?,
        vehicle_id: name(row, "vehicle_id")?,
        trip_id: name(row, "trip_id")?,
        stamp: StampNs(row.try_get("stamp_ns")?),
        pose: pose(row, ["x", "y", "theta"])?,
        sigma: pose_sigma(row)?,
        odom_from_base: pose(row, ["odom_x", "odom_y", "odom_theta"])?,
        drift_m: row.try_get("drift_m")?,
        reference: row.try_get("reference")?,
        active: row.try_get("active")?,
        subgraph_id: row.try_get("subgraph_id")?,
        trip_order: row.try_get("trip_order")?,
        client_id: row.try_get("client_id")?,
    };
    let what = Corruption::Node(node.id);
    row_sums::check(row, "node_checksum", row_sums::of_node(&node), what)?;
    Ok(node)
}

/// The node of a row with its scan, which is left out if it has lost its checksum; the scans behind it
/// are other rows.
pub(super) fn node_with_scan_of(
    row: &SqliteRow,
    route: &RouteId,
) -> Result<NodeWithScan, StoreError> {
    let node = node_of(row)?;
    let has_scan = row.try_get::<Option<&[u8]>, _>("scan")?.is_some();
    let scan = has_scan.then(|| scan_of(row, route, node.id));
    let scan = scan.map(sound_scan).transpose()?.flatten();
    Ok(NodeWithScan {
        node,
        scan,
        lidar: optional_name(row, "lidar")?,
        intermediate: Vec::new(),
    })
}
