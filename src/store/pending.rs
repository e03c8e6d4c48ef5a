//! How many batches are waiting to be processed.

use sqlx::SqliteConnection;

use super::Store;
use super::error::StoreError;
use super::query::Query;

impl Store {
    /// The batches of all routes that are queued or being processed.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn pending_batches(&self) -> Result<i64, StoreError> {
        self.read(PendingBatches).await
    }
}

struct PendingBatches;

impl Query for PendingBatches {
    type Answer = i64;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<i64, StoreError> {
        let count = sqlx::query_scalar("SELECT count(*) FROM jobs");
        Ok(count.fetch_one(reader).await?)
    }
}
