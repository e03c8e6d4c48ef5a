//! Scans between keyframes: written with the result that brings them, read with their keyframes.

use std::collections::BTreeMap;

use sqlx::sqlite::SqliteRow;
use sqlx::{QueryBuilder, Row, SqliteConnection};

use super::Store;
use super::body::checksum;
use super::columns::{corrupt, json_text, optional_name, pose};
use super::error::StoreError;
use super::graph_rows::{ROWS_MAX, push_pose};
use super::query::Query;
use super::records::{IntermediateRecord, NewIntermediate, TrajectoryPose};
use super::scan_columns::{scan_of, sound_scan};
use crate::ids::{LidarId, NodeId, RouteId, StampNs, TripId};

impl Store {
    /// Where a trip was at each of its scans, keyframes and those between them, active or not, in
    /// the order of time: for tests. The service exports trajectories.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn trajectory(
        &self,
        route: &RouteId,
        trip: &TripId,
    ) -> Result<Vec<TrajectoryPose>, StoreError> {
        self.read(Trajectory { route, trip }).await
    }
}

/// Inserts scans between keyframes; their keyframes are there already.
///
/// # Errors
/// [`StoreError::InvalidResult`] if they do not go on where those of their keyframe ended.
pub(super) async fn insert_intermediate(
    transaction: &mut SqliteConnection,
    route_key: i64,
    new: &[NewIntermediate],
) -> Result<(), StoreError> {
    for rows in new.chunks(ROWS_MAX) {
        let mut query = QueryBuilder::new(
            "INSERT INTO intermediate_scans (route_key, node_id, place, stamp_ns, x, y, theta, \
             odom_x, odom_y, odom_theta, companion, lends, scan_sha256, scan) ",
        );
        query.push_values(rows, |mut values, new| {
            let scan = &new.scan;
            values
                .push_bind(route_key)
                .push_bind(new.node_id.0)
                .push_bind(new.place)
                .push_bind(scan.stamp.0);
            push_pose(&mut values, &scan.keyframe_from_base);
            push_pose(&mut values, &scan.odom_from_base);
            values
                .push_bind(scan.companion.as_ref().map(LidarId::as_str))
                .push_bind(scan.lends)
                .push_bind(scan.scan.as_deref().map(|scan| checksum(scan).to_vec()))
                .push_bind(scan.scan.as_deref());
        });
        query.build().execute(&mut *transaction).await?;
    }
    check_places(transaction, route_key, new).await
}

async fn check_places(
    transaction: &mut SqliteConnection,
    route_key: i64,
    new: &[NewIntermediate],
) -> Result<(), StoreError> {
    let mut nodes: Vec<i64> = new.iter().map(|new| new.node_id.0).collect();
    nodes.dedup();
    if nodes.is_empty() {
        return Ok(());
    }
    let gap: Option<i64> = sqlx::query_scalar(
        "SELECT node_id FROM intermediate_scans WHERE route_key = $1 \
         AND node_id IN (SELECT value FROM json_each($2)) \
         GROUP BY node_id HAVING max(place) <> count(*) - 1 LIMIT 1",
    )
    .bind(route_key)
    .bind(json_text(&nodes)?)
    .fetch_optional(transaction)
    .await?;
    match gap {
        None => Ok(()),
        Some(node) => {
            let reason = format!("its scans behind node {node} leave a place out");
            Err(StoreError::InvalidResult(reason))
        }
    }
}

/// Those of the active nodes of a route, in order, by node.
pub(super) struct ActiveIntermediate<'a>(pub(super) &'a RouteId);

impl Query for ActiveIntermediate<'_> {
    type Answer = BTreeMap<NodeId, Vec<IntermediateRecord>>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        // CROSS JOIN: the active nodes first, however many have left.
        let rows = sqlx::query(
            "SELECT intermediate.node_id, place, intermediate.stamp_ns, intermediate.x, \
                 intermediate.y, intermediate.theta, intermediate.odom_x, intermediate.odom_y, \
                 intermediate.odom_theta, companion, lends, scan_sha256, scan \
             FROM routes CROSS JOIN nodes INDEXED BY nodes_active \
                 ON nodes.route_key = routes.route_key AND nodes.active = 1 \
             CROSS JOIN intermediate_scans AS intermediate \
                 ON intermediate.route_key = nodes.route_key \
                 AND intermediate.node_id = nodes.node_id \
             WHERE routes.id = $1 ORDER BY intermediate.node_id, place",
        )
        .bind(self.0.as_str())
        .fetch_all(reader)
        .await?;
        by_node(&rows, self.0)
    }
}

/// Those of some nodes, in order, by node: of each the first `behind_max`.
pub(super) struct IntermediateBehind<'a> {
    pub(super) route: &'a RouteId,
    pub(super) nodes: &'a [NodeId],
    pub(super) behind_max: u32,
}

impl Query for IntermediateBehind<'_> {
    type Answer = BTreeMap<NodeId, Vec<IntermediateRecord>>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let rows = sqlx::query(
            "SELECT node_id, place, stamp_ns, x, y, theta, odom_x, odom_y, odom_theta, \
             companion, lends, scan_sha256, scan \
         FROM routes JOIN intermediate_scans USING (route_key) \
         WHERE routes.id = $1 AND node_id IN (SELECT value FROM json_each($2)) AND place < $3 \
         ORDER BY node_id, place",
        )
        .bind(self.route.as_str())
        .bind(json_text(self.nodes)?)
        .bind(self.behind_max)
        .fetch_all(reader)
        .await?;
        by_node(&rows, self.route)
    }
}

fn by_node(
    rows: &[SqliteRow],
    route: &RouteId,
) -> Result<BTreeMap<NodeId, Vec<IntermediateRecord>>, StoreError> {
    let mut by_node: BTreeMap<NodeId, Vec<IntermediateRecord>> = BTreeMap::new();
    for row in rows {
        let node = NodeId(row.try_get("node_id")?);
        let of_node = by_node.entry(node).or_default();
        let place: usize = row.try_get::<u32, _>("place")? as usize;
        if place != of_node.len() {
            return Err(corrupt("place"));
        }
        of_node.push(intermediate_of(row, route, node)?);
    }
    Ok(by_node)
}

fn intermediate_of(
    row: &SqliteRow,
    route: &RouteId,
    node: NodeId,
) -> Result<IntermediateRecord, StoreError> {
    let has_scan = row.try_get::<Option<&[u8]>, _>("scan")?.is_some();
    let scan = has_scan.then(|| scan_of(row, route, node));
    Ok(IntermediateRecord {
        stamp: StampNs(row.try_get("stamp_ns")?),
        keyframe_from_base: pose(row, ["x", "y", "theta"])?,
        odom_from_base: pose(row, ["odom_x", "odom_y", "odom_theta"])?,
        companion: optional_name(row, "companion")?,
        lends: row.try_get("lends")?,
        scan: scan.map(sound_scan).transpose()?.flatten(),
    })
}

/// Whether the scans behind a node have their checksums: [`StoreError::Corrupt`] if one has not.
pub(super) struct CheckBehind<'a> {
    pub(super) route: &'a RouteId,
    pub(super) node: NodeId,
}

impl Query for CheckBehind<'_> {
    type Answer = ();

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let rows = sqlx::query(
            "SELECT scan_sha256, scan FROM routes JOIN intermediate_scans USING (route_key) \
             WHERE routes.id = $1 AND node_id = $2 AND scan IS NOT NULL",
        )
        .bind(self.route.as_str())
        .bind(self.node.0)
        .fetch_all(reader)
        .await?;
        let mut rows = rows.iter();
        rows.try_for_each(|row| scan_of(row, self.route, self.node).map(drop))
    }
}

/// Where a trip was at each of its scans, keyframes and those between them, in the order of time.
struct Trajectory<'a> {
    route: &'a RouteId,
    trip: &'a TripId,
}

impl Query for Trajectory<'_> {
    type Answer = Vec<TrajectoryPose>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        // One statement, so that no solve comes between a keyframe and the scans that move with it.
        let rows = sqlx::query(
            "SELECT nodes.node_id, nodes.stamp_ns, nodes.x, nodes.y, nodes.theta, place, \
                 between_keyframes.stamp_ns AS b_stamp_ns, between_keyframes.x AS b_x, \
                 between_keyframes.y AS b_y, between_keyframes.theta AS b_theta \
             FROM routes JOIN batches USING (route_key) \
             CROSS JOIN nodes ON nodes.batch_key = batches.batch_key \
             LEFT JOIN intermediate_scans AS between_keyframes \
                 ON between_keyframes.route_key = nodes.route_key \
                 AND between_keyframes.node_id = nodes.node_id \
             WHERE routes.id = $1 AND batches.trip_id = $2 ORDER BY nodes.node_id, place",
        )
        .bind(self.route.as_str())
        .bind(self.trip.as_str())
        .fetch_all(reader)
        .await?;
        trajectory_of(&rows)
    }
}

/// The poses of rows: each keyframe comes once with each scan behind it, or once alone.
fn trajectory_of(rows: &[SqliteRow]) -> Result<Vec<TrajectoryPose>, StoreError> {
    let mut poses: Vec<TrajectoryPose> = Vec::with_capacity(rows.len());
    for row in rows {
        let node_id = NodeId(row.try_get("node_id")?);
        let map_from_keyframe = pose(row, ["x", "y", "theta"])?;
        if poses.last().is_none_or(|last| last.node_id != node_id) {
            poses.push(TrajectoryPose {
                node_id,
                is_keyframe: true,
                stamp: StampNs(row.try_get("stamp_ns")?),
                pose: map_from_keyframe,
            });
        }
        let stamp: Option<i64> = row.try_get("b_stamp_ns")?;
        if let Some(stamp) = stamp {
            let keyframe_from_base = pose(row, ["b_x", "b_y", "b_theta"])?;
            poses.push(TrajectoryPose {
                node_id,
                is_keyframe: false,
                stamp: StampNs(stamp),
                pose: map_from_keyframe.compose(&keyframe_from_base),
            });
        }
    }
    // A stable sort: what shares a stamp stays in the order of the trip.
    poses.sort_by_key(|pose| pose.stamp);
    Ok(poses)
}
