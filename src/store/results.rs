//! Applying what a worker computed: all of it in one transaction, or nothing.

use std::collections::BTreeMap;

use sqlx::{Row, SqliteConnection};

use super::alert_rows::write_alerts;
use super::clock_faults::put_clock_fault;
use super::columns::{flags_text, micros, name, parse_flags};
use super::error::StoreError;
use super::graph_rows::{insert_edges, insert_nodes, update_edges, update_nodes};
use super::inputs::{self, Input};
use super::intermediate_scans::insert_intermediate;
use super::jobs::{Job, held_job};
use super::notices::batch_ended;
use super::records::{Applied, BatchOutcome, JobResult};
use super::request::Request;
use super::trips::{Place, end_turn, queue};
use super::vehicles::{put_calibration, put_trip_start};
use super::{Store, backlog, news};
use crate::graph::EdgeKind;
use crate::ids::{BatchId, TripId, VehicleId};
use crate::model::BatchStatus;

impl Store {
    /// Writes a job's result, ends its batches, and queues what their end lets run: all or
    /// nothing. After [`Applied::Stale`] the job is still held if the route alone has moved on:
    /// it may be computed again from [`Store::load_graph`].
    ///
    /// # Errors
    /// [`StoreError::InvalidResult`] if the result contradicts itself or the store.
    pub async fn apply_result(&self, result: JobResult) -> Result<Applied, StoreError> {
        self.work(ApplyResult(result)).await
    }
}

/// Applies a job's result if the fence lets it through.
pub(super) struct ApplyResult(pub(super) JobResult);

/// A batch that a job may end, as new nodes and edges must name it.
pub(super) struct Member {
    pub(super) batch_key: i64,
    pub(super) vehicle_id: VehicleId,
    pub(super) trip_id: TripId,
}

/// The batches that a job may end.
pub(super) type Members = BTreeMap<BatchId, Member>;

impl Request for ApplyResult {
    type Outcome = Applied;
    const QUEUES_JOBS: bool = true;

    async fn execute(&self, transaction: &mut SqliteConnection) -> Result<Applied, StoreError> {
        let result = &self.0;
        let job = held_job(transaction, result.job_id, result.generation).await?;
        let Some(Job { place, .. }) = job else {
            return Ok(Applied::Stale);
        };
        let Some(marks) = marks(transaction, &place, result).await? else {
            return Ok(Applied::Stale);
        };
        let members = members(transaction, &place).await?;
        check(result, &place, &members, &marks)?;
        insert_nodes(transaction, place.route_key, &members, &result.nodes).await?;
        insert_intermediate(transaction, place.route_key, &result.intermediate).await?;
        insert_edges(transaction, place.route_key, &members, &result.edges).await?;
        update_nodes(transaction, place.route_key, &result.changed_nodes).await?;
        update_edges(transaction, place.route_key, &result.changed_edges).await?;
        write_alerts(transaction, place.route_key, &result.alerts).await?;
        for calibration in &result.calibrations {
            put_calibration(transaction, place.route_key, calibration).await?;
        }
        for fault in &result.clock_faults {
            put_clock_fault(transaction, place.route_key, fault).await?;
        }
        if let Some((trip, start)) = &result.trip_start {
            put_trip_start(transaction, place.route_key, trip, start).await?;
        }
        let nodes = raise_route(transaction, &place, result).await?;
        for outcome in &result.outcomes {
            end_batch(transaction, &members, outcome, nodes, result).await?;
        }
        let input = Input::Job(result.input.clone());
        inputs::note(transaction, place.route_key, result.processed_at, &input).await?;
        end_turn(transaction, &place).await?;
        let is_merged = |outcome: &BatchOutcome| outcome.status == BatchStatus::Merged;
        if result.outcomes.iter().any(is_merged) {
            backlog::queue_oldest(transaction, &place).await?;
        }
        if !result.nodes.is_empty() {
            queue_unanchored(transaction, place.route_key, nodes).await?;
            queue_unanchored_edges(transaction, place.route_key, nodes).await?;
        }
        Ok(Applied::Committed)
    }

    fn committed(&self, applied: &Applied) {
        if *applied == Applied::Committed {
            news::batches_ended(&self.0.route_id, &self.0.outcomes);
            news::alerts_written(&self.0.alerts);
        }
    }
}

/// A route's high-water marks.
struct Marks {
    next_node_id: i64,
    next_edge_id: i64,
}

/// The marks of the route, if it is still where the result was computed from.
async fn marks(
    transaction: &mut SqliteConnection,
    place: &Place,
    result: &JobResult,
) -> Result<Option<Marks>, StoreError> {
    let marks: Option<(i64, i64)> = sqlx::query_as(
        "SELECT next_node_id, next_edge_id FROM routes \
         WHERE route_key = ? AND id = ? AND revision = ?",
    )
    .bind(place.route_key)
    .bind(result.route_id.as_str())
    .bind(result.base_revision)
    .fetch_optional(transaction)
    .await?;
    Ok(marks.map(|(next_node_id, next_edge_id)| Marks {
        next_node_id,
        next_edge_id,
    }))
}

async fn members(transaction: &mut SqliteConnection, place: &Place) -> Result<Members, StoreError> {
    let rows = sqlx::query(
        "SELECT batch_key, id, vehicle_id, trip_id FROM batches \
         WHERE (route_key = ?1 AND trip_id = ?2 AND status = 'unanchored' AND kind = 'scans') \
         OR (route_key = ?1 AND status = 'unanchored' AND kind = 'edges' AND (vehicle_id, kind) = \
             (SELECT vehicle_id, kind FROM batches WHERE batch_key = ?3)) \
         OR batch_key = ?3",
    )
    .bind(place.route_key)
    .bind(&place.trip_id)
    .bind(place.batch_key)
    .fetch_all(transaction)
    .await?;
    let mut members = Members::new();
    for row in &rows {
        let member = Member {
            batch_key: row.try_get("batch_key")?,
            vehicle_id: name(row, "vehicle_id")?,
            trip_id: name(row, "trip_id")?,
        };
        members.insert(name(row, "id")?, member);
    }
    Ok(members)
}

/// What the database's own constraints do not see.
fn check(
    result: &JobResult,
    place: &Place,
    members: &Members,
    marks: &Marks,
) -> Result<(), StoreError> {
    let invalid = |what: String| Err(StoreError::InvalidResult(what));
    let mut ends_its_batch = false;
    for BatchOutcome {
        batch_id, status, ..
    } in &result.outcomes
    {
        use BatchStatus::{Merged, Quarantined, Unanchored};
        let Some(member) = members.get(batch_id) else {
            return invalid(format!("batch {batch_id} is not one of its batches"));
        };
        if !matches!(status, Merged | Unanchored | Quarantined) {
            return invalid(format!(
                "batch {batch_id} does not end as {}",
                status.name()
            ));
        }
        ends_its_batch |= member.batch_key == place.batch_key;
    }
    if !ends_its_batch {
        return invalid("it does not end the job's own batch".to_owned());
    }
    for node in result.nodes.iter().map(|with_scan| &with_scan.node) {
        if node.id.0 < marks.next_node_id {
            return invalid(format!("node id {} was used before", node.id));
        }
        let of_batch = members.get(&node.batch_id).is_some_and(|member| {
            member.vehicle_id == node.vehicle_id && member.trip_id == node.trip_id
        });
        if !of_batch {
            return invalid(format!("node {} is not of one of its batches", node.id));
        }
    }
    for edge in &result.edges {
        if edge.id.0 < marks.next_edge_id {
            return invalid(format!("edge id {} was used before", edge.id));
        }
        if !members.contains_key(&edge.batch_id) {
            return invalid(format!("edge {} is not of one of its batches", edge.id));
        }
    }
    Ok(())
}

/// Brings the route's counters, marks, stage and revision up to date, after the graph is written.
/// Returns how many nodes it has now.
async fn raise_route(
    transaction: &mut SqliteConnection,
    place: &Place,
    result: &JobResult,
) -> Result<i64, StoreError> {
    let closures = result.edges.iter();
    let closures = closures.filter(|edge| edge.kind == EdgeKind::LoopClosure);
    let last_node = result.nodes.iter().map(|with_scan| with_scan.node.id.0);
    let last_edge = result.edges.iter().map(|edge| edge.id.0);
    let nodes = sqlx::query_scalar(
        "UPDATE routes SET revision = revision + 1, stage = ?2, updated_at_us = ?3, \
         nodes = nodes + ?4, edges = edges + ?5, loop_closures = loop_closures + ?6, \
         next_node_id = max(next_node_id, ?7), next_edge_id = max(next_edge_id, ?8) \
         WHERE route_key = ?1 RETURNING nodes",
    )
    .bind(place.route_key)
    .bind(result.stage.name())
    .bind(micros(result.processed_at))
    .bind(length(result.nodes.len()))
    .bind(length(result.edges.len()))
    .bind(length(closures.count()))
    .bind(last_node.max().map_or(0, |id| id.saturating_add(1)))
    .bind(last_edge.max().map_or(0, |id| id.saturating_add(1)))
    .fetch_one(&mut *transaction)
    .await?;
    count_blocks(transaction, place.route_key).await?;
    Ok(nodes)
}

/// Counts a route's sub-graphs anew, after its edges are written.
pub(super) async fn count_blocks(
    transaction: &mut SqliteConnection,
    route_key: i64,
) -> Result<(), StoreError> {
    // The recursion steps from one block to the next along the index, so that the count costs
    // as much as there are blocks, not edges.
    sqlx::query(
        "UPDATE routes SET subgraphs = (WITH RECURSIVE block(id) AS ( \
             SELECT min(subgraph_id) FROM edges WHERE route_key = ?1 AND status = 'active' \
             UNION ALL \
             SELECT (SELECT min(subgraph_id) FROM edges WHERE route_key = ?1 \
                 AND status = 'active' AND subgraph_id > block.id) \
             FROM block WHERE block.id IS NOT NULL) \
             SELECT count(id) FROM block) \
         WHERE route_key = ?1",
    )
    .bind(route_key)
    .execute(transaction)
    .await?;
    Ok(())
}

fn length(length: usize) -> i64 {
    i64::try_from(length).unwrap_or(i64::MAX)
}

async fn end_batch(
    transaction: &mut SqliteConnection,
    members: &Members,
    outcome: &BatchOutcome,
    nodes: i64,
    result: &JobResult,
) -> Result<(), StoreError> {
    let Some(member) = members.get(&outcome.batch_id) else {
        return Ok(());
    };
    let flags: String = sqlx::query_scalar("SELECT flags FROM batches WHERE batch_key = ?")
        .bind(member.batch_key)
        .fetch_one(&mut *transaction)
        .await?;
    let mut flags = parse_flags(&flags)?;
    for flag in &outcome.flags {
        if !flags.contains(flag) {
            flags.push(flag.clone());
        }
    }
    let nodes_at_try = (outcome.status == BatchStatus::Unanchored).then_some(nodes);
    sqlx::query(
        "UPDATE batches SET status = ?, reason = ?, flags = ?, nodes_added = ?, \
         loop_closures = ?, nodes_at_try = ?, processed_at_us = ? WHERE batch_key = ?",
    )
    .bind(outcome.status.name())
    .bind(outcome.reason.as_deref())
    .bind(flags_text(&flags))
    .bind(outcome.nodes_added)
    .bind(outcome.loop_closures)
    .bind(nodes_at_try)
    .bind(micros(result.processed_at))
    .bind(member.batch_key)
    .execute(&mut *transaction)
    .await?;
    batch_ended(transaction, member.batch_key, result.processed_at).await
}

/// Queues the last unanchored batch of every trip (its job brings the earlier ones along) once
/// the route has grown by a quarter and 20 nodes since it was tried: growth that may hold the
/// place the trip was in, and tries that stay few, as their number grows with the logarithm of
/// the map. A trip that has a job is left alone: that job brings them along.
async fn queue_unanchored(
    transaction: &mut SqliteConnection,
    route_key: i64,
    nodes: i64,
) -> Result<(), StoreError> {
    let rows = sqlx::query_as(
        "SELECT batch_key, trip_id, max(sequence) FROM batches \
         WHERE route_key = ?1 AND status = 'unanchored' AND kind = 'scans' \
         AND NOT EXISTS (SELECT 1 FROM jobs WHERE jobs.route_key = batches.route_key \
             AND jobs.trip_id = batches.trip_id) \
         GROUP BY trip_id HAVING 4 * ?2 >= 5 * nodes_at_try + 80 ORDER BY batch_key",
    )
    .bind(route_key)
    .bind(nodes)
    .fetch_all(&mut *transaction)
    .await?;
    queue_all(transaction, route_key, rows).await
}

/// Queues the last batch of edges of every vehicle that could not be tied to the map (its job
/// brings the others along), by the same rule: they may name nodes that others made.
async fn queue_unanchored_edges(
    transaction: &mut SqliteConnection,
    route_key: i64,
    nodes: i64,
) -> Result<(), StoreError> {
    let rows = sqlx::query_as(
        "SELECT max(batch_key), trip_id, sequence FROM batches AS batch \
         WHERE route_key = ?1 AND status = 'unanchored' AND kind = 'edges' \
         AND NOT EXISTS (SELECT 1 FROM jobs JOIN batches AS other USING (batch_key) \
             WHERE jobs.route_key = ?1 AND other.kind = 'edges' \
             AND other.vehicle_id = batch.vehicle_id) \
         GROUP BY vehicle_id HAVING 4 * ?2 >= 5 * nodes_at_try + 80 ORDER BY 1",
    )
    .bind(route_key)
    .bind(nodes)
    .fetch_all(&mut *transaction)
    .await?;
    queue_all(transaction, route_key, rows).await
}

/// Queues batches by key, trip and sequence.
async fn queue_all(
    transaction: &mut SqliteConnection,
    route_key: i64,
    batches: Vec<(i64, String, i64)>,
) -> Result<(), StoreError> {
    for (batch_key, trip_id, sequence) in batches {
        let place = Place {
            batch_key,
            route_key,
            trip_id,
            sequence,
        };
        queue(transaction, &place).await?;
    }
    Ok(())
}
