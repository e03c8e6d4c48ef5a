//! Who sees to an alert.

use jiff::Timestamp;
use serde::Serialize;
use sqlx::SqliteConnection;

use super::Store;
use super::audit::{self, Change};
use super::columns::{json_text, micros};
use super::error::StoreError;
use super::handling::{handled_by_id, touch};
use super::request::Request;
use crate::ids::AlertId;
use crate::model::{Actor, AuditAction};

impl Store {
    /// Says who sees to an alert, or that nobody does. False if there is no such alert.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn assign_alert(
        &self,
        alert: AlertId,
        assignee: Option<String>,
        by: &Actor,
        now: Timestamp,
    ) -> Result<bool, StoreError> {
        let assign = Assign {
            alert,
            assignee,
            by: by.clone(),
            now,
        };
        self.work(assign).await
    }
}

/// Says who sees to an alert.
struct Assign {
    alert: AlertId,
    assignee: Option<String>,
    by: Actor,
    now: Timestamp,
}

impl Request for Assign {
    type Outcome = bool;
    const QUEUES_JOBS: bool = false;

    async fn execute(&self, transaction: &mut SqliteConnection) -> Result<bool, StoreError> {
        #[derive(Serialize)]
        struct Assigned<'a> {
            assignee: Option<&'a str>,
        }
        let Some((alert, route)) = handled_by_id(transaction, self.alert).await? else {
            return Ok(false);
        };
        let before: Option<Option<String>> =
            sqlx::query_scalar("SELECT assignee FROM alert_handling WHERE alert_key = $1")
                .bind(alert.alert_key)
                .fetch_optional(&mut *transaction)
                .await?;
        let before = before.flatten();
        if before == self.assignee {
            return Ok(true);
        }
        touch(transaction, &alert, micros(self.now)).await?;
        let assigned_at_us = self.assignee.as_ref().map(|_| micros(self.now));
        sqlx::query(
            "UPDATE alert_handling SET assignee = $1, assigned_at_us = $2 WHERE alert_key = $3",
        )
        .bind(self.assignee.as_deref())
        .bind(assigned_at_us)
        .bind(alert.alert_key)
        .execute(&mut *transaction)
        .await?;
        let text = |assignee: Option<&str>| json_text(&Assigned { assignee });
        let change = Change {
            at: self.now,
            actor: &self.by,
            action: AuditAction::AlertAssigned,
            route_id: Some(&route),
            subject: &self.alert.to_string(),
            before: Some(text(before.as_deref())?),
            after: Some(text(self.assignee.as_deref())?),
        };
        audit::write(transaction, change).await?;
        Ok(true)
    }
}
