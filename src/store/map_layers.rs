//! What viewers draw over a map, bounded for routes of any age: the newest trips, the loop closures with the
//! largest residuals, reference keyframes.

use std::collections::BTreeMap;

use sqlx::sqlite::SqliteRow;
use sqlx::{Row, SqliteConnection};

use super::Store;
use super::active_graph::join_active_edges;
use super::columns::{information, name, pose, text};
use super::error::StoreError;
use super::query::Query;
use crate::geometry::{Pose2, Vector2};
use crate::ids::{EdgeId, RouteId, StampNs, TripId, VehicleId};
use crate::model::{BatchStatus, EdgeKind, EdgeStatus};

/// Batches whose nodes are read.
const BATCHES_MAX: u32 = 2_000;
/// Nodes of them that are read.
const NODES_MAX: u32 = 50_000;

/// Where a trip was.
#[derive(Debug, Clone, PartialEq)]
pub struct TripTrack {
    /// Its name.
    pub trip_id: TripId,
    /// Whose it is.
    pub vehicle_id: VehicleId,
    /// Its keyframes in the order of time; at least one.
    pub poses: Vec<(StampNs, Pose2)>,
}

/// A loop closure between active nodes.
#[derive(Debug, Clone, PartialEq)]
pub struct ActiveClosure {
    /// Its edge.
    pub edge_id: EdgeId,
    /// What made it.
    pub kind: EdgeKind,
    /// Where its nodes are, the older one first, map frame, metres.
    pub ends: [Vector2<f64>; 2],
    /// eᵀΩe at the poses of its nodes.
    pub residual: f64,
}

impl Store {
    /// The newest trips of a route, the one with the newest keyframe first; at most `limit` of them, and of
    /// a large route only their newest keyframes.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn newest_tracks(
        &self,
        route: &RouteId,
        limit: usize,
    ) -> Result<Vec<TripTrack>, StoreError> {
        self.read(NewestTracks { route, limit }).await
    }

    /// The loop closures between active nodes with the largest residuals, the largest first.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn worst_closures(
        &self,
        route: &RouteId,
        limit: usize,
    ) -> Result<Vec<ActiveClosure>, StoreError> {
        self.read(WorstClosures { route, limit }).await
    }

    /// Where the active reference keyframes are, map frame, metres, by id.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn reference_positions(
        &self,
        route: &RouteId,
    ) -> Result<Vec<Vector2<f64>>, StoreError> {
        self.read(ReferencePositions(route)).await
    }
}

/// The newest trips, the one with the newest keyframe first.
struct NewestTracks<'a> {
    route: &'a RouteId,
    limit: usize,
}

impl Query for NewestTracks<'_> {
    type Answer = Vec<TripTrack>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let rows = sqlx::query(
            "SELECT newest.trip_id, newest.vehicle_id, stamp_ns, x, y, theta \
             FROM (SELECT batch_key, trip_id, vehicle_id \
                   FROM batches INDEXED BY batches_by_status \
                   WHERE route_key = (SELECT route_key FROM routes WHERE id = $1) AND status = $2 \
                   ORDER BY batch_key DESC LIMIT $3) AS newest \
             CROSS JOIN nodes INDEXED BY nodes_by_batch ON nodes.batch_key = newest.batch_key \
             ORDER BY stamp_ns DESC, node_id DESC LIMIT $4",
        )
        .bind(self.route.as_str())
        .bind(BatchStatus::Merged.name())
        .bind(BATCHES_MAX)
        .bind(NODES_MAX)
        .fetch_all(reader)
        .await?;
        by_trip(&rows, self.limit)
    }
}

/// The tracks of nodes that are sorted by time, the newest first; of the first `limit` trips.
fn by_trip(rows: &[SqliteRow], limit: usize) -> Result<Vec<TripTrack>, StoreError> {
    let mut tracks: Vec<TripTrack> = Vec::new();
    let mut place_of: BTreeMap<TripId, usize> = BTreeMap::new();
    for row in rows {
        let trip_id: TripId = name(row, "trip_id")?;
        let known = place_of.get(&trip_id).copied();
        if known.is_none() && tracks.len() == limit {
            continue;
        }
        let place = known.unwrap_or(tracks.len());
        if known.is_none() {
            place_of.insert(trip_id.clone(), place);
            tracks.push(TripTrack {
                trip_id,
                vehicle_id: name(row, "vehicle_id")?,
                poses: Vec::new(),
            });
        }
        let stamp = StampNs(row.try_get("stamp_ns")?);
        let at = (stamp, pose(row, ["x", "y", "theta"])?);
        tracks[place].poses.push(at);
    }
    tracks.iter_mut().for_each(|track| track.poses.reverse());
    Ok(tracks)
}

/// The closures between active nodes with the largest residuals, the largest first.
struct WorstClosures<'a> {
    route: &'a RouteId,
    limit: usize,
}

impl Query for WorstClosures<'_> {
    type Answer = Vec<ActiveClosure>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let rows = sqlx::query(concat!(
            "SELECT edges.edge_id, edges.kind, edges.x, edges.y, edges.theta, info_xx, info_xy, \
             info_xt, info_yy, info_yt, info_tt, \
             older.x AS a_x, older.y AS a_y, older.theta AS a_theta, \
             newer.x AS b_x, newer.y AS b_y, newer.theta AS b_theta FROM routes ",
            join_active_edges!(),
            " WHERE routes.id = $1 AND edges.status = $2 AND edges.kind = $3"
        ))
        .bind(self.route.as_str())
        .bind(EdgeStatus::Active.name())
        .bind(EdgeKind::LoopClosure.name())
        .fetch_all(reader)
        .await?;
        let closures = rows.iter().map(closure_of);
        let mut closures = closures.collect::<Result<Vec<_>, _>>()?;
        closures.sort_by(|a, b| {
            let by_residual = b.residual.total_cmp(&a.residual);
            by_residual.then(a.edge_id.cmp(&b.edge_id))
        });
        closures.truncate(self.limit);
        Ok(closures)
    }
}

fn closure_of(row: &SqliteRow) -> Result<ActiveClosure, StoreError> {
    let columns = [
        "info_xx", "info_xy", "info_xt", "info_yy", "info_yt", "info_tt",
    ];
    let from = pose(row, ["a_x", "a_y", "a_theta"])?;
    let to = pose(row, ["b_x", "b_y", "b_theta"])?;
    let error = Pose2::edge_error(&from, &to, &pose(row, ["x", "y", "theta"])?);
    Ok(ActiveClosure {
        edge_id: EdgeId(row.try_get("edge_id")?),
        kind: text(row, "kind")?,
        ends: [from, to].map(|pose| Vector2::new(pose.x, pose.y)),
        residual: information(row, columns)?.squared_norm(&error),
    })
}

/// The positions of the active reference keyframes, by id.
struct ReferencePositions<'a>(&'a RouteId);

impl Query for ReferencePositions<'_> {
    type Answer = Vec<Vector2<f64>>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let positions: Vec<(f64, f64)> = sqlx::query_as(
            "SELECT x, y FROM routes CROSS JOIN nodes INDEXED BY nodes_active USING (route_key) \
             WHERE routes.id = $1 AND active = 1 AND reference = 1 ORDER BY node_id",
        )
        .bind(self.0.as_str())
        .fetch_all(reader)
        .await?;
        let positions = positions.into_iter();
        Ok(positions.map(|(x, y)| Vector2::new(x, y)).collect())
    }
}
