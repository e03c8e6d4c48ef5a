//! Webhooks: registered, changed, deleted, read.

use jiff::Timestamp;
use sqlx::sqlite::SqliteRow;
use sqlx::{Row, SqliteConnection};

use super::columns::{corrupt, json, json_text, micros, name, optional_time, time, value_of};
use super::error::StoreError;
use super::query::Query;
use super::request::Request;
use super::webhook_records::{
    Edited, NewWebhook, Registered, WEBHOOKS_MAX, WebhookRecord, WebhookUpdate,
};
use super::{Store, webhook_audit};
use crate::ids::{RouteId, WebhookId};
use crate::model::{Actor, WebhookTopic};

impl Store {
    /// Registers a webhook. It is sent what happens from now on.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn register_webhook(
        &self,
        webhook: NewWebhook,
        by: &Actor,
    ) -> Result<Registered, StoreError> {
        let by = by.clone();
        self.work(Register { webhook, by }).await
    }

    /// Changes a webhook, if it is still at `revision` where one is given.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn update_webhook(
        &self,
        id: WebhookId,
        revision: Option<i64>,
        update: WebhookUpdate,
        by: &Actor,
        now: Timestamp,
    ) -> Result<Edited, StoreError> {
        let request = Update {
            id,
            revision,
            update,
            by: by.clone(),
            now,
        };
        self.work(request).await
    }

    /// Deletes a webhook with its deliveries, if it is still at `revision` where one is given.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn delete_webhook(
        &self,
        id: WebhookId,
        revision: Option<i64>,
        by: &Actor,
        now: Timestamp,
    ) -> Result<Edited, StoreError> {
        let request = Delete {
            id,
            revision,
            by: by.clone(),
            now,
        };
        self.work(request).await
    }

    /// One webhook.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn webhook(&self, id: WebhookId) -> Result<Option<WebhookRecord>, StoreError> {
        self.read(OneWebhook(id)).await
    }

    /// By id, that is the oldest first, after `after`, at most `limit`.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn webhooks(
        &self,
        after: Option<WebhookId>,
        limit: u32,
    ) -> Result<Vec<WebhookRecord>, StoreError> {
        let page = WebhookPage {
            among: None,
            after,
            limit,
        };
        self.read(page).await
    }

    /// Of the webhooks that are limited to one of some routes, a page like that of [`Store::webhooks`].
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn webhooks_among(
        &self,
        routes: &[RouteId],
        after: Option<WebhookId>,
        limit: u32,
    ) -> Result<Vec<WebhookRecord>, StoreError> {
        let page = WebhookPage {
            among: Some(routes),
            after,
            limit,
        };
        self.read(page).await
    }
}

struct Register {
    webhook: NewWebhook,
    by: Actor,
}

impl Request for Register {
    type Outcome = Registered;
    const QUEUES_JOBS: bool = false;

    async fn execute(&self, transaction: &mut SqliteConnection) -> Result<Registered, StoreError> {
        let webhook = &self.webhook;
        let count: u32 = sqlx::query_scalar("SELECT count(*) FROM webhooks")
            .fetch_one(&mut *transaction)
            .await?;
        if count >= WEBHOOKS_MAX {
            return Ok(Registered::TooMany);
        }
        let route = webhook.route_id.as_ref().map(|route| route.as_str());
        let inserted = sqlx::query(
            "INSERT INTO webhooks (id, revision, url, secret, events, route_key, description, \
             active, created_at_us, updated_at_us, include_tentative) \
             SELECT $1, 1, $2, $3, $4, (SELECT route_key FROM routes WHERE id = $5), $6, 1, $7, \
             $7, $8 WHERE $5 IS NULL OR EXISTS (SELECT 1 FROM routes WHERE id = $5)",
        )
        .bind(webhook.id.to_string())
        .bind(&webhook.url)
        .bind(webhook.secret.0.as_slice())
        .bind(events_text(&webhook.events)?)
        .bind(route)
        .bind(webhook.description.as_deref())
        .bind(micros(webhook.created_at))
        .bind(webhook.include_tentative)
        .execute(&mut *transaction)
        .await?;
        if inserted.rows_affected() == 0 {
            return Ok(Registered::UnknownRoute);
        }
        note(transaction, webhook.id, None, &self.by, webhook.created_at).await?;
        Ok(Registered::Created)
    }
}

struct Update {
    id: WebhookId,
    revision: Option<i64>,
    update: WebhookUpdate,
    by: Actor,
    now: Timestamp,
}

impl Request for Update {
    type Outcome = Edited;
    const QUEUES_JOBS: bool = false;

    async fn execute(&self, transaction: &mut SqliteConnection) -> Result<Edited, StoreError> {
        let update = &self.update;
        let Some(before) = OneWebhook(self.id).answer(transaction).await? else {
            return Ok(Edited::Unknown);
        };
        let events = update.events.as_deref().map(events_text).transpose()?;
        let changed = sqlx::query(
            "UPDATE webhooks SET revision = revision + 1, url = coalesce($3, url), \
             events = coalesce($4, events), description = coalesce($5, description), \
             active = coalesce($6, active), \
             include_tentative = coalesce($8, include_tentative), \
             gone_at_us = CASE WHEN $6 = 1 THEN NULL ELSE gone_at_us END, updated_at_us = $7 \
             WHERE id = $1 AND ($2 IS NULL OR revision = $2)",
        )
        .bind(self.id.to_string())
        .bind(self.revision)
        .bind(update.url.as_deref())
        .bind(events)
        .bind(update.description.as_deref())
        .bind(update.active)
        .bind(micros(self.now))
        .bind(update.include_tentative)
        .execute(&mut *transaction)
        .await?;
        if changed.rows_affected() == 0 {
            return Ok(Edited::Stale);
        }
        note(transaction, self.id, Some(&before), &self.by, self.now).await?;
        Ok(Edited::Done)
    }
}

struct Delete {
    id: WebhookId,
    revision: Option<i64>,
    by: Actor,
    now: Timestamp,
}

impl Request for Delete {
    type Outcome = Edited;
    const QUEUES_JOBS: bool = false;
    const WHILE_FULL: bool = true;

    async fn execute(&self, transaction: &mut SqliteConnection) -> Result<Edited, StoreError> {
        let Some(before) = OneWebhook(self.id).answer(transaction).await? else {
            return Ok(Edited::Unknown);
        };
        let deleted =
            sqlx::query("DELETE FROM webhooks WHERE id = $1 AND ($2 IS NULL OR revision = $2)")
                .bind(self.id.to_string())
                .bind(self.revision)
                .execute(&mut *transaction)
                .await?;
        if deleted.rows_affected() == 0 {
            return Ok(Edited::Stale);
        }
        webhook_audit::note(transaction, Some(&before), None, &self.by, self.now).await?;
        Ok(Edited::Done)
    }
}

/// Writes the audit's row of a webhook that is there.
pub(super) async fn note(
    transaction: &mut SqliteConnection,
    id: WebhookId,
    before: Option<&WebhookRecord>,
    by: &Actor,
    at: Timestamp,
) -> Result<(), StoreError> {
    let after = OneWebhook(id).answer(transaction).await?;
    webhook_audit::note(transaction, before, after.as_ref(), by, at).await
}

macro_rules! select_webhooks {
    ($rest:literal) => {
        concat!(
            "SELECT webhooks.id, webhooks.revision, url, events, routes.id AS route_id, \
             description, include_tentative, active, gone_at_us, previous_secret_until_us, \
             webhooks.created_at_us, webhooks.updated_at_us \
             FROM webhooks LEFT JOIN routes USING (route_key) ",
            $rest
        )
    };
}

/// One webhook.
pub(super) struct OneWebhook(pub(super) WebhookId);

impl Query for OneWebhook {
    type Answer = Option<WebhookRecord>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let row = sqlx::query(select_webhooks!("WHERE webhooks.id = $1"))
            .bind(self.0.to_string())
            .fetch_optional(reader)
            .await?;
        row.as_ref().map(webhook_of).transpose()
    }
}

/// The webhooks that are limited to one route, and deleted with it.
pub(super) struct RouteWebhooks<'a>(pub(super) &'a RouteId);

impl Query for RouteWebhooks<'_> {
    type Answer = Vec<WebhookRecord>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let rows = sqlx::query(select_webhooks!(
            "WHERE routes.id = $1 ORDER BY webhooks.id"
        ))
        .bind(self.0.as_str())
        .fetch_all(reader)
        .await?;
        rows.iter().map(webhook_of).collect()
    }
}

/// Webhooks by id, after `after`: all, or those that are limited to one of some routes.
struct WebhookPage<'a> {
    among: Option<&'a [RouteId]>,
    after: Option<WebhookId>,
    limit: u32,
}

impl Query for WebhookPage<'_> {
    type Answer = Vec<WebhookRecord>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let rows = sqlx::query(select_webhooks!(
            "WHERE webhooks.id > $1 \
             AND ($3 IS NULL OR routes.id IN (SELECT value FROM json_each($3))) \
             ORDER BY webhooks.id LIMIT $2"
        ))
        .bind(self.after.map_or_else(String::new, |id| id.to_string()))
        .bind(self.limit)
        .bind(self.among.map(json_text).transpose()?)
        .fetch_all(reader)
        .await?;
        rows.iter().map(webhook_of).collect()
    }
}

fn webhook_of(row: &SqliteRow) -> Result<WebhookRecord, StoreError> {
    let route: Option<&str> = row.try_get("route_id")?;
    let route_id = match route {
        Some(_) => Some(name(row, "route_id")?),
        None => None,
    };
    Ok(WebhookRecord {
        id: webhook_id(row, "id")?,
        revision: row.try_get("revision")?,
        url: row.try_get("url")?,
        events: parse_events(row)?,
        route_id,
        description: row.try_get("description")?,
        include_tentative: row.try_get("include_tentative")?,
        active: row.try_get("active")?,
        gone_at: optional_time(row, "gone_at_us")?,
        previous_secret_until: optional_time(row, "previous_secret_until_us")?,
        created_at: time(row, "created_at_us")?,
        updated_at: time(row, "updated_at_us")?,
    })
}

/// A webhook id's column.
pub(super) fn webhook_id(row: &SqliteRow, column: &'static str) -> Result<WebhookId, StoreError> {
    let text: &str = row.try_get(column)?;
    text.parse().map_err(|_| corrupt(column))
}

fn events_text(events: &[WebhookTopic]) -> Result<String, StoreError> {
    let names: Vec<&str> = events.iter().map(|event| event.name()).collect();
    json_text(&names)
}

fn parse_events(row: &SqliteRow) -> Result<Vec<WebhookTopic>, StoreError> {
    let names: Vec<String> = json(row, "events")?;
    names.iter().map(|name| value_of(name, "events")).collect()
}
