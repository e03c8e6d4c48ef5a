//! Routes.

use jiff::Timestamp;
use sqlx::sqlite::SqliteRow;
use sqlx::{Row, SqliteConnection};

use super::columns::{json_text, micros, name, text, time};
use super::error::StoreError;
use super::inputs::{self, Input};
use super::query::Query;
use super::records::{
    GeoAnchor, RouteCounts, RouteEdition, RouteRecord, RouteSettings, RouteUpdate,
};
use super::request::Request;
use super::webhooks::RouteWebhooks;
use super::{Deleted, Put, Store, route_audit, webhook_audit};
use crate::ids::RouteId;
use crate::model::{Actor, Detector, Stage};

impl Store {
    /// Creates a route or changes it.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn put_route(
        &self,
        id: &RouteId,
        update: RouteUpdate,
        by: &Actor,
        now: Timestamp,
    ) -> Result<Put, StoreError> {
        let request = PutRoute {
            id: id.clone(),
            update,
            by: by.clone(),
            now,
        };
        self.work(request).await
    }

    /// One route.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn route(&self, id: &RouteId) -> Result<Option<RouteRecord>, StoreError> {
        self.read(OneRoute(id)).await
    }

    /// By id, after `after`, at most `limit`.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn routes(
        &self,
        after: Option<&RouteId>,
        limit: u32,
    ) -> Result<Vec<RouteRecord>, StoreError> {
        let page = RoutePage {
            among: None,
            after,
            limit,
        };
        self.read(page).await
    }

    /// Those of some routes that are there, as [`Store::routes`] has them.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn routes_among(
        &self,
        among: &[RouteId],
        after: Option<&RouteId>,
        limit: u32,
    ) -> Result<Vec<RouteRecord>, StoreError> {
        let page = RoutePage {
            among: Some(among),
            after,
            limit,
        };
        self.read(page).await
    }

    /// Deletes a route with its uploads, jobs and graph; where an edition is expected, only that.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn delete_route(
        &self,
        id: &RouteId,
        expected: Option<RouteEdition>,
        by: &Actor,
        now: Timestamp,
    ) -> Result<Deleted, StoreError> {
        let request = DeleteRoute {
            id: id.clone(),
            expected,
            by: by.clone(),
            now,
        };
        self.work(request).await
    }
}

macro_rules! select_routes {
    ($rest:literal) => {
        concat!(
            "SELECT id, display_name, geo_latitude, geo_longitude, geo_heading, detector, \
             false_alarm_rate, hold_s, max_shift_m, stage, map_version, epoch, revision, batches, \
             scans, vehicles, nodes, edges, loop_closures, subgraphs, open_alerts, created_at_us, \
             updated_at_us, \
             (SELECT count(*) FROM jobs WHERE jobs.route_key = routes.route_key) AS pending \
             FROM routes ",
            $rest
        )
    };
}

/// Creates a route or changes it.
pub(super) struct PutRoute {
    pub(super) id: RouteId,
    pub(super) update: RouteUpdate,
    pub(super) by: Actor,
    pub(super) now: Timestamp,
}

impl Request for PutRoute {
    type Outcome = Put;
    const QUEUES_JOBS: bool = false;

    async fn execute(&self, transaction: &mut SqliteConnection) -> Result<Put, StoreError> {
        let present = OneRoute(&self.id).answer(transaction).await?;
        if self.change(transaction).await? {
            self.note(transaction, present).await?;
            return Ok(Put::Updated);
        }
        let wanted = self.update.settings.detector;
        match present {
            None if self.update.expected.is_none() => {
                self.create(transaction).await?;
                self.note(transaction, None).await?;
                Ok(Put::Created)
            }
            Some(present) if wanted.is_some_and(|wanted| wanted != present.settings.detector) => {
                Ok(Put::DetectorFixed)
            }
            None | Some(_) => Ok(Put::Stale),
        }
    }
}

impl PutRoute {
    async fn note(
        &self,
        transaction: &mut SqliteConnection,
        before: Option<RouteRecord>,
    ) -> Result<(), StoreError> {
        let after = OneRoute(&self.id).answer(transaction).await?;
        let (before, after) = (before.as_ref(), after.as_ref());
        let was = before.map(|before| &before.settings);
        if let Some(after) = after.filter(|after| was != Some(&after.settings)) {
            let input = Input::Settings(after.settings.clone());
            inputs::note_of_route(transaction, &self.id, self.now, &input).await?;
        }
        route_audit::note(transaction, before, after, &self.by, self.now).await
    }

    async fn change(&self, transaction: &mut SqliteConnection) -> Result<bool, StoreError> {
        let geo = self.update.geo_anchor;
        let settings = &self.update.settings;
        let expected = self.update.expected;
        let changed = sqlx::query(
            "UPDATE routes SET display_name = coalesce($2, display_name), \
                 geo_latitude = coalesce($3, geo_latitude), \
                 geo_longitude = coalesce($4, geo_longitude), \
                 geo_heading = coalesce($5, geo_heading), detector = coalesce($6, detector), \
                 false_alarm_rate = coalesce($7, false_alarm_rate), \
                 hold_s = coalesce($8, hold_s), max_shift_m = coalesce($9, max_shift_m), \
                 updated_at_us = $10 \
             WHERE id = $1 AND ($6 IS NULL OR detector = $6 OR batches = 0) \
                 AND ($11 IS NULL OR revision = $11 AND updated_at_us = $12)",
        )
        .bind(self.id.as_str())
        .bind(self.update.display_name.as_deref())
        .bind(geo.map(|geo| geo.latitude))
        .bind(geo.map(|geo| geo.longitude))
        .bind(geo.map(|geo| geo.heading))
        .bind(settings.detector.map(Detector::name))
        .bind(settings.false_alarm_rate)
        .bind(settings.hold_s)
        .bind(settings.max_shift_m)
        .bind(micros(self.now))
        .bind(expected.map(|expected| expected.revision))
        .bind(expected.map(|expected| micros(expected.updated_at)))
        .execute(transaction)
        .await?;
        Ok(changed.rows_affected() > 0)
    }

    async fn create(&self, transaction: &mut SqliteConnection) -> Result<(), StoreError> {
        let geo = self.update.geo_anchor;
        let default = RouteSettings::default();
        let settings = self.update.settings;
        sqlx::query(
            "INSERT INTO routes (id, display_name, geo_latitude, geo_longitude, geo_heading, \
             detector, false_alarm_rate, hold_s, max_shift_m, stage, map_version, epoch, revision, \
             next_node_id, next_edge_id, created_at_us, updated_at_us) \
             VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, 1, 1, 0, 1, 1, $11, $12)",
        )
        .bind(self.id.as_str())
        .bind(self.update.display_name.as_deref())
        .bind(geo.map(|geo| geo.latitude))
        .bind(geo.map(|geo| geo.longitude))
        .bind(geo.map(|geo| geo.heading))
        .bind(settings.detector.unwrap_or(default.detector).name())
        .bind(
            settings
                .false_alarm_rate
                .unwrap_or(default.false_alarm_rate),
        )
        .bind(settings.hold_s.unwrap_or(default.hold_s))
        .bind(settings.max_shift_m.unwrap_or(default.max_shift_m))
        .bind(Stage::Mapping.name())
        .bind(micros(self.now))
        .bind(micros(self.now))
        .execute(transaction)
        .await?;
        Ok(())
    }
}

/// Deletes a route with everything in it.
pub(super) struct DeleteRoute {
    pub(super) id: RouteId,
    pub(super) expected: Option<RouteEdition>,
    pub(super) by: Actor,
    pub(super) now: Timestamp,
}

impl Request for DeleteRoute {
    type Outcome = Deleted;
    const QUEUES_JOBS: bool = false;
    const WHILE_FULL: bool = true;

    async fn execute(&self, transaction: &mut SqliteConnection) -> Result<Deleted, StoreError> {
        let before = OneRoute(&self.id).answer(transaction).await?;
        let webhooks = RouteWebhooks(&self.id).answer(transaction).await?;
        let deleted = sqlx::query(
            "DELETE FROM routes WHERE id = $1 \
             AND ($2 IS NULL OR revision = $2 AND updated_at_us = $3)",
        )
        .bind(self.id.as_str())
        .bind(self.expected.map(|expected| expected.revision))
        .bind(self.expected.map(|expected| micros(expected.updated_at)))
        .execute(&mut *transaction)
        .await?;
        let Some(before) = before else {
            return Ok(Deleted::NotThere);
        };
        if deleted.rows_affected() == 0 {
            return Ok(Deleted::Stale);
        }
        route_audit::note(transaction, Some(&before), None, &self.by, self.now).await?;
        for webhook in &webhooks {
            webhook_audit::note(transaction, Some(webhook), None, &self.by, self.now).await?;
        }
        Ok(Deleted::Done)
    }
}

/// One route.
struct OneRoute<'a>(&'a RouteId);

impl Query for OneRoute<'_> {
    type Answer = Option<RouteRecord>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let row = sqlx::query(select_routes!("WHERE id = $1"))
            .bind(self.0.as_str())
            .fetch_optional(reader)
            .await?;
        row.as_ref().map(route_of).transpose()
    }
}

/// Routes by id, after `after`: all, or those of some that are there.
pub(super) struct RoutePage<'a> {
    pub(super) among: Option<&'a [RouteId]>,
    pub(super) after: Option<&'a RouteId>,
    pub(super) limit: u32,
}

impl Query for RoutePage<'_> {
    type Answer = Vec<RouteRecord>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let rows = sqlx::query(select_routes!(
            "WHERE id > $1 AND ($3 IS NULL OR id IN (SELECT value FROM json_each($3))) \
             ORDER BY id LIMIT $2"
        ))
        .bind(self.after.map_or("", RouteId::as_str))
        .bind(self.limit)
        .bind(self.among.map(json_text).transpose()?)
        .fetch_all(reader)
        .await?;
        rows.iter().map(route_of).collect()
    }
}

/// The settings in a route's row.
pub(super) fn settings_of(row: &SqliteRow) -> Result<RouteSettings, StoreError> {
    Ok(RouteSettings {
        detector: text(row, "detector")?,
        false_alarm_rate: row.try_get("false_alarm_rate")?,
        hold_s: row.try_get("hold_s")?,
        max_shift_m: row.try_get("max_shift_m")?,
    })
}

fn route_of(row: &SqliteRow) -> Result<RouteRecord, StoreError> {
    let latitude: Option<f64> = row.try_get("geo_latitude")?;
    let geo_anchor = match latitude {
        None => None,
        Some(latitude) => Some(GeoAnchor {
            latitude,
            longitude: row.try_get("geo_longitude")?,
            heading: row.try_get("geo_heading")?,
        }),
    };
    Ok(RouteRecord {
        id: name(row, "id")?,
        display_name: row.try_get("display_name")?,
        geo_anchor,
        settings: settings_of(row)?,
        stage: text(row, "stage")?,
        map_version: row.try_get("map_version")?,
        epoch: row.try_get("epoch")?,
        revision: row.try_get("revision")?,
        counts: RouteCounts {
            batches: row.try_get("batches")?,
            scans: row.try_get("scans")?,
            nodes: row.try_get("nodes")?,
            edges: row.try_get("edges")?,
            loop_closures: row.try_get("loop_closures")?,
            subgraphs: row.try_get("subgraphs")?,
            vehicles: row.try_get("vehicles")?,
            open_alerts: row.try_get("open_alerts")?,
        },
        pending_batches: row.try_get("pending")?,
        created_at: time(row, "created_at_us")?,
        updated_at: time(row, "updated_at_us")?,
    })
}
