//! Reading alerts.

use std::collections::BTreeMap;

use sqlx::{QueryBuilder, Sqlite, SqliteConnection};

use super::Store;
use super::alert_columns::alert_of;
use super::alert_records::{AlertFilter, AlertRecord, ReportScope};
use super::columns::{alert_id, json_text, micros, name};
use super::error::StoreError;
use super::query::Query;
use crate::change::PendingChange;
use crate::ids::{AlertId, BatchId, RouteId};

impl Store {
    /// One alert.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn alert(&self, id: AlertId) -> Result<Option<AlertRecord>, StoreError> {
        self.read(OneAlert(id)).await
    }

    /// The newest first, raised before `before`, at most `limit`.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn alert_page(
        &self,
        filter: &AlertFilter,
        before: Option<AlertId>,
        limit: u32,
    ) -> Result<Vec<AlertRecord>, StoreError> {
        let page = AlertPage {
            filter,
            before,
            limit,
        };
        self.read(page).await
    }

    /// The alerts with a node or an edge that came with a batch, by id.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn batch_alerts(
        &self,
        route: &RouteId,
        batch: &BatchId,
    ) -> Result<Vec<AlertId>, StoreError> {
        self.read(BatchAlerts { route, batch }).await
    }

    /// The alerts of each of some batches, by id; batches without any are left out.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn alerts_by_batch(
        &self,
        route: &RouteId,
        batches: &[BatchId],
    ) -> Result<BTreeMap<BatchId, Vec<AlertId>>, StoreError> {
        self.read(AlertsByBatch { route, batches }).await
    }

    /// What a route's alerts keep out of its map, the oldest alert first.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn pending_changes(&self, route: &RouteId) -> Result<Vec<PendingChange>, StoreError> {
        let alerts = self.read(RouteAlerts(route)).await?;
        let pending = alerts.iter();
        let pending = pending.filter_map(|alert| PendingChange::of(alert.status, &alert.evidence));
        Ok(pending.collect())
    }
}

/// An alert's history comes along as JSON, so that one statement reads a whole alert.
macro_rules! select_alerts {
    ($rest:literal) => {
        concat!(
            "SELECT alerts.*, routes.id AS route_id, \
             (SELECT json_group_array(json_array(position, status, at_us, by_whom, note, reason)) \
              FROM alert_history WHERE alert_history.alert_key = alerts.alert_key) AS history, \
             handling.changes AS handling_changes, assignee, comments, muted_until_us \
             FROM alerts JOIN routes USING (route_key) \
             LEFT JOIN alert_handling AS handling USING (alert_key) ",
            $rest
        )
    };
}

/// One alert.
struct OneAlert(AlertId);

impl Query for OneAlert {
    type Answer = Option<AlertRecord>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let row = sqlx::query(select_alerts!("WHERE alerts.id = $1"))
            .bind(self.0.to_string())
            .fetch_optional(reader)
            .await?;
        row.as_ref().map(alert_of).transpose()
    }
}

/// The newest first, raised before `before`, at most `limit`.
pub(super) struct AlertPage<'a> {
    pub(super) filter: &'a AlertFilter,
    pub(super) before: Option<AlertId>,
    pub(super) limit: u32,
}

impl Query for AlertPage<'_> {
    type Answer = Vec<AlertRecord>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let mut query = QueryBuilder::<Sqlite>::new(select_alerts!("WHERE TRUE"));
        if let Some(before) = self.before {
            query
                .push(" AND alerts.id < ")
                .push_bind(before.to_string());
        }
        self.filter.push_to(&mut query)?;
        query
            .push(" ORDER BY alerts.id DESC LIMIT ")
            .push_bind(self.limit);
        let rows = query.build().fetch_all(reader).await?;
        rows.iter().map(alert_of).collect()
    }
}

impl AlertFilter {
    /// Adds what it asks of an alert. One condition for each wish: SQLite chooses an index only
    /// for a condition that is there.
    fn push_to(&self, query: &mut QueryBuilder<Sqlite>) -> Result<(), StoreError> {
        if let Some(route) = &self.route_id {
            query.push(" AND routes.id = ").push_bind(route.to_string());
        }
        if let Some(routes) = &self.among {
            query.push(" AND routes.id IN (SELECT value FROM json_each(");
            query.push_bind(json_text(routes)?).push("))");
        }
        if let Some(status) = self.status {
            query.push(" AND status = ").push_bind(status.name());
        }
        if let Some(kind) = self.kind {
            query.push(" AND kind = ").push_bind(kind.name());
        }
        if let Some(tier) = self.tier {
            query.push(" AND tier = ").push_bind(tier.name());
        }
        if let Some(since) = self.since {
            query
                .push(" AND alerts.updated_at_us >= ")
                .push_bind(micros(since));
        }
        if let Some([low_x, low_y, high_x, high_y]) = self.bbox {
            query.push(" AND x BETWEEN ").push_bind(low_x);
            query.push(" AND ").push_bind(high_x);
            query.push(" AND y BETWEEN ").push_bind(low_y);
            query.push(" AND ").push_bind(high_y);
        }
        if let Some(confidence) = self.min_confidence {
            query.push(" AND confidence >= ").push_bind(confidence);
        }
        if let Some(vehicle) = &self.vehicle_id {
            query
                .push(" AND EXISTS (SELECT 1 FROM json_each(alerts.vehicles) WHERE value = ")
                .push_bind(vehicle.to_string())
                .push(")");
        }
        if let Some(clearance) = self.blocking {
            query.push(" AND clearance = ").push_bind(clearance.name());
        }
        if let Some(muted) = self.muted {
            query
                .push(" AND (muted_until_us IS NOT NULL) = ")
                .push_bind(muted);
        }
        Ok(())
    }
}

/// The alerts that rest on a batch, by id.
struct BatchAlerts<'a> {
    route: &'a RouteId,
    batch: &'a BatchId,
}

impl Query for BatchAlerts<'_> {
    type Answer = Vec<AlertId>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let rows = sqlx::query(
            "SELECT alerts.id FROM routes JOIN batches USING (route_key) \
             JOIN alert_batches USING (batch_key) JOIN alerts USING (alert_key) \
             WHERE routes.id = $1 AND batches.id = $2 ORDER BY alerts.id",
        )
        .bind(self.route.as_str())
        .bind(self.batch.as_str())
        .fetch_all(reader)
        .await?;
        rows.iter().map(|row| alert_id(row, "id")).collect()
    }
}

/// The alerts that rest on each of a route's batches, by id; batches without any are left out.
struct AlertsByBatch<'a> {
    route: &'a RouteId,
    batches: &'a [BatchId],
}

impl Query for AlertsByBatch<'_> {
    type Answer = BTreeMap<BatchId, Vec<AlertId>>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        // CROSS JOIN: the batches first, however many alerts the route has.
        let rows = sqlx::query(
            "SELECT batches.id AS batch_id, alerts.id FROM routes \
             CROSS JOIN batches ON batches.route_key = routes.route_key \
                 AND batches.id IN (SELECT value FROM json_each($2)) \
             CROSS JOIN alert_batches ON alert_batches.batch_key = batches.batch_key \
             JOIN alerts USING (alert_key) \
             WHERE routes.id = $1 ORDER BY alerts.id",
        )
        .bind(self.route.as_str())
        .bind(json_text(self.batches)?)
        .fetch_all(reader)
        .await?;
        let mut by_batch: BTreeMap<BatchId, Vec<AlertId>> = BTreeMap::new();
        for row in &rows {
            let alerts = by_batch.entry(name(row, "batch_id")?).or_default();
            alerts.push(alert_id(row, "id")?);
        }
        Ok(by_batch)
    }
}

/// The alerts of a route, the oldest first.
pub(super) struct RouteAlerts<'a>(pub(super) &'a RouteId);

impl Query for RouteAlerts<'_> {
    type Answer = Vec<AlertRecord>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let rows = sqlx::query(select_alerts!("WHERE routes.id = $1 ORDER BY alerts.id"))
            .bind(self.0.as_str())
            .fetch_all(reader)
            .await?;
        rows.iter().map(alert_of).collect()
    }
}

/// The alerts raised in the time of a report, the newest first.
pub(super) struct RaisedInTime<'a>(pub(super) &'a ReportScope);

impl Query for RaisedInTime<'_> {
    type Answer = Vec<AlertRecord>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let Self(scope) = self;
        let rows = sqlx::query(select_alerts!(
            "WHERE raised_at_us >= $1 AND raised_at_us < $2 AND ($3 IS NULL OR routes.id = $3) \
             ORDER BY raised_at_us DESC, alerts.id DESC LIMIT $4"
        ))
        .bind(micros(scope.since))
        .bind(micros(scope.until))
        .bind(scope.route_id.as_ref().map(RouteId::as_str))
        .bind(scope.limit)
        .fetch_all(reader)
        .await?;
        rows.iter().map(alert_of).collect()
    }
}

/// The alerts that wait for a decision and are not muted, the newest first.
pub(super) struct OpenAlerts<'a>(pub(super) &'a ReportScope);

impl Query for OpenAlerts<'_> {
    type Answer = Vec<AlertRecord>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let rows = sqlx::query(select_alerts!(
            "WHERE status IN ('open', 'acknowledged') AND muted_until_us IS NULL \
             AND ($1 IS NULL OR routes.id = $1) ORDER BY alerts.id DESC LIMIT $2"
        ))
        .bind(self.0.route_id.as_ref().map(RouteId::as_str))
        .bind(self.0.limit)
        .fetch_all(reader)
        .await?;
        rows.iter().map(alert_of).collect()
    }
}
