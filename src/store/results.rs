//! Applying what a worker computed, all of it in one transaction.

use sqlx::SqliteConnection;

use super::alert_rows::write_alerts;
use super::batch_ends::batch_ended;
use super::columns::{flags_text, micros, parse_flags};
use super::error::StoreError;
use super::graph_rows::{insert_edges, insert_nodes, update_edges, update_nodes};
use super::inputs::{self, Input};
use super::intermediate_scans::insert_intermediate;
use super::jobs::{Job, held_job};
use super::members::{Members, members};
use super::records::{Applied, BatchOutcome, JobResult};
use super::request::Request;
use super::result_checks::{check, marks};
use super::trip_calibrations::put_calibration;
use super::trip_starts::put_trip_start;
use super::trips::{Place, end_turn};
use super::unanchored::{queue_unanchored, queue_unanchored_edges};
use super::{Store, backlog, news};
use crate::graph::EdgeKind;
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

/// Applies a job's result, if the worker still holds the job.
pub(super) struct ApplyResult(pub(super) JobResult);

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
        "UPDATE routes SET revision = revision + 1, stage = $2, updated_at_us = $3, \
         nodes = nodes + $4, edges = edges + $5, loop_closures = loop_closures + $6, \
         next_node_id = max(next_node_id, $7), next_edge_id = max(next_edge_id, $8) \
         WHERE route_key = $1 RETURNING nodes",
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
             SELECT min(subgraph_id) FROM edges WHERE route_key = $1 AND status = 'active' \
             UNION ALL \
             SELECT (SELECT min(subgraph_id) FROM edges WHERE route_key = $1 \
                 AND status = 'active' AND subgraph_id > block.id) \
             FROM block WHERE block.id IS NOT NULL) \
             SELECT count(id) FROM block) \
         WHERE route_key = $1",
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
    let flags: String = sqlx::query_scalar("SELECT flags FROM batches WHERE batch_key = $1")
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
        "UPDATE batches SET status = $1, reason = $2, flags = $3, nodes_added = $4, \
         loop_closures = $5, nodes_at_try = $6, processed_at_us = $7 WHERE batch_key = $8",
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
