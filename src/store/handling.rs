//! What people and zones add to an alert: who sees to it, comments, whether it is muted. None of it is
//! read by the pipeline, and none of it raises the alert's own revision.

use jiff::Timestamp;
use serde::Serialize;
use sqlx::sqlite::SqliteRow;
use sqlx::{Row, SqliteConnection};

use super::audit::{self, Change};
use super::columns::{corrupt, json_text, micros, text, time};
use super::error::StoreError;
use super::request::Request;
use super::webhook_deliveries::{Happened, queue};
use super::withheld::Standing;
use super::{Store, named};
use crate::ids::AlertId;
use crate::model::{Actor, AlertStatus, AuditAction};

/// What is kept in the place of a time for what does not end by itself.
pub(super) const NO_END_US: i64 = i64::MAX;

/// What people and zones have added to an alert.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Handling {
    /// How often it has changed: counted on top of the alert's revision.
    pub changes: i64,
    /// Who sees to it.
    pub assignee: Option<String>,
    /// How many comments there are.
    pub comments: i64,
    /// Whether a zone mutes it.
    pub muted: Option<Muted>,
}

/// That an alert is muted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Muted {
    /// Until then; `None` for as long as the zone is there.
    pub until: Option<Timestamp>,
}

/// What somebody wrote about an alert.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CommentRecord {
    /// In the order of commits.
    pub key: i64,
    /// When.
    pub at: Timestamp,
    /// Who, as they say.
    pub by: String,
    /// What.
    pub text: String,
}

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

    /// Adds a comment to an alert; `None` if there is no such alert.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn comment_on_alert(
        &self,
        alert: AlertId,
        author: String,
        text: String,
        by: &Actor,
        now: Timestamp,
    ) -> Result<Option<CommentRecord>, StoreError> {
        let comment = Comment {
            alert,
            author,
            text,
            by: by.clone(),
            now,
        };
        self.work(comment).await
    }

    /// The comments on an alert, the oldest first, after the one with the key `after`, at most `limit`.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn alert_comments(
        &self,
        alert: AlertId,
        after: i64,
        limit: u32,
    ) -> Result<Vec<CommentRecord>, StoreError> {
        let rows = sqlx::query(
            "SELECT alert_comments.* FROM alerts JOIN alert_comments USING (alert_key) \
             WHERE alerts.id = $1 AND comment_key > $2 ORDER BY comment_key LIMIT $3",
        )
        .bind(alert.to_string())
        .bind(after)
        .bind(limit)
        .fetch_all(&self.shared.readers)
        .await;
        let rows = rows.map_err(StoreError::from);
        named(rows.and_then(|rows| rows.iter().map(comment_of).collect()))
    }
}

fn comment_of(row: &SqliteRow) -> Result<CommentRecord, StoreError> {
    Ok(CommentRecord {
        key: row.try_get("comment_key")?,
        at: time(row, "at_us")?,
        by: row.try_get("by_whom")?,
        text: row.try_get("text")?,
    })
}

/// The handling that was read with an alert.
pub(super) fn handling_of(row: &SqliteRow) -> Result<Handling, StoreError> {
    let changes: Option<i64> = row.try_get("handling_changes")?;
    let comments: Option<i64> = row.try_get("comments")?;
    let muted_until: Option<i64> = row.try_get("muted_until_us")?;
    let muted = muted_until.map(|until| match until {
        NO_END_US => Ok(Muted { until: None }),
        until => Timestamp::from_microsecond(until)
            .map(|until| Muted { until: Some(until) })
            .map_err(|_| corrupt("muted_until_us")),
    });
    Ok(Handling {
        changes: changes.unwrap_or(0),
        assignee: row.try_get("assignee")?,
        comments: comments.unwrap_or(0),
        muted: muted.transpose()?,
    })
}

/// An alert to which something happens.
pub(super) struct Handled {
    pub(super) route_key: i64,
    pub(super) alert_key: i64,
    /// Its own revision.
    pub(super) revision: i64,
    pub(super) confirmed_revision: Option<i64>,
    pub(super) status: AlertStatus,
}

/// What happens to an alert.
#[derive(Clone, Copy)]
pub(super) struct Happening {
    /// Until when zones mute it from now on.
    pub(super) muted_until_us: Option<i64>,
    /// Whether what a decision is about has changed.
    pub(super) is_decision: bool,
    pub(super) at_us: i64,
}

/// Writes that an alert has its next revision, for streams and webhooks.
pub(super) async fn happen(
    transaction: &mut SqliteConnection,
    alert: &Handled,
    happening: Happening,
) -> Result<(), StoreError> {
    let (changes, withheld_from, was_muted): (i64, Option<i64>, bool) =
        row_of(transaction, alert.alert_key).await?;
    let standing = Standing {
        news_from: alert.revision,
        confirmed_revision: alert.confirmed_revision,
        withheld_from,
        was_muted,
        muted: happening.muted_until_us.is_some(),
        pending: alert.status.is_pending(),
        is_decision: happening.is_decision,
    };
    set_mute(transaction, alert.alert_key, happening.muted_until_us).await?;
    let revision = alert.revision + changes;
    tell(transaction, alert, standing, revision, happening.at_us).await
}

/// Writes that somebody has written about an alert, or sees to it: for streams alone.
async fn touch(
    transaction: &mut SqliteConnection,
    alert: &Handled,
    at_us: i64,
) -> Result<(), StoreError> {
    let (.., was_muted): (i64, Option<i64>, bool) = row_of(transaction, alert.alert_key).await?;
    handle(transaction, alert, was_muted, at_us).await
}

/// Mutes an alert until a time, or (`None`) no longer, and writes that for streams and webhooks.
pub(super) async fn mute(
    transaction: &mut SqliteConnection,
    alert: &Handled,
    muted_until_us: Option<i64>,
    at_us: i64,
) -> Result<(), StoreError> {
    let (.., was_muted): (i64, Option<i64>, bool) = row_of(transaction, alert.alert_key).await?;
    set_mute(transaction, alert.alert_key, muted_until_us).await?;
    handle(transaction, alert, was_muted, at_us).await
}

/// Writes that the handling of an alert has changed.
async fn handle(
    transaction: &mut SqliteConnection,
    alert: &Handled,
    was_muted: bool,
    at_us: i64,
) -> Result<(), StoreError> {
    let (changes, withheld_from, muted): (i64, Option<i64>, bool) = sqlx::query_as(
        "INSERT INTO alert_handling (alert_key, changes) VALUES ($1, 1) \
         ON CONFLICT (alert_key) DO UPDATE SET changes = changes + 1 \
         RETURNING changes, withheld_from, muted_until_us IS NOT NULL",
    )
    .bind(alert.alert_key)
    .fetch_one(&mut *transaction)
    .await?;
    let standing = Standing {
        news_from: alert.revision + 1,
        confirmed_revision: alert.confirmed_revision,
        withheld_from,
        was_muted,
        muted,
        pending: alert.status.is_pending(),
        is_decision: false,
    };
    let revision = alert.revision + changes;
    tell(transaction, alert, standing, revision, at_us).await
}

/// How often the handling of an alert has changed, since which revision it is withheld, and whether it is
/// muted.
async fn row_of(
    transaction: &mut SqliteConnection,
    alert_key: i64,
) -> Result<(i64, Option<i64>, bool), StoreError> {
    let row = sqlx::query_as(
        "SELECT changes, withheld_from, muted_until_us IS NOT NULL FROM alert_handling \
         WHERE alert_key = $1",
    )
    .bind(alert_key)
    .fetch_optional(transaction)
    .await?;
    Ok(row.unwrap_or((0, None, false)))
}

/// Notes until when an alert is muted; an alert that never was needs no row.
async fn set_mute(
    transaction: &mut SqliteConnection,
    alert_key: i64,
    muted_until_us: Option<i64>,
) -> Result<(), StoreError> {
    sqlx::query(
        "INSERT INTO alert_handling (alert_key, muted_until_us) SELECT $1, $2 \
         WHERE $2 IS NOT NULL OR EXISTS (SELECT 1 FROM alert_handling WHERE alert_key = $1) \
         ON CONFLICT (alert_key) DO UPDATE SET muted_until_us = excluded.muted_until_us",
    )
    .bind(alert_key)
    .bind(muted_until_us)
    .execute(transaction)
    .await?;
    Ok(())
}

/// Writes an event with the revision that clients see, and queues what webhooks are sent of it.
async fn tell(
    transaction: &mut SqliteConnection,
    alert: &Handled,
    standing: Standing,
    shown_revision: i64,
    at_us: i64,
) -> Result<(), StoreError> {
    let sequence = sqlx::query_scalar(
        "INSERT INTO alert_events (alert_key, revision, at_us, is_decision) VALUES ($1, $2, $3, $4) \
         RETURNING sequence",
    )
    .bind(alert.alert_key)
    .bind(shown_revision)
    .bind(at_us)
    .bind(standing.is_decision)
    .fetch_one(&mut *transaction)
    .await?;
    let sent = standing.sent();
    let happened = Happened {
        route_key: alert.route_key,
        alert_key: alert.alert_key,
        sequence,
        revision: shown_revision,
        event: sent.tentative,
        event_if_confirmed: sent.confirmed,
        at_us,
    };
    queue(transaction, &happened).await?;
    if sent.withheld_from != standing.withheld_from {
        sqlx::query("UPDATE alert_handling SET withheld_from = $1 WHERE alert_key = $2")
            .bind(sent.withheld_from)
            .bind(alert.alert_key)
            .execute(transaction)
            .await?;
    }
    Ok(())
}

/// Counts a route's alerts that wait for a decision: pending, and not muted.
pub(super) async fn count_open(
    transaction: &mut SqliteConnection,
    route_key: i64,
) -> Result<(), StoreError> {
    sqlx::query(
        "UPDATE routes SET open_alerts = (SELECT count(*) FROM alerts \
         WHERE route_key = $1 AND status IN ('open', 'acknowledged') \
         AND NOT EXISTS (SELECT 1 FROM alert_handling AS handling \
             WHERE handling.alert_key = alerts.alert_key AND muted_until_us IS NOT NULL)) \
         WHERE route_key = $1",
    )
    .bind(route_key)
    .execute(transaction)
    .await?;
    Ok(())
}

/// An alert that somebody names, with its route's name.
async fn known(
    transaction: &mut SqliteConnection,
    id: AlertId,
) -> Result<Option<(Handled, String)>, StoreError> {
    let row = sqlx::query(
        "SELECT route_key, alert_key, alerts.revision, confirmed_revision, status, \
         routes.id AS route_id FROM alerts JOIN routes USING (route_key) WHERE alerts.id = $1",
    )
    .bind(id.to_string())
    .fetch_optional(transaction)
    .await?;
    let known = row.map(|row| Ok((handled_of(&row)?, row.try_get("route_id")?)));
    known.transpose()
}

/// An alert of a row with its key, its revisions and its status.
pub(super) fn handled_of(row: &SqliteRow) -> Result<Handled, StoreError> {
    Ok(Handled {
        route_key: row.try_get("route_key")?,
        alert_key: row.try_get("alert_key")?,
        revision: row.try_get("revision")?,
        confirmed_revision: row.try_get("confirmed_revision")?,
        status: text(row, "status")?,
    })
}

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
        let Some((alert, route)) = known(transaction, self.alert).await? else {
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
        sqlx::query("UPDATE alert_handling SET assignee = $1 WHERE alert_key = $2")
            .bind(self.assignee.as_deref())
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

struct Comment {
    alert: AlertId,
    author: String,
    text: String,
    by: Actor,
    now: Timestamp,
}

impl Request for Comment {
    type Outcome = Option<CommentRecord>;
    const QUEUES_JOBS: bool = false;

    async fn execute(
        &self,
        transaction: &mut SqliteConnection,
    ) -> Result<Option<CommentRecord>, StoreError> {
        #[derive(Serialize)]
        struct Commented<'a> {
            by: &'a str,
            text: &'a str,
        }
        let Some((alert, route)) = known(transaction, self.alert).await? else {
            return Ok(None);
        };
        touch(transaction, &alert, micros(self.now)).await?;
        sqlx::query("UPDATE alert_handling SET comments = comments + 1 WHERE alert_key = $1")
            .bind(alert.alert_key)
            .execute(&mut *transaction)
            .await?;
        let row = sqlx::query(
            "INSERT INTO alert_comments (alert_key, at_us, by_whom, text) VALUES ($1, $2, $3, $4) \
             RETURNING comment_key, at_us, by_whom, text",
        )
        .bind(alert.alert_key)
        .bind(micros(self.now))
        .bind(&self.author)
        .bind(&self.text)
        .fetch_one(&mut *transaction)
        .await?;
        let after = Commented {
            by: &self.author,
            text: &self.text,
        };
        let change = Change {
            at: self.now,
            actor: &self.by,
            action: AuditAction::AlertCommented,
            route_id: Some(&route),
            subject: &self.alert.to_string(),
            before: None,
            after: Some(json_text(&after)?),
        };
        audit::write(transaction, change).await?;
        Ok(Some(comment_of(&row)?))
    }
}
