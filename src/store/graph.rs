//! Reading a route's graph.

use sqlx::sqlite::SqliteRow;
use sqlx::{Connection, Row, SqliteConnection, SqlitePool};

use super::acceptances;
use super::alerts::RouteAlerts;
use super::body::checksum;
use super::clock_faults::clock_faults;
use super::columns::{information, json_text, name, optional_name, pose, pose_sigma, text};
use super::error::{Corruption, StoreError};
use super::intermediate_scans::active_intermediate;
use super::query::Query;
use super::records::{ClosureRecord, EdgeFilter, EdgeRecord, NodeRecord, NodeWithScan, RouteGraph};
use super::routes::settings_of;
use super::{Store, named, of_snapshot, row_sums, series_closures, settled, vehicles};
use crate::geometry::Pose2;
use crate::graph::{EdgeKind, EdgeStatus};
use crate::ids::{EdgeId, NodeId, RouteId, StampNs, TripId};

impl Store {
    /// A route's active graph, read at one instant. A scan that has lost its checksum is left out.
    ///
    /// # Errors
    /// [`StoreError::Corrupt`] if a node or an edge has.
    pub async fn load_graph(&self, route: &RouteId) -> Result<Option<RouteGraph>, StoreError> {
        let mut reader = self.reader().await?;
        let graph = load_snapshot(&mut reader, route).await;
        of_snapshot(reader, graph)
    }

    /// Every node, by id.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn nodes(&self, route: &RouteId) -> Result<Vec<NodeRecord>, StoreError> {
        named(nodes(&self.shared.readers, route).await)
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
        named(node_page(&self.shared.readers, route, after, limit).await)
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
        named(nodes_named(&self.shared.readers, route, ids).await)
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
        named(node(&self.shared.readers, route, id).await)
    }

    /// Every active node with its scan and those behind it, by id: what a map picture is drawn
    /// from. A scan that has lost its checksum is left out.
    ///
    /// # Errors
    /// [`StoreError::Corrupt`] if a node has.
    pub async fn nodes_with_scans(&self, route: &RouteId) -> Result<Vec<NodeWithScan>, StoreError> {
        named(nodes_with_scans(&self.shared.readers, route).await)
    }

    /// The scan of a node: the bytes of [`crate::scan::encode_scan`].
    ///
    /// # Errors
    /// [`StoreError::Corrupt`] with [`Corruption::Scan`] if it has lost its checksum.
    pub async fn node_scan(
        &self,
        route: &RouteId,
        id: NodeId,
    ) -> Result<Option<Vec<u8>>, StoreError> {
        named(node_scan(&self.shared.readers, route, id).await)
    }

    /// The nodes of a trip, active or not, in the order of their scans.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn trip_nodes(
        &self,
        route: &RouteId,
        trip: &TripId,
    ) -> Result<Vec<NodeRecord>, StoreError> {
        named(trip_nodes(&self.shared.readers, route, trip).await)
    }

    /// Every edge, by id.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn edges(&self, route: &RouteId) -> Result<Vec<EdgeRecord>, StoreError> {
        named(edges(&self.shared.readers, route).await)
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
        named(edge_page(&self.shared.readers, route, filter, after, limit).await)
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
        named(edges_named(&self.shared.readers, route, ids).await)
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
        named(edge(&self.shared.readers, route, id).await)
    }
}

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

pub(super) use {node_columns, select_nodes};

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

/// A route's graph, read at one instant.
async fn load_snapshot(
    reader: &mut SqliteConnection,
    route: &RouteId,
) -> Result<Option<RouteGraph>, StoreError> {
    let mut snapshot = reader.begin().await?;
    let row = sqlx::query(
        "SELECT revision, stage, detector, false_alarm_rate, hold_s, max_shift_m, next_node_id, next_edge_id, \
         map_version FROM routes WHERE id = $1",
    )
    .bind(route.as_str())
    .fetch_optional(&mut *snapshot)
    .await?;
    let Some(row) = row else { return Ok(None) };
    let nodes = sqlx::query(select_nodes_with_scans!(
        "LEFT JOIN",
        "AND nodes.active = 1 ORDER BY nodes.node_id"
    ))
    .bind(route.as_str())
    .fetch_all(&mut *snapshot)
    .await?;
    let mut intermediate = active_intermediate(&mut snapshot, route).await?;
    let edges = settled::active_edges(&mut snapshot, route).await?;
    let settled_closures = series_closures::first_archived(&mut snapshot, route).await?;
    let alerts = RouteAlerts(route).answer(&mut snapshot).await?;
    let accepted = acceptances::accepted_changes(&mut snapshot, route).await?;
    let calibrations = vehicles::route_calibrations(&mut snapshot, route).await?;
    let clock_faults = clock_faults(&mut snapshot, route).await?;
    snapshot.commit().await?;
    let with_scans = |row: &SqliteRow| {
        let mut node = node_with_scan_of(row, route)?;
        node.intermediate = intermediate.remove(&node.node.id).unwrap_or_default();
        Ok::<_, StoreError>(node)
    };
    Ok(Some(RouteGraph {
        revision: row.try_get("revision")?,
        stage: text(&row, "stage")?,
        settings: settings_of(&row)?,
        next_node_id: NodeId(row.try_get("next_node_id")?),
        next_edge_id: EdgeId(row.try_get("next_edge_id")?),
        nodes: nodes.iter().map(with_scans).collect::<Result<_, _>>()?,
        edges,
        settled_closures: settled_closures.into_iter().map(Into::into).collect(),
        map_version: row.try_get("map_version")?,
        alerts,
        accepted,
        calibrations,
        clock_faults,
    }))
}

/// Every node of a route, by id.
pub(super) async fn nodes(
    readers: &SqlitePool,
    route: &RouteId,
) -> Result<Vec<NodeRecord>, StoreError> {
    let rows = sqlx::query(select_nodes!("", "", "ORDER BY nodes.node_id"))
        .bind(route.as_str())
        .fetch_all(readers)
        .await?;
    rows.iter().map(node_of).collect()
}

/// Nodes by id, after `after`.
pub(super) async fn node_page(
    readers: &SqlitePool,
    route: &RouteId,
    after: Option<NodeId>,
    limit: u32,
) -> Result<Vec<NodeRecord>, StoreError> {
    let rows = sqlx::query(select_nodes!(
        "",
        "",
        "AND nodes.node_id > $2 ORDER BY nodes.node_id LIMIT $3"
    ))
    .bind(route.as_str())
    .bind(after.map_or(-1, |id| id.0))
    .bind(limit)
    .fetch_all(readers)
    .await?;
    rows.iter().map(node_of).collect()
}

/// Those of some nodes that are there, by id.
pub(super) async fn nodes_named(
    readers: &SqlitePool,
    route: &RouteId,
    ids: &[NodeId],
) -> Result<Vec<NodeRecord>, StoreError> {
    let rows = sqlx::query(select_nodes!(
        "",
        "",
        "AND nodes.node_id IN (SELECT value FROM json_each($2)) ORDER BY nodes.node_id"
    ))
    .bind(route.as_str())
    .bind(json_text(ids)?)
    .fetch_all(readers)
    .await?;
    rows.iter().map(node_of).collect()
}

/// One node.
pub(super) async fn node(
    readers: &SqlitePool,
    route: &RouteId,
    id: NodeId,
) -> Result<Option<NodeRecord>, StoreError> {
    let row = sqlx::query(select_nodes!("", "", "AND nodes.node_id = $2"))
        .bind(route.as_str())
        .bind(id.0)
        .fetch_optional(readers)
        .await?;
    row.as_ref().map(node_of).transpose()
}

/// The nodes of a trip, in the order of their scans.
pub(super) async fn trip_nodes(
    readers: &SqlitePool,
    route: &RouteId,
    trip: &TripId,
) -> Result<Vec<NodeRecord>, StoreError> {
    // CROSS JOIN keeps SQLite from walking through all nodes of the route.
    let rows = sqlx::query(concat!(
        "SELECT ",
        node_columns!(),
        "FROM routes JOIN batches USING (route_key) \
         CROSS JOIN nodes ON nodes.batch_key = batches.batch_key \
         WHERE routes.id = $1 AND batches.trip_id = $2 ORDER BY stamp_ns, nodes.node_id"
    ))
    .bind(route.as_str())
    .bind(trip.as_str())
    .fetch_all(readers)
    .await?;
    rows.iter().map(node_of).collect()
}

/// Every active node that has a scan, with it and those behind it, by id.
pub(super) async fn nodes_with_scans(
    readers: &SqlitePool,
    route: &RouteId,
) -> Result<Vec<NodeWithScan>, StoreError> {
    // One snapshot: a node and the scans behind it come together.
    let mut snapshot = readers.begin().await?;
    let rows = sqlx::query(select_nodes_with_scans!(
        "JOIN",
        "AND nodes.active = 1 ORDER BY nodes.node_id"
    ))
    .bind(route.as_str())
    .fetch_all(&mut *snapshot)
    .await?;
    let mut intermediate = active_intermediate(&mut snapshot, route).await?;
    snapshot.commit().await?;
    let with_scans = |row: &SqliteRow| {
        let mut node = node_with_scan_of(row, route)?;
        node.intermediate = intermediate.remove(&node.node.id).unwrap_or_default();
        Ok(node)
    };
    rows.iter().map(with_scans).collect()
}

/// The scan of a node.
pub(super) async fn node_scan(
    readers: &SqlitePool,
    route: &RouteId,
    id: NodeId,
) -> Result<Option<Vec<u8>>, StoreError> {
    let row = sqlx::query(
        "SELECT scan, scan_sha256 FROM routes JOIN node_scans USING (route_key) \
         WHERE routes.id = $1 AND node_id = $2",
    )
    .bind(route.as_str())
    .bind(id.0)
    .fetch_optional(readers)
    .await?;
    row.map(|row| scan_of(&row, route, id)).transpose()
}

/// Every edge of a route, by id.
pub(super) async fn edges(
    readers: &SqlitePool,
    route: &RouteId,
) -> Result<Vec<EdgeRecord>, StoreError> {
    let rows = sqlx::query(select_edges!("ORDER BY edges.edge_id"))
        .bind(route.as_str())
        .fetch_all(readers)
        .await?;
    rows.iter().map(edge_of).collect()
}

/// Edges by id, after `after`.
pub(super) async fn edge_page(
    readers: &SqlitePool,
    route: &RouteId,
    filter: EdgeFilter,
    after: Option<EdgeId>,
    limit: u32,
) -> Result<Vec<EdgeRecord>, StoreError> {
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
        .bind(route.as_str())
        .bind(after.map_or(-1, |id| id.0))
        .bind(filter.kind.map(EdgeKind::name))
        .bind(filter.status.map(EdgeStatus::name))
        .bind(limit)
        .fetch_all(readers)
        .await?;
    rows.iter().map(edge_of).collect()
}

/// Those of some edges that are there, by id.
pub(super) async fn edges_named(
    readers: &SqlitePool,
    route: &RouteId,
    ids: &[EdgeId],
) -> Result<Vec<EdgeRecord>, StoreError> {
    let rows = sqlx::query(select_edges!(
        "CROSS JOIN edges USING (route_key)",
        "AND edges.edge_id IN (SELECT value FROM json_each($2)) ORDER BY edges.edge_id"
    ))
    .bind(route.as_str())
    .bind(json_text(ids)?)
    .fetch_all(readers)
    .await?;
    rows.iter().map(edge_of).collect()
}

/// One edge.
pub(super) async fn edge(
    readers: &SqlitePool,
    route: &RouteId,
    id: EdgeId,
) -> Result<Option<EdgeRecord>, StoreError> {
    let row = sqlx::query(select_edges!("AND edges.edge_id = $2"))
        .bind(route.as_str())
        .bind(id.0)
        .fetch_optional(readers)
        .await?;
    row.as_ref().map(edge_of).transpose()
}

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

pub(super) fn scan_of(
    row: &SqliteRow,
    route: &RouteId,
    node_id: NodeId,
) -> Result<Vec<u8>, StoreError> {
    let scan: Vec<u8> = row.try_get("scan")?;
    let sha256: &[u8] = row.try_get("scan_sha256")?;
    if checksum(&scan) == *sha256 {
        return Ok(scan);
    }
    let route_id = route.clone();
    Err(StoreError::Corrupt(Corruption::Scan { route_id, node_id }))
}

/// The scan for a map, which goes on without one that is corrupt.
pub(super) fn sound_scan(scan: Result<Vec<u8>, StoreError>) -> Result<Option<Vec<u8>>, StoreError> {
    match scan {
        Ok(scan) => Ok(Some(scan)),
        Err(StoreError::Corrupt(what)) => {
            tracing::error!(%what, "is corrupt on the disk: the map goes on without it");
            metrics::counter!("mapshift_corrupt_scans_total").increment(1);
            Ok(None)
        }
        Err(error) => Err(error),
    }
}

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
