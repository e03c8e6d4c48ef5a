//! Deliveries of events to webhooks: queued in the transaction of the change, and read.

use jiff::Timestamp;
use sqlx::sqlite::SqliteRow;
use sqlx::{Row, SqliteConnection};

use super::Store;
use super::columns::{alert_id, corrupt, micros, name, optional_time, text, time, value_of};
use super::error::StoreError;
use super::query::Query;
use super::request::Request;
use super::webhook_records::{
    AttemptEnd, DeliveryRecord, NextDelivery, Subject, TestQueued, WebhookSecret,
};
use super::webhooks::webhook_id;
use crate::ids::WebhookId;
use crate::model::{AlertEventKind, WebhookEvent, WebhookTopic};

impl Store {
    /// Queues a test of an active webhook; if one waits already, returns that one.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn queue_webhook_test(
        &self,
        webhook: WebhookId,
        now: Timestamp,
    ) -> Result<TestQueued, StoreError> {
        self.work(QueueTest { webhook, now }).await
    }

    /// What is sent next to each active webhook that something waits for, whether it is due
    /// already or not.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn next_deliveries(&self) -> Result<Vec<NextDelivery>, StoreError> {
        self.read(NextDeliveries).await
    }

    /// The deliveries of a webhook, the newest first, queued before the one with the key
    /// `before`, at most `limit`.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn deliveries(
        &self,
        webhook: WebhookId,
        before: Option<i64>,
        limit: u32,
    ) -> Result<Vec<DeliveryRecord>, StoreError> {
        let page = DeliveryPage {
            webhook,
            before,
            limit,
        };
        self.read(page).await
    }
}

/// An event of an alert, as it is written to `alert_events`.
pub(super) struct Happened {
    pub(super) route_key: i64,
    pub(super) alert_key: i64,
    pub(super) sequence: i64,
    /// The revision of the alert after it, as clients see it.
    pub(super) revision: i64,
    /// What it is to a webhook that is sent tentative alerts as well; `None` if it is sent nothing.
    pub(super) event: Option<AlertEventKind>,
    /// What it is to a webhook for which an alert begins when it is confirmed: nothing before that. An
    /// alert that was confirmed once goes on being sent, also if it is tentative again.
    pub(super) event_if_confirmed: Option<AlertEventKind>,
    pub(super) at_us: i64,
}

/// Queues a delivery for every active webhook that subscribes to it.
pub(super) async fn queue(
    transaction: &mut SqliteConnection,
    happened: &Happened,
) -> Result<(), StoreError> {
    sqlx::query(
        "INSERT INTO webhook_deliveries (webhook_key, id, event, event_sequence, alert_key, \
         alert_revision, at_us, status, attempts, next_attempt_at_us) \
         SELECT webhook_key, 'msg_' || lower(hex(randomblob(16))), happened, $2, $3, $6, $4, \
         'pending', 0, $4 \
         FROM (SELECT webhook_key, events, iif(include_tentative, $1, $7) AS happened \
             FROM webhooks WHERE active = 1 AND (route_key IS NULL OR route_key = $5)) \
         WHERE happened IS NOT NULL \
         AND EXISTS (SELECT 1 FROM json_each(events) WHERE value = happened) ORDER BY webhook_key",
    )
    .bind(happened.event.map(AlertEventKind::name))
    .bind(happened.sequence)
    .bind(happened.alert_key)
    .bind(happened.at_us)
    .bind(happened.route_key)
    .bind(happened.revision)
    .bind(happened.event_if_confirmed.map(AlertEventKind::name))
    .execute(transaction)
    .await?;
    Ok(())
}

macro_rules! select_deliveries {
    ($rest:literal) => {
        concat!(
            "SELECT webhook_deliveries.*, alerts.id AS alert_id, routes.id AS route_id \
             FROM webhook_deliveries JOIN webhooks USING (webhook_key) \
             LEFT JOIN alerts USING (alert_key) \
             LEFT JOIN routes ON routes.route_key = webhook_deliveries.route_key ",
            $rest
        )
    };
}

struct QueueTest {
    webhook: WebhookId,
    now: Timestamp,
}

impl Request for QueueTest {
    type Outcome = TestQueued;
    const QUEUES_JOBS: bool = false;

    async fn execute(&self, transaction: &mut SqliteConnection) -> Result<TestQueued, StoreError> {
        let active: Option<bool> = sqlx::query_scalar("SELECT active FROM webhooks WHERE id = $1")
            .bind(self.webhook.to_string())
            .fetch_optional(&mut *transaction)
            .await?;
        match active {
            None => return Ok(TestQueued::Unknown),
            Some(false) => return Ok(TestQueued::Disabled),
            Some(true) => {}
        }
        if let Some(waiting) = self.waiting(transaction).await? {
            return Ok(TestQueued::Queued(waiting));
        }
        sqlx::query(
            "INSERT INTO webhook_deliveries (webhook_key, id, event, at_us, status, attempts, \
             next_attempt_at_us) SELECT webhook_key, 'msg_' || lower(hex(randomblob(16))), \
             'webhook.test', $2, 'pending', 0, $2 FROM webhooks WHERE id = $1",
        )
        .bind(self.webhook.to_string())
        .bind(micros(self.now))
        .execute(&mut *transaction)
        .await?;
        let queued = self.waiting(transaction).await?;
        queued
            .map(TestQueued::Queued)
            .ok_or_else(|| corrupt("webhook_deliveries"))
    }
}

impl QueueTest {
    async fn waiting(
        &self,
        transaction: &mut SqliteConnection,
    ) -> Result<Option<DeliveryRecord>, StoreError> {
        let row = sqlx::query(select_deliveries!(
            "WHERE delivery_key IN (SELECT delivery_key \
             FROM webhook_deliveries INDEXED BY webhook_deliveries_pending \
             WHERE status = 'pending' AND event = 'webhook.test' AND webhook_key = \
             (SELECT webhook_key FROM webhooks WHERE id = $1))"
        ))
        .bind(self.webhook.to_string())
        .fetch_optional(transaction)
        .await?;
        row.as_ref().map(delivery_of).transpose()
    }
}

/// What is sent next to each active webhook.
struct NextDeliveries;

impl Query for NextDeliveries {
    type Answer = Vec<NextDelivery>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let rows = sqlx::query(
            "SELECT delivery.delivery_key, delivery.id, webhooks.id AS webhook_id, \
             webhooks.revision, url, secret, previous_secret, previous_secret_until_us, event, \
             alerts.id AS alert_id, routes.id AS route_id, subject, at_us, attempts, \
             next_attempt_at_us FROM webhooks JOIN webhook_deliveries AS delivery \
             ON delivery.delivery_key = ( \
                 SELECT delivery_key FROM webhook_deliveries AS pending \
                 WHERE pending.webhook_key = webhooks.webhook_key AND pending.status = 'pending' \
                 ORDER BY next_attempt_at_us, delivery_key LIMIT 1) \
             LEFT JOIN alerts USING (alert_key) \
             LEFT JOIN routes ON routes.route_key = delivery.route_key \
             WHERE webhooks.active = 1 ORDER BY next_attempt_at_us, delivery_key",
        )
        .fetch_all(reader)
        .await?;
        rows.iter().map(next_of).collect()
    }
}

/// The deliveries of a webhook, the newest first, queued before `before`.
struct DeliveryPage {
    webhook: WebhookId,
    before: Option<i64>,
    limit: u32,
}

impl Query for DeliveryPage {
    type Answer = Vec<DeliveryRecord>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let rows = sqlx::query(select_deliveries!(
            "WHERE webhooks.id = $1 AND delivery_key < $2 ORDER BY delivery_key DESC LIMIT $3"
        ))
        .bind(self.webhook.to_string())
        .bind(self.before.unwrap_or(i64::MAX))
        .bind(self.limit)
        .fetch_all(reader)
        .await?;
        rows.iter().map(delivery_of).collect()
    }
}

fn next_of(row: &SqliteRow) -> Result<NextDelivery, StoreError> {
    let event = text(row, "event")?;
    let until = optional_time(row, "previous_secret_until_us")?;
    let previous_secret = match until {
        None => None,
        Some(until) => Some((secret(row, "previous_secret")?, until)),
    };
    Ok(NextDelivery {
        key: row.try_get("delivery_key")?,
        id: row.try_get("id")?,
        webhook_id: webhook_id(row, "webhook_id")?,
        webhook_revision: row.try_get("revision")?,
        url: row.try_get("url")?,
        secret: secret(row, "secret")?,
        previous_secret,
        event,
        subject: subject_of(row, event)?,
        at: time(row, "at_us")?,
        attempts: row.try_get("attempts")?,
        due_at: time(row, "next_attempt_at_us")?,
    })
}

fn delivery_of(row: &SqliteRow) -> Result<DeliveryRecord, StoreError> {
    let event = text(row, "event")?;
    Ok(DeliveryRecord {
        key: row.try_get("delivery_key")?,
        id: row.try_get("id")?,
        event,
        event_sequence: row.try_get("event_sequence")?,
        subject: subject_of(row, event)?,
        at: time(row, "at_us")?,
        status: text(row, "status")?,
        attempts: row.try_get("attempts")?,
        attempted_at: optional_time(row, "attempted_at_us")?,
        next_attempt_at: optional_time(row, "next_attempt_at_us")?,
        last_end: last_end_of(row)?,
    })
}

fn last_end_of(row: &SqliteRow) -> Result<Option<AttemptEnd>, StoreError> {
    let answer: Option<u16> = row.try_get("answer_status")?;
    if let Some(status) = answer {
        return Ok(Some(AttemptEnd::Answer(status)));
    }
    let failure: Option<&str> = row.try_get("failure")?;
    let failure = failure.map(|text| value_of(text, "failure"));
    Ok(failure.transpose()?.map(AttemptEnd::Failure))
}

fn subject_of(row: &SqliteRow, event: WebhookEvent) -> Result<Option<Subject>, StoreError> {
    let WebhookEvent::Topic(topic) = event else {
        return Ok(None);
    };
    Ok(Some(match topic {
        WebhookTopic::AlertRaised | WebhookTopic::AlertUpdated => {
            Subject::Alert(alert_id(row, "alert_id")?)
        }
        WebhookTopic::BatchQuarantined => {
            Subject::Batch(name(row, "route_id")?, name(row, "subject")?)
        }
        WebhookTopic::VehicleSuspect => {
            Subject::Vehicle(name(row, "route_id")?, name(row, "subject")?)
        }
        WebhookTopic::OperationFinished => {
            let id: &str = row.try_get("subject")?;
            Subject::Operation(id.parse().map_err(|_| corrupt("subject"))?)
        }
    }))
}

fn secret(row: &SqliteRow, column: &'static str) -> Result<WebhookSecret, StoreError> {
    let key: &[u8] = row.try_get(column)?;
    let key = key.try_into().map_err(|_| corrupt(column))?;
    Ok(WebhookSecret(key))
}
