//! Loading a route's active graph, with all that the pipeline knows of the route.

use sqlx::{Row, SqliteConnection};

use super::Store;
use super::acceptances::AcceptedChanges;
use super::active_graph::ActiveEdges;
use super::alerts::RouteAlerts;
use super::clock_faults::ClockFaults;
use super::columns::text;
use super::error::StoreError;
use super::nodes::ActiveNodes;
use super::query::Query;
use super::records::RouteGraph;
use super::routes::settings_of;
use super::series_closures::FirstArchivedClosures;
use super::trip_calibrations::RouteCalibrations;
use crate::ids::{EdgeId, NodeId, RouteId};

impl Store {
    /// A route's active graph, read at one instant. A scan that has lost its checksum is left out.
    ///
    /// # Errors
    /// [`StoreError::Corrupt`] if a node or an edge has.
    pub async fn load_graph(&self, route: &RouteId) -> Result<Option<RouteGraph>, StoreError> {
        self.read(ActiveGraph(route)).await
    }
}

/// A route's active graph; `None` if there is no such route.
struct ActiveGraph<'a>(&'a RouteId);

impl Query for ActiveGraph<'_> {
    type Answer = Option<RouteGraph>;
    const ONE_SNAPSHOT: bool = true;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let Self(route) = self;
        let row = sqlx::query(
            "SELECT revision, stage, detector, false_alarm_rate, hold_s, max_shift_m, \
             next_node_id, next_edge_id, map_version FROM routes WHERE id = $1",
        )
        .bind(route.as_str())
        .fetch_optional(&mut *reader)
        .await?;
        let Some(row) = row else { return Ok(None) };
        let nodes = ActiveNodes(route).answer(reader).await?;
        let edges = ActiveEdges(route).answer(reader).await?;
        let archived_closures = FirstArchivedClosures(route).answer(reader).await?;
        Ok(Some(RouteGraph {
            revision: row.try_get("revision")?,
            stage: text(&row, "stage")?,
            settings: settings_of(&row)?,
            next_node_id: NodeId(row.try_get("next_node_id")?),
            next_edge_id: EdgeId(row.try_get("next_edge_id")?),
            nodes,
            edges,
            archived_closures: archived_closures.into_iter().map(Into::into).collect(),
            map_version: row.try_get("map_version")?,
            alerts: RouteAlerts(route).answer(reader).await?,
            accepted: AcceptedChanges(route).answer(reader).await?,
            calibrations: RouteCalibrations(route).answer(reader).await?,
            clock_faults: ClockFaults(route).answer(reader).await?,
        }))
    }
}
