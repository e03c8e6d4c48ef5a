//! Comments on alerts.

use jiff::Timestamp;
use serde::Serialize;
use sqlx::sqlite::SqliteRow;
use sqlx::{Row, SqliteConnection};

use super::Store;
use super::audit::{self, Change};
use super::columns::{json_text, micros, time};
use super::error::StoreError;
use super::handling::{handled_by_id, touch};
use super::query::Query;
use super::request::Request;
use crate::ids::AlertId;
use crate::model::{Actor, AuditAction};

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
        let page = CommentPage {
            alert,
            after,
            limit,
        };
        self.read(page).await
    }
}

/// The comments on an alert, the oldest first, after the one with the key `after`, at most `limit`.
struct CommentPage {
    alert: AlertId,
    after: i64,
    limit: u32,
}

impl Query for CommentPage {
    type Answer = Vec<CommentRecord>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let rows = sqlx::query(
            "SELECT alert_comments.* FROM alerts JOIN alert_comments USING (alert_key) \
             WHERE alerts.id = $1 AND comment_key > $2 ORDER BY comment_key LIMIT $3",
        )
        .bind(self.alert.to_string())
        .bind(self.after)
        .bind(self.limit)
        .fetch_all(reader)
        .await?;
        rows.iter().map(comment_of).collect()
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

/// Adds a comment to an alert.
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
        let Some((alert, route)) = handled_by_id(transaction, self.alert).await? else {
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
