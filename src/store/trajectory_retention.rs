//! Deleting what lies between the keyframes of trips that are long over.

use jiff::Timestamp;
use sqlx::{Row, SqliteConnection};

use super::Store;
use super::columns::{json_text, micros};
use super::error::StoreError;
use super::request::Request;

/// Batches of one step: other writes wait as long as it takes.
const STEP_MAX: i64 = 32;

/// What a step has deleted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct DeletedTrajectories {
    /// Scans between keyframes, with their poses and odometry.
    pub scans: u64,
    /// Where the next step begins; `None` if no batch is left.
    pub next: Option<i64>,
}

impl Store {
    /// Deletes the scans between keyframes that have left the map, of the next few batches after the one
    /// with the key `after` that were merged before a time. Keyframes stay.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn delete_trajectories(
        &self,
        before: Timestamp,
        after: i64,
    ) -> Result<DeletedTrajectories, StoreError> {
        self.work(DeleteTrajectories { before, after }).await
    }
}

struct DeleteTrajectories {
    before: Timestamp,
    after: i64,
}

impl Request for DeleteTrajectories {
    type Outcome = DeletedTrajectories;
    const QUEUES_JOBS: bool = false;
    const WHILE_FULL: bool = true;

    async fn execute(
        &self,
        transaction: &mut SqliteConnection,
    ) -> Result<DeletedTrajectories, StoreError> {
        let batches = sqlx::query(
            "SELECT batch_key, route_key FROM batches WHERE batch_key > $1 AND kind = 'scans' \
             AND status = 'merged' AND processed_at_us < $2 ORDER BY batch_key LIMIT $3",
        )
        .bind(self.after)
        .bind(micros(self.before))
        .bind(STEP_MAX)
        .fetch_all(&mut *transaction)
        .await?;
        let mut deleted = DeletedTrajectories::default();
        let mut routes: Vec<i64> = Vec::new();
        for batch in &batches {
            let batch_key: i64 = batch.try_get("batch_key")?;
            deleted.next = Some(batch_key);
            let scans = delete_of_batch(transaction, batch_key).await?;
            if scans > 0 {
                deleted.scans += scans;
                routes.push(batch.try_get("route_key")?);
            }
        }
        // A worker that has taken such a node back into its map computes its job again.
        sqlx::query(
            "UPDATE routes SET revision = revision + 1 \
             WHERE route_key IN (SELECT value FROM json_each($1))",
        )
        .bind(json_text(&routes)?)
        .execute(transaction)
        .await?;
        Ok(deleted)
    }
}

/// Deletes what follows the archived nodes of a batch; returns how many scans that were.
async fn delete_of_batch(
    transaction: &mut SqliteConnection,
    batch_key: i64,
) -> Result<u64, StoreError> {
    let deleted = sqlx::query(
        "DELETE FROM intermediate_scans WHERE (route_key, node_id) IN \
             (SELECT route_key, node_id FROM nodes WHERE batch_key = $1 AND active = 0)",
    )
    .bind(batch_key)
    .execute(transaction)
    .await?;
    Ok(deleted.rows_affected())
}
