//! Reads as long as a route: sent piece by piece, each when the one before it was taken.
//!
//! Each has a connection and a snapshot of its own: what it sends belongs together however long it
//! takes, and the connections for short reads stay free. It is not a [`Query`](super::query::Query),
//! whose answer comes as a whole. While a snapshot is held the write-ahead log cannot be truncated,
//! so an export is ended if its pieces are not taken in time.

use std::time::Duration;

use futures::{Stream, StreamExt};
use sqlx::sqlite::SqliteRow;
use sqlx::{Connection, Row, SqliteConnection};
use tokio::sync::mpsc;

use super::Store;
use super::columns::pose;
use super::edge_columns::{edge_of, select_edges};
use super::error::StoreError;
use super::node_columns::{node_columns, node_of, select_nodes};
use super::records::{EdgeRecord, NodeRecord, TrajectoryPose};
use crate::ids::{NodeId, RouteId, StampNs, TripId};

/// Rows that are sent together.
const ROWS_AT_ONCE: usize = 256;
/// Pieces that wait to be taken.
const WAITING_MAX: usize = 2;
/// How long a piece may wait to be taken, and how long all of them may take.
const STALL_MAX: Duration = Duration::from_secs(15);
const TOTAL_MAX: Duration = Duration::from_secs(600);

/// A piece of a route's graph: all nodes come before the first edge.
#[derive(Debug)]
pub enum GraphPart {
    /// By id.
    Nodes(Vec<NodeRecord>),
    /// By id.
    Edges(Vec<EdgeRecord>),
}

/// What of a graph to send: nodes within a rectangle, and the edges with both ends in it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Within {
    /// Lowest and highest x, map frame, metres.
    pub x: [f64; 2],
    /// Lowest and highest y, map frame, metres.
    pub y: [f64; 2],
}

/// Pieces as they are read.
#[derive(Debug)]
pub struct Pieces<T> {
    /// `None` stands for the end, so that what was cut off is not taken for complete.
    receiver: mpsc::Receiver<Result<Option<T>, StoreError>>,
}

impl<T> Pieces<T> {
    /// The next piece; `None` after the last.
    ///
    /// # Errors
    /// [`StoreError`] if the rest cannot be read, [`StoreError::Unavailable`] if the pieces before
    /// it were not taken in time. Nothing comes after an error.
    pub async fn next(&mut self) -> Result<Option<T>, StoreError> {
        let piece = self.receiver.recv().await;
        piece.unwrap_or(Err(StoreError::Unavailable))
    }
}

impl Store {
    /// A route's graph as it stands now, piece by piece: all of it, or what lies within a
    /// rectangle. Nothing comes of a route that is not there.
    ///
    /// # Errors
    /// [`StoreError`] if no connection can be opened; later ones come as a piece.
    /// [`StoreError::Unavailable`] comes where pieces are not taken in time.
    pub async fn export_graph(
        &self,
        route: &RouteId,
        within: Option<Within>,
    ) -> Result<Pieces<GraphPart>, StoreError> {
        let connection = self.shared.database.open_reader().await;
        let connection = connection.map_err(StoreError::named)?;
        let route = route.clone();
        Ok(send_pieces(|sender| {
            send_graph(connection, route, within, sender)
        }))
    }

    /// Where a trip was at each of its keyframes, or at each of its scans, active or not, in the
    /// order of time, piece by piece.
    ///
    /// # Errors
    /// As [`Store::export_graph`].
    pub async fn export_trajectory(
        &self,
        route: &RouteId,
        trip: &TripId,
        all_scans: bool,
    ) -> Result<Pieces<Vec<TrajectoryPose>>, StoreError> {
        let connection = self.shared.database.open_reader().await;
        let connection = connection.map_err(StoreError::named)?;
        let (route, trip) = (route.clone(), trip.clone());
        Ok(send_pieces(|sender| {
            send_trajectory(connection, route, trip, all_scans, sender)
        }))
    }
}

/// Where pieces go.
struct Sender<T>(mpsc::Sender<Result<Option<T>, StoreError>>);

impl<T> Sender<T> {
    /// Waits until there is room for the piece.
    ///
    /// # Errors
    /// [`StoreError::Unavailable`] if nobody takes those before it.
    async fn send(&self, piece: T) -> Result<(), StoreError> {
        self.put(Ok(Some(piece))).await
    }

    async fn put(&self, piece: Result<Option<T>, StoreError>) -> Result<(), StoreError> {
        let sent = tokio::time::timeout(STALL_MAX, self.0.send(piece)).await;
        match sent {
            Ok(Ok(())) => Ok(()),
            Ok(Err(_)) | Err(_) => Err(StoreError::Unavailable),
        }
    }
}

/// Reads in a task of its own, until it is done or nobody takes what is read.
fn send_pieces<T, R>(read: impl FnOnce(Sender<T>) -> R) -> Pieces<T>
where
    T: Send + 'static,
    R: Future<Output = Result<(), StoreError>> + Send + 'static,
{
    let (sender, receiver) = mpsc::channel(WAITING_MAX);
    let last_word = Sender(sender.clone());
    let reading = read(Sender(sender));
    tokio::spawn(async move {
        let read = tokio::time::timeout(TOTAL_MAX, reading).await;
        let read = read.unwrap_or(Err(StoreError::Unavailable));
        // Whoever asked may have gone.
        let _ = last_word
            .put(read.map(|()| None).map_err(StoreError::named))
            .await;
    });
    Pieces { receiver }
}

macro_rules! within {
    ($table:literal) => {
        concat!(
            $table,
            ".x BETWEEN $2 AND $3 AND ",
            $table,
            ".y BETWEEN $4 AND $5 "
        )
    };
}

async fn send_graph(
    mut connection: SqliteConnection,
    route: RouteId,
    within: Option<Within>,
    sender: Sender<GraphPart>,
) -> Result<(), StoreError> {
    let mut snapshot = connection.begin().await?;
    let (nodes, edges) = match within {
        None => (
            select_nodes!("", "", "ORDER BY nodes.node_id"),
            select_edges!(
                "CROSS JOIN edges USING (route_key)",
                "ORDER BY edges.edge_id"
            ),
        ),
        Some(_) => (
            select_nodes!(
                "",
                "",
                concat!("AND ", within!("nodes"), "ORDER BY nodes.node_id")
            ),
            select_edges!(
                "CROSS JOIN nodes AS inside USING (route_key) CROSS JOIN edges \
                 INDEXED BY edges_by_from ON edges.route_key = inside.route_key \
                 AND edges.from_node = inside.node_id",
                concat!(
                    "AND ",
                    within!("inside"),
                    "AND ",
                    within!("b"),
                    "ORDER BY edges.edge_id"
                )
            ),
        ),
    };
    let bounds = within.map(|Within { x, y }| [x[0], x[1], y[0], y[1]]);
    let bound = |statement| {
        let query = sqlx::query(statement).bind(route.as_str());
        bounds
            .into_iter()
            .flatten()
            .fold(query, |query, bound| query.bind(bound))
    };
    let rows = bound(nodes).fetch(&mut *snapshot);
    send_rows(rows, node_of, |nodes| sender.send(GraphPart::Nodes(nodes))).await?;
    let rows = bound(edges).fetch(&mut *snapshot);
    send_rows(rows, edge_of, |edges| sender.send(GraphPart::Edges(edges))).await?;
    snapshot.commit().await?;
    Ok(())
}

async fn send_trajectory(
    mut connection: SqliteConnection,
    route: RouteId,
    trip: TripId,
    all_scans: bool,
    sender: Sender<Vec<TrajectoryPose>>,
) -> Result<(), StoreError> {
    // One statement, so that no solve comes between a keyframe and the scans that move with it.
    let statement = "WITH keyframes AS ( \
             SELECT nodes.route_key, node_id, stamp_ns, x, y, theta \
             FROM routes JOIN batches USING (route_key) \
             CROSS JOIN nodes ON nodes.batch_key = batches.batch_key \
             WHERE routes.id = $1 AND batches.trip_id = $2) \
         SELECT node_id, stamp_ns, x, y, theta, -1 AS place, NULL AS b_x, NULL AS b_y, \
             NULL AS b_theta FROM keyframes \
         UNION ALL \
         SELECT keyframes.node_id, behind.stamp_ns, keyframes.x, keyframes.y, keyframes.theta, \
             behind.place, behind.x, behind.y, behind.theta \
         FROM keyframes CROSS JOIN intermediate_scans AS behind \
             ON behind.route_key = keyframes.route_key AND behind.node_id = keyframes.node_id \
         WHERE $3 \
         ORDER BY stamp_ns, node_id, place";
    let rows = sqlx::query(statement)
        .bind(route.as_str())
        .bind(trip.as_str())
        .bind(all_scans)
        .fetch(&mut connection);
    send_rows(rows, trajectory_pose_of, |poses| sender.send(poses)).await
}

fn trajectory_pose_of(row: &SqliteRow) -> Result<TrajectoryPose, StoreError> {
    let is_keyframe = row.try_get::<i64, _>("place")? < 0;
    let map_from_keyframe = pose(row, ["x", "y", "theta"])?;
    Ok(TrajectoryPose {
        node_id: NodeId(row.try_get("node_id")?),
        is_keyframe,
        stamp: StampNs(row.try_get("stamp_ns")?),
        pose: if is_keyframe {
            map_from_keyframe
        } else {
            map_from_keyframe.compose(&pose(row, ["b_x", "b_y", "b_theta"])?)
        },
    })
}

async fn send_rows<T, S>(
    rows: impl Stream<Item = Result<SqliteRow, sqlx::Error>>,
    of_row: impl Fn(&SqliteRow) -> Result<T, StoreError>,
    send: impl Fn(Vec<T>) -> S,
) -> Result<(), StoreError>
where
    S: Future<Output = Result<(), StoreError>>,
{
    let mut pieces = std::pin::pin!(rows.chunks(ROWS_AT_ONCE));
    while let Some(rows) = pieces.next().await {
        let rows = rows.into_iter().map(|row| of_row(&row?));
        send(rows.collect::<Result<_, _>>()?).await?;
    }
    Ok(())
}
