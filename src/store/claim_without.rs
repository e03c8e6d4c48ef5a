//! The jobs of a journal, repeated in a copy of their route as if some uploads had never come.

use std::collections::BTreeSet;

use jiff::Timestamp;
use sqlx::{Row, SqliteConnection};

use super::Store;
use super::backlog;
use super::claims::Claim;
use super::columns::json_text;
use super::error::StoreError;
use super::inputs::JobInput;
use super::jobs::Job;
use super::records::ClaimedJob;
use super::repeat::{hold, route_key, touch};
use super::request::Request;
use super::trips::Place;
use crate::ids::{BatchId, RouteId};

impl Store {
    /// The job that an input names, claimed as if the batches that are left out had never come: with whatever
    /// waits before its own in the trip, and without what is merged already. Nodes and edges get the ids that
    /// they had, as far as these are free. `None` if nothing is left of it. Only in a copy of one route
    /// ([`Store::copy_route`]).
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn claim_without(
        &self,
        route: &RouteId,
        input: &JobInput,
        left_out: &BTreeSet<BatchId>,
        at: Timestamp,
    ) -> Result<Option<ClaimedJob>, StoreError> {
        let request = ClaimWithout {
            route: route.clone(),
            input: input.clone(),
            left_out: json_text(left_out)?,
            at,
        };
        match self.work(request).await? {
            Some(claim) => self.load_entries(claim).await.map(Some),
            None => Ok(None),
        }
    }
}

struct ClaimWithout {
    route: RouteId,
    input: JobInput,
    /// As JSON.
    left_out: String,
    at: Timestamp,
}

impl Request for ClaimWithout {
    type Outcome = Option<Claim>;
    const QUEUES_JOBS: bool = false;

    async fn execute(
        &self,
        transaction: &mut SqliteConnection,
    ) -> Result<Option<Claim>, StoreError> {
        let route_key = route_key(transaction, &self.route).await?;
        let Some(place) = self.own(transaction, route_key).await? else {
            return Ok(None);
        };
        let job = Job {
            job_id: 0,
            attempts: 0,
            orphaned: i64::from(self.input.apart),
            place,
        };
        let Some(taken) = backlog::take(transaction, &job, self.at).await? else {
            return Ok(None);
        };
        let batches = json_text(&taken.batch_ids)?;
        touch(transaction, route_key, &batches).await?;
        keep_ids(transaction, route_key, &batches).await?;
        let job_id = hold(transaction, &job.place, &batches).await?;
        Ok(Some(Claim {
            job_id,
            generation: 1,
            attempts: 1,
            route_id: self.route.clone(),
            batch_ids: taken.batch_ids,
            after_gap: taken.after_gap,
            apart: taken.apart,
            at: self.at,
        }))
    }
}

impl ClaimWithout {
    /// The last batch of the input that is neither left out nor merged yet.
    async fn own(
        &self,
        transaction: &mut SqliteConnection,
        route_key: i64,
    ) -> Result<Option<Place>, StoreError> {
        let rows = sqlx::query(
            "SELECT batch_key, batches.id, trip_id, sequence \
             FROM json_each($1) CROSS JOIN batches ON route_key = $2 AND batches.id = value \
             WHERE body_kept AND status <> 'merged' \
             AND batches.id NOT IN (SELECT value FROM json_each($3)) ORDER BY key",
        )
        .bind(json_text(&self.input.batches)?)
        .bind(route_key)
        .bind(&self.left_out)
        .fetch_all(&mut *transaction)
        .await?;
        let Some(own) = rows.last() else {
            return Ok(None);
        };
        let ids: Vec<&str> = rows
            .iter()
            .map(|row| row.try_get("id"))
            .collect::<Result<_, _>>()?;
        touch(transaction, route_key, &json_text(&ids)?).await?;
        Place::of(own, route_key).map(Some)
    }
}

/// Lets nodes and edges begin with the ids that those of the batches once had, if these are free: edges
/// that a vehicle sent name nodes by their ids.
async fn keep_ids(
    transaction: &mut SqliteConnection,
    route_key: i64,
    batches: &str,
) -> Result<(), StoreError> {
    sqlx::query(
        "UPDATE routes SET next_node_id = max(next_node_id, had.node_id), \
             next_edge_id = max(next_edge_id, had.edge_id), revision = revision + 1 \
         FROM (SELECT coalesce(min(node_id), 0) AS node_id, coalesce(min(edge_id), 0) AS edge_id \
             FROM rebuild_ids JOIN batches USING (batch_key) WHERE batches.route_key = $1 \
             AND batches.id IN (SELECT value FROM json_each($2))) AS had \
         WHERE route_key = $1 AND (next_node_id < had.node_id OR next_edge_id < had.edge_id)",
    )
    .bind(route_key)
    .bind(batches)
    .execute(transaction)
    .await?;
    Ok(())
}
