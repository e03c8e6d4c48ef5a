//! What happened to alerts, in the order of commits.

use sqlx::sqlite::SqliteRow;
use sqlx::{Row, SqliteConnection};

use super::Store;
use super::alert_records::AlertEvent;
use super::columns::{alert_id, time};
use super::error::StoreError;
use super::query::Query;
use crate::ids::RouteId;

impl Store {
    /// What happened to alerts after the event `after` (0 for the first), in order, at most
    /// `limit`; of one route, or of all.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn alert_events(
        &self,
        route: Option<&RouteId>,
        after: i64,
        limit: u32,
    ) -> Result<Vec<AlertEvent>, StoreError> {
        let events = AlertEvents {
            route,
            after,
            limit,
        };
        self.read(events).await
    }

    /// The sequence of the last event; 0 before the first.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn last_alert_event(&self) -> Result<i64, StoreError> {
        self.read(LastAlertEvent).await
    }
}

/// What happened to alerts after the event `after`, in order; of one route, or of all.
struct AlertEvents<'a> {
    route: Option<&'a RouteId>,
    after: i64,
    limit: u32,
}

impl Query for AlertEvents<'_> {
    type Answer = Vec<AlertEvent>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let rows = sqlx::query(
            "SELECT sequence, alerts.id, alert_events.revision, at_us, is_decision \
             FROM alert_events JOIN alerts USING (alert_key) JOIN routes USING (route_key) \
             WHERE sequence > $1 AND ($2 IS NULL OR routes.id = $2) ORDER BY sequence LIMIT $3",
        )
        .bind(self.after)
        .bind(self.route.map(RouteId::as_str))
        .bind(self.limit)
        .fetch_all(reader)
        .await?;
        rows.iter().map(alert_event_of).collect()
    }
}

fn alert_event_of(row: &SqliteRow) -> Result<AlertEvent, StoreError> {
    Ok(AlertEvent {
        sequence: row.try_get("sequence")?,
        alert_id: alert_id(row, "id")?,
        revision: row.try_get("revision")?,
        at: time(row, "at_us")?,
        is_decision: row.try_get("is_decision")?,
    })
}

/// The sequence of the last event; 0 before the first.
struct LastAlertEvent;

impl Query for LastAlertEvent {
    type Answer = i64;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let last = sqlx::query_scalar("SELECT coalesce(max(sequence), 0) FROM alert_events");
        Ok(last.fetch_one(reader).await?)
    }
}
