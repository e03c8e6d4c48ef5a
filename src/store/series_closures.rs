//! The closures that residual series are made of: all of the active graph, and the first that were
//! archived.

use std::collections::BTreeMap;

use sqlx::sqlite::SqliteRow;
use sqlx::{Row, SqliteConnection};

use super::Store;
use super::active_graph::join_active_edges;
use super::archive::{ArchivedSums, SubgraphSums};
use super::columns::name;
use super::error::StoreError;
use super::query::Query;
use super::records::{ARCHIVED_CLOSURES_MAX, ArchivedClosure};
use crate::ids::{EdgeId, NodeId, RouteId, VehicleId};

/// A closure with what residual series are made of.
#[derive(Debug, Clone, PartialEq)]
pub struct SeriesClosure {
    /// The edge.
    pub id: EdgeId,
    /// Its older node.
    pub from: NodeId,
    /// Its newer node.
    pub to: NodeId,
    /// The block of the graph it lies in; of an archived closure, the last one.
    pub subgraph_id: Option<i64>,
    /// What it added to the optimum F when it was inserted (paper: ΔF).
    pub delta_f: f64,
    /// eᵀΩe of the all-points estimate when it was inserted; `None` if it came as an edge, and no
    /// two scans were matched for it.
    pub all_points_residual: Option<f64>,
    /// Who drove the node with the larger id.
    pub vehicle_id: VehicleId,
    /// Whether one of its nodes is archived.
    pub archived: bool,
}

impl From<SeriesClosure> for ArchivedClosure {
    fn from(closure: SeriesClosure) -> Self {
        Self {
            id: closure.id,
            from: closure.from,
            to: closure.to,
            subgraph_id: closure.subgraph_id,
            delta_f: closure.delta_f,
            vehicle_id: closure.vehicle_id,
            given: closure.all_points_residual.is_none(),
        }
    }
}

/// The closures of a route that residual series are read from.
#[derive(Debug, Clone, PartialEq)]
pub struct SeriesClosures {
    /// By id: those between active nodes, and the first [`ARCHIVED_CLOSURES_MAX`] archived ones.
    pub closures: Vec<SeriesClosure>,
    /// Sums over everything that is archived, by sub-graph, also what is not among `closures`.
    pub archive: BTreeMap<Option<i64>, SubgraphSums>,
}

macro_rules! select_closures {
    ($from:expr, $rest:literal) => {
        concat!(
            "SELECT edges.edge_id, from_node, to_node, edges.subgraph_id, delta_f, vehicle_id, \
                 all_points_residual \
             FROM routes ",
            $from,
            " LEFT JOIN closures ON closures.route_key = edges.route_key \
                 AND closures.edge_id = edges.edge_id \
             JOIN batches ON batches.batch_key = \
                 iif(edges.to_node > edges.from_node, newer.batch_key, older.batch_key) \
             WHERE routes.id = $1 AND delta_f IS NOT NULL ",
            $rest
        )
    };
}

const ARCHIVED: &str = select_closures!(
    "CROSS JOIN edges USING (route_key) \
     JOIN nodes AS older ON older.route_key = edges.route_key \
         AND older.node_id = edges.from_node \
     JOIN nodes AS newer ON newer.route_key = edges.route_key \
         AND newer.node_id = edges.to_node",
    "AND NOT (older.active AND newer.active) ORDER BY edges.edge_id LIMIT $2"
);

const ACTIVE: &str = select_closures!(join_active_edges!(), "ORDER BY edges.edge_id");

impl Store {
    /// The closures that a route's residual series are read from, at one instant.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn series_closures(&self, route: &RouteId) -> Result<SeriesClosures, StoreError> {
        self.read(RouteSeriesClosures(route)).await
    }
}

/// The closures of a route that residual series are read from.
struct RouteSeriesClosures<'a>(&'a RouteId);

impl Query for RouteSeriesClosures<'_> {
    type Answer = SeriesClosures;
    const ONE_SNAPSHOT: bool = true;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let mut closures = FirstArchivedClosures(self.0).answer(reader).await?;
        let active = sqlx::query(ACTIVE)
            .bind(self.0.as_str())
            .fetch_all(&mut *reader)
            .await?;
        for row in &active {
            closures.push(closure_of(row, false)?);
        }
        closures.sort_unstable_by_key(|closure| closure.id);
        let archive = ArchivedSums(self.0).answer(reader).await?;
        Ok(SeriesClosures { closures, archive })
    }
}

/// The first [`ARCHIVED_CLOSURES_MAX`] closures with an archived node, by id.
pub(super) struct FirstArchivedClosures<'a>(pub(super) &'a RouteId);

impl Query for FirstArchivedClosures<'_> {
    type Answer = Vec<SeriesClosure>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let rows = sqlx::query(ARCHIVED)
            .bind(self.0.as_str())
            .bind(i64::try_from(ARCHIVED_CLOSURES_MAX).unwrap_or(i64::MAX))
            .fetch_all(reader)
            .await?;
        rows.iter().map(|row| closure_of(row, true)).collect()
    }
}

fn closure_of(row: &SqliteRow, archived: bool) -> Result<SeriesClosure, StoreError> {
    Ok(SeriesClosure {
        id: EdgeId(row.try_get("edge_id")?),
        from: NodeId(row.try_get("from_node")?),
        to: NodeId(row.try_get("to_node")?),
        subgraph_id: row.try_get("subgraph_id")?,
        delta_f: row.try_get("delta_f")?,
        all_points_residual: row.try_get("all_points_residual")?,
        vehicle_id: name(row, "vehicle_id")?,
        archived,
    })
}
