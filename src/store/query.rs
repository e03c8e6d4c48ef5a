//! Reads: each a value that says what is asked for, beside the statement that answers it.

use std::future::Future;

use sqlx::{Connection, SqliteConnection};

use super::error::StoreError;
use super::{Store, named, of_snapshot};

/// One read.
pub(super) trait Query: Send + Sync {
    /// What is read.
    type Answer: Send;
    /// Whether it has several statements, which must see the same moment.
    const ONE_SNAPSHOT: bool = false;

    /// Reads. Nothing is written.
    fn answer(
        &self,
        reader: &mut SqliteConnection,
    ) -> impl Future<Output = Result<Self::Answer, StoreError>> + Send;
}

impl Store {
    /// What a query answers now.
    ///
    /// # Errors
    /// [`StoreError`].
    pub(super) async fn read<Q: Query>(&self, query: Q) -> Result<Q::Answer, StoreError> {
        let mut reader = self.reader().await?;
        if !Q::ONE_SNAPSHOT {
            return named(query.answer(&mut reader).await);
        }
        let answer = in_snapshot(&mut reader, &query).await;
        of_snapshot(reader, answer)
    }
}

/// What a query answers of one moment, on a connection that may be closed after an error.
pub(super) async fn in_snapshot<Q: Query>(
    reader: &mut SqliteConnection,
    query: &Q,
) -> Result<Q::Answer, StoreError> {
    let mut snapshot = reader.begin().await?;
    let answer = query.answer(&mut snapshot).await?;
    snapshot.commit().await?;
    Ok(answer)
}
