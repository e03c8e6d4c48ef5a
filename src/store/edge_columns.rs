//! The columns of an edge: the text that selects them, and the record that a row makes.

use sqlx::Row;
use sqlx::sqlite::SqliteRow;

use super::columns::{information, name, pose, text};
use super::error::{Corruption, StoreError};
use super::records::{ClosureRecord, EdgeRecord};
use super::row_sums;
use crate::geometry::Pose2;
use crate::ids::{EdgeId, NodeId};

/// Edges with the closures that made them and the poses of their nodes.
macro_rules! select_edges {
    ($from:expr, $rest:expr) => {
        select_edges!($from, $rest, "routes.id = $1")
    };
    ($from:expr, $rest:expr, $which:literal) => {
        concat!(
            "SELECT edges.edge_id, from_node, to_node, edges.kind, edges.status, \
             batches.id AS batch_id, edges.x, edges.y, edges.theta, edges.info_xx, \
             edges.info_xy, edges.info_xt, edges.info_yy, edges.info_yt, edges.info_tt, \
             edges.subgraph_id, edges.delta_f, edges.checksum AS edge_checksum, \
             a.x AS a_x, a.y AS a_y, a.theta AS a_theta, \
             b.x AS b_x, b.y AS b_y, b.theta AS b_theta, closures.x AS all_x, closures.y AS all_y, \
             closures.theta AS all_theta, closures.info_xx AS all_xx, \
             closures.info_xy AS all_xy, closures.info_xt AS all_xt, \
             closures.info_yy AS all_yy, closures.info_yt AS all_yt, \
             closures.info_tt AS all_tt, overlap, inlier_share, rmse_m, all_points_residual \
             FROM routes ",
            $from,
            " JOIN batches ON batches.batch_key = edges.batch_key \
             LEFT JOIN closures ON closures.route_key = edges.route_key \
                 AND closures.edge_id = edges.edge_id \
             LEFT JOIN nodes AS a ON a.route_key = edges.route_key AND a.node_id = from_node \
             LEFT JOIN nodes AS b ON b.route_key = edges.route_key AND b.node_id = to_node \
             WHERE ",
            $which,
            " ",
            $rest
        )
    };
    ($rest:literal) => {
        select_edges!("JOIN edges USING (route_key)", $rest)
    };
}

pub(super) use select_edges;

/// The edge of a row, with its residual at the poses of its nodes.
///
/// # Errors
/// [`StoreError::Corrupt`] with [`Corruption::Edge`] if it has lost its checksum.
pub(super) fn edge_of(row: &SqliteRow) -> Result<EdgeRecord, StoreError> {
    let columns = [
        "info_xx", "info_xy", "info_xt", "info_yy", "info_yt", "info_tt",
    ];
    let mut edge = EdgeRecord {
        id: EdgeId(row.try_get("edge_id")?),
        from: NodeId(row.try_get("from_node")?),
        to: NodeId(row.try_get("to_node")?),
        kind: text(row, "kind")?,
        status: text(row, "status")?,
        batch_id: name(row, "batch_id")?,
        measurement: pose(row, ["x", "y", "theta"])?,
        information: information(row, columns)?,
        residual: 0.0,
        subgraph_id: row.try_get("subgraph_id")?,
        delta_f: row.try_get("delta_f")?,
        closure: closure_of(row)?,
    };
    let what = Corruption::Edge(edge.id);
    row_sums::check(row, "edge_checksum", row_sums::of_edge(&edge), what)?;
    // Only then: a wrong end has no pose.
    let from_pose = pose(row, ["a_x", "a_y", "a_theta"])?;
    let to_pose = pose(row, ["b_x", "b_y", "b_theta"])?;
    let error = Pose2::edge_error(&from_pose, &to_pose, &edge.measurement);
    edge.residual = edge.information.squared_norm(&error);
    Ok(edge)
}

fn closure_of(row: &SqliteRow) -> Result<Option<ClosureRecord>, StoreError> {
    let Some(overlap) = row.try_get("overlap")? else {
        return Ok(None);
    };
    let columns = ["all_xx", "all_xy", "all_xt", "all_yy", "all_yt", "all_tt"];
    Ok(Some(ClosureRecord {
        all_points_measurement: pose(row, ["all_x", "all_y", "all_theta"])?,
        all_points_information: information(row, columns)?,
        overlap,
        inlier_share: row.try_get("inlier_share")?,
        rmse_m: row.try_get("rmse_m")?,
        all_points_residual: row.try_get("all_points_residual")?,
    }))
}
