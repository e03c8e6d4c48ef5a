//! Reads: each a value that says what is asked for, beside the statement that answers it.

use std::future::Future;

use sqlx::{Connection, SqliteConnection};

use super::error::StoreError;

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

/// Answers a query from one snapshot. After an error the connection must not be used for another
/// transaction.
pub(super) async fn in_snapshot<Q: Query>(
    reader: &mut SqliteConnection,
    query: &Q,
) -> Result<Q::Answer, StoreError> {
    let mut snapshot = reader.begin().await?;
    let answer = query.answer(&mut snapshot).await?;
    snapshot.commit().await?;
    Ok(answer)
}
