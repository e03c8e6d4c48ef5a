//! Taking uploads out of a route: what they hold, and their removal in one transaction.

use sqlx::sqlite::SqliteRow;
use sqlx::{Row, SqliteConnection};

use super::alert_rows::write_alerts;
use super::columns::{json_text, micros, name};
use super::error::StoreError;
use super::graph_rows::{update_edges, update_nodes};
use super::inputs::{self, Input};
use super::operation_records::OperationResult;
use super::query::Query;
use super::removal_records::{Meant, Removable, Removal};
use super::request::Request;
use super::results::count_blocks;
use super::trips::{Place, end_turn};
use super::vehicle_states::note_state;
use super::{Store, news, operations};
use crate::ids::{BatchId, EdgeId, NodeId, RouteId, TripId, VehicleId};
use crate::model::BatchStatus;

impl Store {
    /// The uploads that are meant, without those that were removed before, and what they hold.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn removable(&self, route: &RouteId, meant: &Meant) -> Result<Removable, StoreError> {
        self.read(RemovableOf { route, meant }).await
    }

    /// The batches that were removed from a route, each with its trip.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn removed_batches(
        &self,
        route: &RouteId,
    ) -> Result<Vec<(BatchId, TripId)>, StoreError> {
        self.read(RemovedBatches(route)).await
    }

    /// How many batches in a route's map have no body any more.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn merged_without_body(&self, route: &RouteId) -> Result<u64, StoreError> {
        self.read(MergedWithoutBody(route)).await
    }

    /// Writes a removal, all or nothing; false if the route has moved on since it was computed.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn apply_removal(&self, removal: Removal) -> Result<bool, StoreError> {
        self.work(ApplyRemoval(removal)).await
    }
}

/// The uploads that are meant and what they hold of the graph.
struct RemovableOf<'a> {
    route: &'a RouteId,
    meant: &'a Meant,
}

impl Query for RemovableOf<'_> {
    type Answer = Removable;
    const ONE_SNAPSHOT: bool = true;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let rows = self.batches(reader).await?;
        let keys: Vec<i64> = rows
            .iter()
            .map(|row| row.try_get("batch_key"))
            .collect::<Result<_, _>>()?;
        let keys = json_text(&keys)?;
        let nodes: Vec<i64> = sqlx::query_scalar(
            "SELECT node_id FROM nodes WHERE batch_key IN (SELECT value FROM json_each($1)) \
             ORDER BY node_id",
        )
        .bind(&keys)
        .fetch_all(&mut *reader)
        .await?;
        let edges = self.edges(reader, &keys, &nodes).await?;
        let id = |row: &SqliteRow| name::<BatchId>(row, "id");
        let trip = |row: &SqliteRow| name::<TripId>(row, "trip_id");
        let mut trips: Vec<TripId> = rows.iter().map(trip).collect::<Result<_, _>>()?;
        trips.sort_unstable();
        trips.dedup();
        Ok(Removable {
            batches: rows.iter().map(id).collect::<Result<_, _>>()?,
            trips,
            nodes: nodes.into_iter().map(NodeId).collect(),
            edges: edges.into_iter().map(EdgeId).collect(),
        })
    }
}

impl RemovableOf<'_> {
    /// The batches that are meant and not removed yet, in the order of arrival.
    async fn batches(&self, reader: &mut SqliteConnection) -> Result<Vec<SqliteRow>, StoreError> {
        let (by_batch, by_trip, vehicle, since) = match self.meant {
            Meant::Batches(ids) => (Some(json_text(ids)?), None, None, None),
            Meant::Trips(trips) => (None, Some(json_text(trips)?), None, None),
            Meant::Vehicle { id, since } => (None, None, Some(id.as_str()), since.map(micros)),
        };
        let rows = sqlx::query(
            "SELECT batch_key, batches.id, trip_id FROM routes JOIN batches USING (route_key) \
             WHERE routes.id = $1 AND status <> 'removed' \
             AND ($2 IS NULL OR batches.id IN (SELECT value FROM json_each($2))) \
             AND ($3 IS NULL OR trip_id IN (SELECT value FROM json_each($3))) \
             AND ($4 IS NULL OR vehicle_id = $4) \
             AND ($5 IS NULL OR received_at_us >= $5) ORDER BY batch_key",
        )
        .bind(self.route.as_str())
        .bind(by_batch)
        .bind(by_trip)
        .bind(vehicle)
        .bind(since)
        .fetch_all(reader)
        .await?;
        Ok(rows)
    }

    /// The edges of batches (`keys`, as JSON) and those of others that end at their nodes, ascending.
    async fn edges(
        &self,
        reader: &mut SqliteConnection,
        keys: &str,
        nodes: &[i64],
    ) -> Result<Vec<i64>, StoreError> {
        let edges = sqlx::query_scalar(
            "WITH gone AS (SELECT value AS id FROM json_each($1)), \
                 place AS (SELECT route_key FROM routes WHERE id = $2) \
             SELECT edge_id FROM edges WHERE batch_key IN (SELECT value FROM json_each($3)) \
             UNION SELECT edge_id FROM place CROSS JOIN gone CROSS JOIN edges \
                 INDEXED BY edges_by_from \
                 ON edges.route_key = place.route_key AND from_node = gone.id \
             UNION SELECT edge_id FROM place CROSS JOIN gone CROSS JOIN edges \
                 INDEXED BY edges_by_to \
                 ON edges.route_key = place.route_key AND to_node = gone.id \
             ORDER BY 1",
        )
        .bind(json_text(nodes)?)
        .bind(self.route.as_str())
        .bind(keys)
        .fetch_all(reader)
        .await?;
        Ok(edges)
    }
}

/// The batches that were removed from a route, each with its trip.
struct RemovedBatches<'a>(&'a RouteId);

impl Query for RemovedBatches<'_> {
    type Answer = Vec<(BatchId, TripId)>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let rows = sqlx::query(
            "SELECT batches.id, trip_id FROM routes JOIN batches USING (route_key) \
             WHERE routes.id = $1 AND status = 'removed' ORDER BY batch_key",
        )
        .bind(self.0.as_str())
        .fetch_all(reader)
        .await?;
        let removed = |row: &SqliteRow| Ok((name(row, "id")?, name(row, "trip_id")?));
        rows.iter().map(removed).collect()
    }
}

/// How many batches in a route's map have no body any more.
struct MergedWithoutBody<'a>(&'a RouteId);

impl Query for MergedWithoutBody<'_> {
    type Answer = u64;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let count: i64 = sqlx::query_scalar(
            "SELECT count(*) FROM routes JOIN batches USING (route_key) WHERE routes.id = $1 \
             AND status = 'merged' AND NOT body_kept",
        )
        .bind(self.0.as_str())
        .fetch_one(reader)
        .await?;
        Ok(count.unsigned_abs())
    }
}

struct ApplyRemoval(Removal);

impl Request for ApplyRemoval {
    type Outcome = bool;
    const QUEUES_JOBS: bool = true;

    async fn execute(&self, transaction: &mut SqliteConnection) -> Result<bool, StoreError> {
        let removal = &self.0;
        let route_key: Option<i64> =
            sqlx::query_scalar("SELECT route_key FROM routes WHERE id = $1 AND revision = $2")
                .bind(removal.route_id.as_str())
                .bind(removal.base_revision)
                .fetch_optional(&mut *transaction)
                .await?;
        let Some(route_key) = route_key else {
            return Ok(false);
        };
        let places = self.mark_batches(transaction, route_key).await?;
        self.delete_from_graph(transaction, route_key, &places)
            .await?;
        update_nodes(transaction, route_key, &removal.changed_nodes).await?;
        update_edges(transaction, route_key, &removal.changed_edges).await?;
        count_blocks(transaction, route_key).await?;
        write_alerts(transaction, route_key, &removal.alerts).await?;
        for place in &places {
            end_turn(transaction, place).await?;
        }
        self.forget_trips(transaction, route_key).await?;
        self.note_vehicles(transaction, route_key, &places).await?;
        let input = Input::Removal {
            operation: removal.operation,
            batches: removal.removable.batches.clone(),
        };
        inputs::note(transaction, route_key, removal.at, &input).await?;
        let (id, result) = (removal.operation, &removal.result);
        let noted = match removal.ends {
            true => {
                let outcome = Ok(OperationResult::Removal(result.clone()));
                operations::end(transaction, id, &outcome, removal.at).await?
            }
            false => operations::note_removed(transaction, id, result).await?,
        };
        if !noted {
            let what = format!("operation {id} has ended already");
            return Err(StoreError::InvalidResult(what));
        }
        Ok(true)
    }

    fn committed(&self, is_applied: &bool) {
        if *is_applied {
            news::batches_removed(self.0.removable.batches.len());
            news::alerts_written(&self.0.alerts);
        }
    }
}

impl ApplyRemoval {
    /// Marks the batches as removed; returns their places in their trips.
    async fn mark_batches(
        &self,
        transaction: &mut SqliteConnection,
        route_key: i64,
    ) -> Result<Vec<Place>, StoreError> {
        let removal = &self.0;
        let rows = sqlx::query(
            "UPDATE batches SET status = $1, reason = $2, nodes_added = 0, loop_closures = 0, \
                 nodes_at_try = NULL, processed_at_us = $3, body_kept = body_kept AND NOT $4, \
                 extensions = CASE WHEN $4 THEN NULL ELSE extensions END \
             WHERE route_key = $5 AND id IN (SELECT value FROM json_each($6)) \
             RETURNING batch_key, trip_id, sequence",
        )
        .bind(BatchStatus::Removed.name())
        .bind(&removal.reason)
        .bind(micros(removal.at))
        .bind(removal.erase)
        .bind(route_key)
        .bind(json_text(&removal.removable.batches)?)
        .fetch_all(&mut *transaction)
        .await?;
        let places = rows.iter().map(|row| Place::of(row, route_key));
        let mut places: Vec<Place> = places.collect::<Result<_, _>>()?;
        places.sort_unstable_by_key(|place| place.batch_key);
        Ok(places)
    }

    /// Deletes nodes with the rows that refer to them, and edges, and subtracts them from the route's
    /// counts.
    async fn delete_from_graph(
        &self,
        transaction: &mut SqliteConnection,
        route_key: i64,
        places: &[Place],
    ) -> Result<(), StoreError> {
        let removal = &self.0;
        let keys: Vec<i64> = places.iter().map(|place| place.batch_key).collect();
        let keys = json_text(&keys)?;
        let kinds: Vec<String> = sqlx::query_scalar(
            "DELETE FROM edges WHERE route_key = $1 \
             AND edge_id IN (SELECT value FROM json_each($2)) RETURNING kind",
        )
        .bind(route_key)
        .bind(json_text(&removal.removable.edges)?)
        .fetch_all(&mut *transaction)
        .await?;
        let nodes =
            sqlx::query("DELETE FROM nodes WHERE batch_key IN (SELECT value FROM json_each($1))")
                .bind(&keys)
                .execute(&mut *transaction)
                .await?;
        for rest in [
            "DELETE FROM alert_batches WHERE batch_key IN (SELECT value FROM json_each($1))",
            "DELETE FROM batch_bodies WHERE batch_key IN (SELECT value FROM json_each($1)) AND $2",
        ] {
            sqlx::query(rest)
                .bind(&keys)
                .bind(removal.erase)
                .execute(&mut *transaction)
                .await?;
        }
        let closures = kinds.iter().filter(|kind| *kind == "loop_closure").count();
        let count = |count: usize| i64::try_from(count).unwrap_or(i64::MAX);
        sqlx::query(
            "UPDATE routes SET revision = revision + 1, updated_at_us = $1, nodes = nodes - $2, \
             edges = edges - $3, loop_closures = loop_closures - $4 WHERE route_key = $5",
        )
        .bind(micros(removal.at))
        .bind(i64::try_from(nodes.rows_affected()).unwrap_or(i64::MAX))
        .bind(count(kinds.len()))
        .bind(count(closures))
        .bind(route_key)
        .execute(transaction)
        .await?;
        Ok(())
    }

    /// Determines the states of the vehicles anew.
    async fn note_vehicles(
        &self,
        transaction: &mut SqliteConnection,
        route_key: i64,
        places: &[Place],
    ) -> Result<(), StoreError> {
        let keys: Vec<i64> = places.iter().map(|place| place.batch_key).collect();
        let rows = sqlx::query(
            "SELECT DISTINCT vehicle_id FROM batches \
             WHERE batch_key IN (SELECT value FROM json_each($1)) ORDER BY vehicle_id",
        )
        .bind(json_text(&keys)?)
        .fetch_all(&mut *transaction)
        .await?;
        for row in &rows {
            let vehicle: VehicleId = name(row, "vehicle_id")?;
            note_state(transaction, route_key, &vehicle, self.0.at).await?;
        }
        Ok(())
    }

    /// Deletes what the trips said of their vehicles; a trip without any batch left begins anew.
    async fn forget_trips(
        &self,
        transaction: &mut SqliteConnection,
        route_key: i64,
    ) -> Result<(), StoreError> {
        let trips = json_text(&self.0.removable.trips)?;
        for forget in [
            "DELETE FROM lidar_calibrations WHERE route_key = $1 \
             AND trip_id IN (SELECT value FROM json_each($2))",
            "DELETE FROM clock_faults WHERE route_key = $1 \
             AND trip_id IN (SELECT value FROM json_each($2))",
            "UPDATE trips SET next_sequence = 0, corrections = NULL, clock_ahead_ns = 0 \
             WHERE route_key = $1 AND trip_id IN (SELECT value FROM json_each($2)) \
             AND NOT EXISTS (SELECT 1 FROM batches WHERE batches.route_key = trips.route_key \
                 AND batches.trip_id = trips.trip_id \
                 AND status NOT IN ('removed', 'quarantined'))",
        ] {
            sqlx::query(forget)
                .bind(route_key)
                .bind(&trips)
                .execute(&mut *transaction)
                .await?;
        }
        Ok(())
    }
}
