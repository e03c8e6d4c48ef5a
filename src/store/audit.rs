//! The audit: who changed what, when, and from where. A change and its row are written in one
//! transaction: there is neither without the other.

use jiff::Timestamp;
use serde_json::Value;
use sqlx::sqlite::SqliteRow;
use sqlx::{QueryBuilder, Row, Sqlite, SqliteConnection};

use super::Store;
use super::columns::{corrupt, json_text, micros, optional_json, optional_name, text, time};
use super::error::StoreError;
use super::query::Query;
use crate::ids::RouteId;
use crate::model::{Actor, AuditAction};

/// A change that was made.
#[derive(Debug, Clone, PartialEq)]
pub struct AuditRecord {
    /// In the order of commits.
    pub key: i64,
    /// When.
    pub at: Timestamp,
    /// Who, and from where.
    pub actor: Actor,
    /// What was done.
    pub action: AuditAction,
    /// The route, which may be gone; `None` for what is about all routes.
    pub route_id: Option<RouteId>,
    /// What was changed: the name of a route, a batch or a vehicle, the id of an alert, a webhook, an
    /// operation.
    pub subject: String,
    /// What was there before; `None` for what is new.
    pub before: Option<Value>,
    /// What is there after it; `None` for what was deleted.
    pub after: Option<Value>,
}

/// Which changes to list; every condition that is given holds.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct AuditFilter {
    /// Of this route.
    pub route_id: Option<RouteId>,
    /// Of one of these routes.
    pub among: Option<Vec<RouteId>>,
    /// Of this kind.
    pub action: Option<AuditAction>,
    /// Made at this time or later.
    pub since: Option<Timestamp>,
    /// Made before this time.
    pub until: Option<Timestamp>,
}

impl Store {
    /// Changes, the newest first, those before the one with the key `before`, at most `limit`.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn audit_page(
        &self,
        filter: &AuditFilter,
        before: Option<i64>,
        limit: u32,
    ) -> Result<Vec<AuditRecord>, StoreError> {
        let page = AuditPage {
            filter,
            before,
            limit,
        };
        self.read(page).await
    }
}

/// A change that is being made.
pub(super) struct Change<'a> {
    /// When.
    pub(super) at: Timestamp,
    /// Who, and from where.
    pub(super) actor: &'a Actor,
    /// What is done.
    pub(super) action: AuditAction,
    /// The route's name.
    pub(super) route_id: Option<&'a str>,
    /// What is changed.
    pub(super) subject: &'a str,
    /// What was there before, as JSON without secrets.
    pub(super) before: Option<String>,
    /// What is there after it, as JSON without secrets.
    pub(super) after: Option<String>,
}

/// Writes the row of a change in the transaction that makes it.
pub(super) async fn write(
    transaction: &mut SqliteConnection,
    change: Change<'_>,
) -> Result<(), StoreError> {
    sqlx::query(
        "INSERT INTO audit (at_us, actor, address, key_id, action, route_id, subject, before, after) \
         VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9)",
    )
    .bind(micros(change.at))
    .bind(change.actor.name())
    .bind(change.actor.address())
    .bind(change.actor.key().map(|key| key.to_string()))
    .bind(change.action.name())
    .bind(change.route_id)
    .bind(change.subject)
    .bind(change.before)
    .bind(change.after)
    .execute(transaction)
    .await?;
    Ok(())
}

/// Changes, the newest first, those before the one with the key `before`, at most `limit`.
struct AuditPage<'a> {
    filter: &'a AuditFilter,
    before: Option<i64>,
    limit: u32,
}

impl Query for AuditPage<'_> {
    type Answer = Vec<AuditRecord>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let mut query = QueryBuilder::<Sqlite>::new("SELECT * FROM audit WHERE TRUE");
        if let Some(before) = self.before {
            query.push(
                " AND (at_us, audit_key) < \
                 (SELECT last.at_us, last.audit_key FROM audit AS last WHERE last.audit_key = ",
            );
            query.push_bind(before).push(")");
        }
        self.filter.push_to(&mut query)?;
        query
            .push(" ORDER BY at_us DESC, audit_key DESC LIMIT ")
            .push_bind(self.limit);
        let rows = query.build().fetch_all(reader).await?;
        rows.iter().map(change_of).collect()
    }
}

impl AuditFilter {
    /// Adds what it asks of a change. A condition is there only if it is asked for: SQLite chooses an
    /// index only for a condition that is there.
    fn push_to(&self, query: &mut QueryBuilder<Sqlite>) -> Result<(), StoreError> {
        if let Some(route) = &self.route_id {
            query.push(" AND route_id = ").push_bind(route.as_str());
        }
        if let Some(routes) = &self.among {
            query.push(" AND route_id IN (SELECT value FROM json_each(");
            query.push_bind(json_text(routes)?).push("))");
        }
        if let Some(action) = self.action {
            query.push(" AND action = ").push_bind(action.name());
        }
        if let Some(since) = self.since {
            query.push(" AND at_us >= ").push_bind(micros(since));
        }
        if let Some(until) = self.until {
            query.push(" AND at_us < ").push_bind(micros(until));
        }
        Ok(())
    }
}

fn change_of(row: &SqliteRow) -> Result<AuditRecord, StoreError> {
    let key: Option<&str> = row.try_get("key_id")?;
    let key = key.map(str::parse).transpose();
    let key = key.map_err(|_| corrupt("key_id"))?;
    let actor = Actor::of(row.try_get("actor")?, row.try_get("address")?, key);
    Ok(AuditRecord {
        key: row.try_get("audit_key")?,
        at: time(row, "at_us")?,
        actor: actor.ok_or_else(|| corrupt("actor"))?,
        action: text(row, "action")?,
        route_id: optional_name(row, "route_id")?,
        subject: row.try_get("subject")?,
        before: optional_json(row, "before")?,
        after: optional_json(row, "after")?,
    })
}
