//! Writing a route's graph, many rows in a statement: a solve may move a whole map at once, and
//! uploads wait meanwhile.

use sqlx::query_builder::Separated;
use sqlx::{QueryBuilder, Sqlite, SqliteConnection};

use super::body::checksum;
use super::error::StoreError;
use super::members::Members;
use super::records::{ClosureRecord, EdgeChange, EdgeRecord, NodeChange, NodeWithScan};
use super::{archive, row_sums};
use crate::geometry::{Information, Pose2, PoseSigma};
use crate::ids::{BatchId, EdgeId, LidarId, NodeId};

/// Rows of one statement: SQLite binds at most 32,766 values, and an edge and a node have 20.
pub(super) const ROWS_MAX: usize = 256;

type Values<'a, 'b> = Separated<'a, Sqlite, &'b str>;

/// Inserts nodes and their scans.
pub(super) async fn insert_nodes(
    transaction: &mut SqliteConnection,
    route_key: i64,
    members: &Members,
    nodes: &[NodeWithScan],
) -> Result<(), StoreError> {
    for rows in nodes.chunks(ROWS_MAX) {
        let mut query = QueryBuilder::new(
            "INSERT INTO nodes (route_key, node_id, batch_key, stamp_ns, x, y, theta, \
             sigma_x, sigma_y, sigma_theta, odom_x, odom_y, odom_theta, drift_m, reference, \
             active, subgraph_id, trip_order, client_id, checksum) ",
        );
        query.push_values(rows, |mut values, NodeWithScan { node, .. }| {
            values
                .push_bind(route_key)
                .push_bind(node.id.0)
                .push_bind(batch_key(members, &node.batch_id))
                .push_bind(node.stamp.0);
            push_pose(&mut values, &node.pose);
            push_sigma(&mut values, node.sigma);
            push_pose(&mut values, &node.odom_from_base);
            values
                .push_bind(node.drift_m)
                .push_bind(node.reference)
                .push_bind(node.active)
                .push_bind(node.subgraph_id)
                .push_bind(node.trip_order)
                .push_bind(node.client_id.as_deref())
                .push_bind(row_sums::of_node(node));
        });
        query.build().execute(&mut *transaction).await?;
        insert_scans(transaction, route_key, rows).await?;
    }
    Ok(())
}

async fn insert_scans(
    transaction: &mut SqliteConnection,
    route_key: i64,
    nodes: &[NodeWithScan],
) -> Result<(), StoreError> {
    let with_scans = nodes.iter();
    let with_scans = with_scans
        .filter_map(|node| Some((node.node.id, node.scan.as_deref()?, node.lidar.as_ref())));
    let with_scans: Vec<_> = with_scans.collect();
    if with_scans.is_empty() {
        return Ok(());
    }
    let mut query =
        QueryBuilder::new("INSERT INTO node_scans (route_key, node_id, scan, scan_sha256, lidar) ");
    query.push_values(with_scans, |mut values, (node, scan, lidar)| {
        values
            .push_bind(route_key)
            .push_bind(node.0)
            .push_bind(scan)
            .push_bind(checksum(scan).to_vec())
            .push_bind(lidar.map(LidarId::as_str));
    });
    query.build().execute(transaction).await?;
    Ok(())
}

/// Inserts edges and what their closures say.
pub(super) async fn insert_edges(
    transaction: &mut SqliteConnection,
    route_key: i64,
    members: &Members,
    edges: &[EdgeRecord],
) -> Result<(), StoreError> {
    for rows in edges.chunks(ROWS_MAX) {
        let mut query = QueryBuilder::new(
            "INSERT INTO edges (route_key, edge_id, from_node, to_node, kind, status, batch_key, \
             x, y, theta, info_xx, info_xy, info_xt, info_yy, info_yt, info_tt, \
             subgraph_id, delta_f, checksum) ",
        );
        query.push_values(rows, |mut values, edge| {
            values
                .push_bind(route_key)
                .push_bind(edge.id.0)
                .push_bind(edge.from.0)
                .push_bind(edge.to.0)
                .push_bind(edge.kind.name())
                .push_bind(edge.status.name())
                .push_bind(batch_key(members, &edge.batch_id));
            push_pose(&mut values, &edge.measurement);
            push_information(&mut values, &edge.information);
            values
                .push_bind(edge.subgraph_id)
                .push_bind(edge.delta_f)
                .push_bind(row_sums::of_edge(edge));
        });
        query.build().execute(&mut *transaction).await?;
    }
    let closures = edges.iter();
    let closures: Vec<_> = closures
        .filter_map(|edge| Some((edge.id, edge.closure?)))
        .collect();
    insert_closures(transaction, route_key, &closures).await
}

async fn insert_closures(
    transaction: &mut SqliteConnection,
    route_key: i64,
    closures: &[(EdgeId, ClosureRecord)],
) -> Result<(), StoreError> {
    for rows in closures.chunks(ROWS_MAX) {
        let mut query = QueryBuilder::new(
            "INSERT INTO closures (route_key, edge_id, x, y, theta, info_xx, info_xy, info_xt, \
             info_yy, info_yt, info_tt, overlap, inlier_share, rmse_m, all_points_residual) ",
        );
        query.push_values(rows, |mut values, (id, closure)| {
            values.push_bind(route_key).push_bind(id.0);
            push_pose(&mut values, &closure.all_points_measurement);
            push_information(&mut values, &closure.all_points_information);
            values
                .push_bind(closure.overlap)
                .push_bind(closure.inlier_share)
                .push_bind(closure.rmse_m)
                .push_bind(closure.all_points_residual);
        });
        query.build().execute(&mut *transaction).await?;
    }
    Ok(())
}

/// Moves nodes.
///
/// # Errors
/// [`StoreError::InvalidResult`] if one of them is not there.
pub(super) async fn update_nodes(
    transaction: &mut SqliteConnection,
    route_key: i64,
    changes: &[NodeChange],
) -> Result<(), StoreError> {
    let leaving = changes.iter().filter(|change| !change.active);
    let leaving: Vec<NodeId> = leaving.map(|change| change.id).collect();
    archive::add_leaving(transaction, route_key, &leaving).await?;
    for rows in changes.chunks(ROWS_MAX) {
        let mut query = QueryBuilder::new(
            "WITH change(id, x, y, theta, sigma_x, sigma_y, sigma_theta, drift_m, reference, \
             active, block) AS (",
        );
        query.push_values(rows, |mut values, change| {
            values.push_bind(change.id.0);
            push_pose(&mut values, &change.pose);
            push_sigma(&mut values, change.sigma);
            values
                .push_bind(change.drift_m)
                .push_bind(change.reference)
                .push_bind(change.active)
                .push_bind(change.subgraph_id);
        });
        query.push(
            ") UPDATE nodes SET x = change.x, y = change.y, theta = change.theta, \
             sigma_x = change.sigma_x, sigma_y = change.sigma_y, \
             sigma_theta = change.sigma_theta, drift_m = change.drift_m, \
             reference = change.reference, active = change.active, \
             subgraph_id = change.block FROM change \
             WHERE nodes.node_id = change.id AND nodes.route_key = ",
        );
        query.push_bind(route_key);
        let changed = query.build().execute(&mut *transaction).await?;
        check_all_changed("node", changed.rows_affected(), rows.len())?;
    }
    Ok(())
}

/// Brings states and blocks of edges up to date.
///
/// # Errors
/// [`StoreError::InvalidResult`] if one of them is not there.
pub(super) async fn update_edges(
    transaction: &mut SqliteConnection,
    route_key: i64,
    changes: &[EdgeChange],
) -> Result<(), StoreError> {
    for rows in changes.chunks(ROWS_MAX) {
        let mut query = QueryBuilder::new("WITH change(id, status, block) AS (");
        query.push_values(rows, |mut values, change| {
            values
                .push_bind(change.id.0)
                .push_bind(change.status.name())
                .push_bind(change.subgraph_id);
        });
        query.push(
            ") UPDATE edges SET status = change.status, \
             subgraph_id = change.block FROM change \
             WHERE edges.edge_id = change.id AND edges.route_key = ",
        );
        query.push_bind(route_key);
        let changed = query.build().execute(&mut *transaction).await?;
        check_all_changed("edge", changed.rows_affected(), rows.len())?;
    }
    Ok(())
}

fn check_all_changed(what: &str, changed: u64, wanted: usize) -> Result<(), StoreError> {
    if usize::try_from(changed) == Ok(wanted) {
        return Ok(());
    }
    let reason = format!("a {what} that it changes is not there, or is named twice");
    Err(StoreError::InvalidResult(reason))
}

/// `None` (refused by NOT NULL) for a batch that is not of the job; it was checked before.
fn batch_key(members: &Members, id: &BatchId) -> Option<i64> {
    members.get(id).map(|member| member.batch_key)
}

pub(super) fn push_pose(values: &mut Values<'_, '_>, pose: &Pose2) {
    values
        .push_bind(pose.x)
        .push_bind(pose.y)
        .push_bind(pose.theta);
}

fn push_sigma(values: &mut Values<'_, '_>, sigma: Option<PoseSigma>) {
    values
        .push_bind(sigma.map(|sigma| sigma.x_m))
        .push_bind(sigma.map(|sigma| sigma.y_m))
        .push_bind(sigma.map(|sigma| sigma.theta_rad));
}

fn push_information(values: &mut Values<'_, '_>, information: &Information) {
    for value in information.upper() {
        values.push_bind(value);
    }
}
