//! Events for webhooks that are about no alert: quarantined uploads, vehicles that become suspect,
//! operations that end. Each is queued in the transaction of its cause.

use jiff::Timestamp;
use sqlx::SqliteConnection;

use super::columns::micros;
use super::error::StoreError;
use crate::ids::OperationId;
use crate::model::WebhookTopic;

/// An event that is about no alert.
pub(super) struct Notice<'a> {
    pub(super) topic: WebhookTopic,
    /// `None` for what is about several routes: webhooks of one route are not sent it.
    pub(super) route_key: Option<i64>,
    /// A batch or a vehicle by its name, an operation by its id.
    pub(super) subject: &'a str,
    pub(super) at: Timestamp,
}

impl Notice<'_> {
    /// Queues a delivery for every active webhook that subscribes to it.
    pub(super) async fn queue(&self, transaction: &mut SqliteConnection) -> Result<(), StoreError> {
        sqlx::query(
            "INSERT INTO webhook_deliveries (webhook_key, id, event, route_key, subject, at_us, \
             status, attempts, next_attempt_at_us) \
             SELECT webhook_key, 'msg_' || lower(hex(randomblob(16))), $1, $2, $3, $4, \
             'pending', 0, $4 \
             FROM webhooks WHERE active = 1 AND (route_key IS NULL OR route_key = $2) \
             AND EXISTS (SELECT 1 FROM json_each(events) WHERE value = $1) ORDER BY webhook_key",
        )
        .bind(self.topic.name())
        .bind(self.route_key)
        .bind(self.subject)
        .bind(micros(self.at))
        .execute(transaction)
        .await?;
        Ok(())
    }
}

/// An operation has ended.
pub(super) async fn operation_ended(
    transaction: &mut SqliteConnection,
    id: OperationId,
    route_key: Option<i64>,
    at: Timestamp,
) -> Result<(), StoreError> {
    let notice = Notice {
        topic: WebhookTopic::OperationFinished,
        route_key,
        subject: &id.to_string(),
        at,
    };
    notice.queue(transaction).await
}
