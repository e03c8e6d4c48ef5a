//! Deleting the bodies of uploads that are in the map.

use jiff::Timestamp;
use sqlx::SqliteConnection;

use super::Store;
use super::columns::micros;
use super::error::StoreError;
use super::records::DeletedBodies;
use super::request::Request;

impl Store {
    /// Deletes the bodies of batches that were merged before a time, at most a few of them. Bodies
    /// of batches that are not in the map are kept.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn delete_bodies(&self, before: Timestamp) -> Result<DeletedBodies, StoreError> {
        self.work(DeleteBodies { before }).await
    }
}

/// Most bodies of one step, since other writes wait for it.
const STEP_MAX: i64 = 32;

/// Deletes bodies of batches merged before a time, a few of them.
pub(super) struct DeleteBodies {
    pub(super) before: Timestamp,
}

impl Request for DeleteBodies {
    type Outcome = DeletedBodies;
    const QUEUES_JOBS: bool = false;
    const WHILE_FULL: bool = true;

    async fn execute(
        &self,
        transaction: &mut SqliteConnection,
    ) -> Result<DeletedBodies, StoreError> {
        let keys: Vec<i64> = sqlx::query_scalar(
            "UPDATE batches SET body_kept = 0 WHERE batch_key IN ( \
                 SELECT batch_key FROM batches \
                 WHERE status = 'merged' AND body_kept = 1 AND processed_at_us < $1 \
                 ORDER BY processed_at_us LIMIT $2) \
             RETURNING batch_key",
        )
        .bind(micros(self.before))
        .bind(STEP_MAX)
        .fetch_all(&mut *transaction)
        .await?;
        let mut deleted = DeletedBodies::default();
        for key in keys {
            let bytes: Option<i64> = sqlx::query_scalar(
                "DELETE FROM batch_bodies WHERE batch_key = $1 RETURNING length(body)",
            )
            .bind(key)
            .fetch_optional(&mut *transaction)
            .await?;
            if let Some(bytes) = bytes {
                deleted.bodies += 1;
                deleted.bytes += u64::try_from(bytes).unwrap_or_default();
            }
        }
        Ok(deleted)
    }
}
