//! Attempts to deliver events, and how long deliveries are kept.

use jiff::Timestamp;
use sqlx::SqliteConnection;

use super::Store;
use super::columns::micros;
use super::error::StoreError;
use super::query::Query;
use super::request::Request;
use super::webhook_records::{Attempt, AttemptEnd, AttemptVerdict};
use super::webhooks::{OneWebhook, note, webhook_id};
use crate::model::{Actor, DeliveryStatus};

/// Most deliveries that are deleted in one step: other writes wait as long as it takes.
const DELETED_AT_ONCE: i64 = 500;
/// Delivered ones are kept among this many of the newest deliveries of a webhook.
const LISTED: i64 = 1_000;

impl Store {
    /// Notes an attempt and what follows from it. Nothing is written if the delivery is gone or
    /// has been tried by somebody else meanwhile.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn record_attempt(&self, attempt: Attempt) -> Result<(), StoreError> {
        self.work(Record(attempt)).await
    }

    /// Deletes deliveries of events before a time, whatever became of them, and what was delivered
    /// longer ago than the newest 1,000 of its webhook; a few hundred at once. Returns how many.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn delete_deliveries(&self, before: Timestamp) -> Result<u64, StoreError> {
        self.work(DeleteOld { before }).await
    }
}

struct Record(Attempt);

impl Request for Record {
    type Outcome = ();
    const QUEUES_JOBS: bool = false;

    async fn execute(&self, transaction: &mut SqliteConnection) -> Result<(), StoreError> {
        let attempt = &self.0;
        let (status, next) = match attempt.verdict {
            AttemptVerdict::Delivered => (DeliveryStatus::Delivered, None),
            AttemptVerdict::RetryAt(at) => (DeliveryStatus::Pending, Some(micros(at))),
            AttemptVerdict::Failed | AttemptVerdict::Gone => (DeliveryStatus::Failed, None),
        };
        let (answer, failure) = match attempt.end {
            AttemptEnd::Answer(status) => (Some(status), None),
            AttemptEnd::Failure(failure) => (None, Some(failure.name())),
        };
        let noted = sqlx::query(
            "UPDATE webhook_deliveries SET status = $3, attempts = $2, attempted_at_us = $4, \
             next_attempt_at_us = $5, answer_status = $6, failure = $7 \
             WHERE delivery_key = $1 AND attempts = $2 - 1 AND status = 'pending'",
        )
        .bind(attempt.delivery_key)
        .bind(attempt.attempts)
        .bind(status.name())
        .bind(micros(attempt.ended_at))
        .bind(next)
        .bind(answer)
        .bind(failure)
        .execute(&mut *transaction)
        .await?;
        if noted.rows_affected() == 0 {
            return Ok(());
        }
        match attempt.verdict {
            AttemptVerdict::Delivered => self.delete_outdated(transaction).await,
            AttemptVerdict::RetryAt(_) => self.keep_newest(transaction).await,
            AttemptVerdict::Gone => self.disable(transaction).await,
            AttemptVerdict::Failed => Ok(()),
        }
    }
}

impl Record {
    /// Deletes updates that wait and are of a revision that the receiver has by now.
    async fn delete_outdated(&self, transaction: &mut SqliteConnection) -> Result<(), StoreError> {
        // By the index of what waits: that is little, while the webhook or the alert may have thousands
        // of deliveries.
        sqlx::query(
            "DELETE FROM webhook_deliveries INDEXED BY webhook_deliveries_pending \
             WHERE status = 'pending' AND event = 'alert.updated' AND alert_revision <= $2 \
             AND (webhook_key, alert_key) = \
             (SELECT webhook_key, alert_key FROM webhook_deliveries WHERE delivery_key = $1)",
        )
        .bind(self.0.delivery_key)
        .bind(self.0.alert_revision)
        .execute(transaction)
        .await?;
        Ok(())
    }

    /// Keeps only the newest of an alert's updates that wait: it sends the alert as it is then, and has
    /// all its attempts left. Otherwise every event would add to what waits for a receiver that is
    /// down.
    async fn keep_newest(&self, transaction: &mut SqliteConnection) -> Result<(), StoreError> {
        sqlx::query(
            "WITH waiting AS ( \
                 SELECT delivery_key FROM webhook_deliveries INDEXED BY webhook_deliveries_pending \
                 WHERE status = 'pending' AND event = 'alert.updated' \
                 AND (webhook_key, alert_key) = \
                 (SELECT webhook_key, alert_key FROM webhook_deliveries WHERE delivery_key = $1)) \
             DELETE FROM webhook_deliveries WHERE delivery_key IN waiting \
             AND delivery_key < (SELECT max(delivery_key) FROM waiting)",
        )
        .bind(self.0.delivery_key)
        .execute(transaction)
        .await?;
        Ok(())
    }

    /// Disables the webhook, unless somebody has edited it since the attempt: it may have another URL.
    async fn disable(&self, transaction: &mut SqliteConnection) -> Result<(), StoreError> {
        let row = sqlx::query(
            "SELECT webhooks.id FROM webhook_deliveries JOIN webhooks USING (webhook_key) \
             WHERE delivery_key = $1",
        )
        .bind(self.0.delivery_key)
        .fetch_one(&mut *transaction)
        .await?;
        let id = webhook_id(&row, "id")?;
        let before = OneWebhook(id).answer(transaction).await?;
        sqlx::query(
            "UPDATE webhooks SET active = 0, gone_at_us = $2, updated_at_us = $2, \
             revision = revision + 1 WHERE active = 1 AND revision = $3 AND id = $1",
        )
        .bind(id.to_string())
        .bind(micros(self.0.ended_at))
        .bind(self.0.webhook_revision)
        .execute(&mut *transaction)
        .await?;
        let (by, at) = (&Actor::System, self.0.ended_at);
        note(transaction, id, before.as_ref(), by, at).await
    }
}

struct DeleteOld {
    before: Timestamp,
}

impl Request for DeleteOld {
    type Outcome = u64;
    const QUEUES_JOBS: bool = false;
    const WHILE_FULL: bool = true;

    async fn execute(&self, transaction: &mut SqliteConnection) -> Result<u64, StoreError> {
        let deleted = sqlx::query(
            "DELETE FROM webhook_deliveries WHERE delivery_key IN ( \
             SELECT delivery_key FROM webhook_deliveries WHERE at_us < $1 \
             ORDER BY at_us LIMIT $2)",
        )
        .bind(micros(self.before))
        .bind(DELETED_AT_ONCE)
        .execute(&mut *transaction)
        .await?;
        let surplus = sqlx::query(
            "DELETE FROM webhook_deliveries WHERE delivery_key IN ( \
             SELECT delivery_key FROM webhooks CROSS JOIN webhook_deliveries \
             USING (webhook_key) \
             WHERE status = 'delivered' AND delivery_key < ( \
                 SELECT delivery_key FROM webhook_deliveries AS newer \
                 WHERE newer.webhook_key = webhooks.webhook_key \
                 ORDER BY delivery_key DESC LIMIT 1 OFFSET $1) \
             LIMIT $2)",
        )
        .bind(LISTED - 1)
        .bind(DELETED_AT_ONCE)
        .execute(transaction)
        .await?;
        Ok(deleted.rows_affected() + surplus.rows_affected())
    }
}
