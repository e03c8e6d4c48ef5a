//! What follows from the end of a batch's turn, in the transaction that ends it.

use jiff::Timestamp;
use sqlx::{Row, SqliteConnection};

use super::columns::{name, text};
use super::error::StoreError;
use super::notices::Notice;
use super::vehicle_states::note_state;
use crate::model::{BatchStatus, WebhookTopic};

/// Notes that a batch has the status with which its turn ended: receivers are sent that it was
/// quarantined, and the state of its vehicle is determined anew.
pub(super) async fn batch_ended(
    transaction: &mut SqliteConnection,
    batch_key: i64,
    at: Timestamp,
) -> Result<(), StoreError> {
    let row =
        sqlx::query("SELECT route_key, id, vehicle_id, status FROM batches WHERE batch_key = $1")
            .bind(batch_key)
            .fetch_one(&mut *transaction)
            .await?;
    let route_key: i64 = row.try_get("route_key")?;
    let status: BatchStatus = text(&row, "status")?;
    if status == BatchStatus::Quarantined {
        let notice = Notice {
            topic: WebhookTopic::BatchQuarantined,
            route_key: Some(route_key),
            subject: row.try_get("id")?,
            at,
        };
        notice.queue(transaction).await?;
    }
    note_state(transaction, route_key, &name(&row, "vehicle_id")?, at).await
}
