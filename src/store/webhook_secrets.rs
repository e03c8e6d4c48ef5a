//! Rotation of webhooks' secrets: for a time calls are signed with both the old and the new one.

use jiff::Timestamp;
use sqlx::SqliteConnection;

use super::Store;
use super::columns::micros;
use super::error::StoreError;
use super::query::Query;
use super::request::Request;
use super::webhook_audit::note_rotation;
use super::webhook_records::{Edited, NewSecret};
use super::webhooks::OneWebhook;
use crate::ids::WebhookId;
use crate::model::Actor;

impl Store {
    /// Replaces a webhook's secret, if the webhook is still at `revision` where one is given. Until the
    /// end of the overlap calls are signed with the previous secret as well, and with no older one.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn rotate_webhook_secret(
        &self,
        id: WebhookId,
        revision: Option<i64>,
        secret: NewSecret,
        by: &Actor,
        now: Timestamp,
    ) -> Result<Edited, StoreError> {
        let request = Rotate {
            id,
            revision,
            secret,
            by: by.clone(),
            now,
        };
        self.work(request).await
    }

    /// Deletes previous secrets whose overlap is over.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn delete_previous_secrets(&self, now: Timestamp) -> Result<(), StoreError> {
        match self.read(HasEndedSecrets(now)).await? {
            true => self.work(DeletePrevious(now)).await,
            false => Ok(()),
        }
    }
}

/// Whether there are previous secrets whose overlap is over.
struct HasEndedSecrets(Timestamp);

impl Query for HasEndedSecrets {
    type Answer = bool;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let has_ended = sqlx::query_scalar(
            "SELECT EXISTS (SELECT 1 FROM webhooks WHERE previous_secret_until_us <= $1)",
        )
        .bind(micros(self.0))
        .fetch_one(reader)
        .await?;
        Ok(has_ended)
    }
}

struct Rotate {
    id: WebhookId,
    revision: Option<i64>,
    secret: NewSecret,
    by: Actor,
    now: Timestamp,
}

impl Request for Rotate {
    type Outcome = Edited;
    const QUEUES_JOBS: bool = false;

    async fn execute(&self, transaction: &mut SqliteConnection) -> Result<Edited, StoreError> {
        let Some(before) = OneWebhook(self.id).answer(transaction).await? else {
            return Ok(Edited::Unknown);
        };
        let until = self.secret.previous_until;
        let rotated = sqlx::query(
            "UPDATE webhooks SET revision = revision + 1, updated_at_us = $5, secret = $3, \
             previous_secret = iif($4 IS NULL, NULL, secret), previous_secret_until_us = $4 \
             WHERE id = $1 AND ($2 IS NULL OR revision = $2)",
        )
        .bind(self.id.to_string())
        .bind(self.revision)
        .bind(self.secret.secret.0.as_slice())
        .bind(until.map(micros))
        .bind(micros(self.now))
        .execute(&mut *transaction)
        .await?;
        if rotated.rows_affected() == 0 {
            return Ok(Edited::Stale);
        }
        if let Some(after) = OneWebhook(self.id).answer(transaction).await? {
            note_rotation(transaction, &before, &after, &self.by, self.now).await?;
        }
        Ok(Edited::Done)
    }
}

struct DeletePrevious(Timestamp);

impl Request for DeletePrevious {
    type Outcome = ();
    const QUEUES_JOBS: bool = false;
    const WHILE_FULL: bool = true;

    async fn execute(&self, transaction: &mut SqliteConnection) -> Result<(), StoreError> {
        sqlx::query(
            "UPDATE webhooks SET previous_secret = NULL, previous_secret_until_us = NULL \
             WHERE previous_secret_until_us <= $1",
        )
        .bind(micros(self.0))
        .execute(transaction)
        .await?;
        Ok(())
    }
}
