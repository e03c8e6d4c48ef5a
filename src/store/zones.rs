//! Zones, parts of a route's map with rules of their own for alerts: made, edited, ended, read.

use jiff::Timestamp;
use sqlx::sqlite::SqliteRow;
use sqlx::{Row, SqliteConnection};

use super::Store;
use super::columns::{
    corrupt, json_text, micros, name, optional_json, optional_time, polygon, polygon_bytes, text,
    time,
};
use super::error::StoreError;
use super::mutes::mute_again;
use super::query::Query;
use super::request::Request;
use super::webhook_records::Edited;
use super::zone_audit::Audited;
use super::zone_records::{ZONES_MAX, ZoneEdit, ZoneMade, ZoneRecord};
use crate::ids::{RouteId, ZoneId};
use crate::model::{Actor, AuditAction};

impl Store {
    /// Makes a zone; it takes effect at once.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn create_zone(
        &self,
        route: &RouteId,
        id: ZoneId,
        edit: ZoneEdit,
        by: &Actor,
        now: Timestamp,
    ) -> Result<ZoneMade, StoreError> {
        let create = Create {
            route: route.clone(),
            id,
            edit,
            by: by.clone(),
            now,
        };
        self.work(create).await
    }

    /// Replaces what a zone says, or (`None`) deletes it, if it is still at `revision` where one is given.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn edit_zone(
        &self,
        route: &RouteId,
        id: ZoneId,
        revision: Option<i64>,
        edit: Option<ZoneEdit>,
        by: &Actor,
        now: Timestamp,
    ) -> Result<Edited, StoreError> {
        let change = Edit {
            route: route.clone(),
            id,
            revision,
            edit,
            by: by.clone(),
            now,
        };
        self.work(change).await
    }

    /// One zone of a route.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn zone(
        &self,
        route: &RouteId,
        id: ZoneId,
    ) -> Result<Option<ZoneRecord>, StoreError> {
        self.read(OneZone { route, id }).await
    }

    /// The zones of a route, the oldest first, after `after`, at most `limit`.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn zones(
        &self,
        route: &RouteId,
        after: Option<ZoneId>,
        limit: u32,
    ) -> Result<Vec<ZoneRecord>, StoreError> {
        let page = ZonePage {
            route,
            after,
            limit,
        };
        self.read(page).await
    }

    /// Ends the zones whose time is over: their alerts are sent and counted again. Returns how many.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn end_zones(&self, now: Timestamp) -> Result<usize, StoreError> {
        match self.read(IsAnyOver(now)).await? {
            true => self.work(End(now)).await,
            false => Ok(0),
        }
    }
}

macro_rules! select_zones {
    ($rest:literal) => {
        concat!(
            "SELECT zones.*, routes.id AS route_id FROM routes JOIN zones USING (route_key) ",
            $rest
        )
    };
}

/// One zone.
struct OneZone<'a> {
    route: &'a RouteId,
    id: ZoneId,
}

impl Query for OneZone<'_> {
    type Answer = Option<ZoneRecord>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let row = sqlx::query(select_zones!("WHERE routes.id = $1 AND zones.id = $2"))
            .bind(self.route.as_str())
            .bind(self.id.to_string())
            .fetch_optional(reader)
            .await?;
        row.as_ref().map(zone_of).transpose()
    }
}

/// The zones of a route, the oldest first, after `after`.
struct ZonePage<'a> {
    route: &'a RouteId,
    after: Option<ZoneId>,
    limit: u32,
}

impl Query for ZonePage<'_> {
    type Answer = Vec<ZoneRecord>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let rows = sqlx::query(select_zones!(
            "WHERE routes.id = $1 AND zones.id > $2 ORDER BY zones.id LIMIT $3"
        ))
        .bind(self.route.as_str())
        .bind(self.after.map_or_else(String::new, |id| id.to_string()))
        .bind(self.limit)
        .fetch_all(reader)
        .await?;
        rows.iter().map(zone_of).collect()
    }
}

/// Whether a zone's time is over and it was not ended yet.
struct IsAnyOver(Timestamp);

impl Query for IsAnyOver {
    type Answer = bool;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let is_any = sqlx::query_scalar(
            "SELECT EXISTS (SELECT 1 FROM zones INDEXED BY zones_ending \
             WHERE until_us IS NOT NULL AND ended_at_us IS NULL AND until_us <= $1)",
        )
        .bind(micros(self.0))
        .fetch_one(reader)
        .await?;
        Ok(is_any)
    }
}

fn zone_of(row: &SqliteRow) -> Result<ZoneRecord, StoreError> {
    let id: &str = row.try_get("id")?;
    Ok(ZoneRecord {
        id: id.parse().map_err(|_| corrupt("id"))?,
        route_id: name(row, "route_id")?,
        revision: row.try_get("revision")?,
        edit: ZoneEdit {
            polygon: polygon(row, "polygon")?,
            purpose: text(row, "purpose")?,
            kinds: optional_json(row, "kinds")?,
            until: optional_time(row, "until_us")?,
            note: row.try_get("note")?,
        },
        ended_at: optional_time(row, "ended_at_us")?,
        created_at: time(row, "created_at_us")?,
        created_by: row.try_get("created_by")?,
        updated_at: time(row, "updated_at_us")?,
    })
}

struct Create {
    route: RouteId,
    id: ZoneId,
    edit: ZoneEdit,
    by: Actor,
    now: Timestamp,
}

impl Request for Create {
    type Outcome = ZoneMade;
    const QUEUES_JOBS: bool = false;

    async fn execute(&self, transaction: &mut SqliteConnection) -> Result<ZoneMade, StoreError> {
        let row: Option<(i64, u32)> = sqlx::query_as(
            "SELECT route_key, \
             (SELECT count(*) FROM zones WHERE zones.route_key = routes.route_key) \
             FROM routes WHERE id = $1",
        )
        .bind(self.route.as_str())
        .fetch_optional(&mut *transaction)
        .await?;
        let Some((route_key, count)) = row else {
            return Ok(ZoneMade::UnknownRoute);
        };
        if count >= ZONES_MAX {
            return Ok(ZoneMade::TooMany);
        }
        sqlx::query(
            "INSERT INTO zones (id, route_key, revision, polygon, purpose, kinds, until_us, note, \
             created_at_us, created_by, updated_at_us) \
             VALUES ($1, $2, 1, $3, $4, $5, $6, $7, $8, $9, $8)",
        )
        .bind(self.id.to_string())
        .bind(route_key)
        .bind(polygon_bytes(&self.edit.polygon))
        .bind(self.edit.purpose.name())
        .bind(self.edit.kinds.as_ref().map(json_text).transpose()?)
        .bind(self.edit.until.map(micros))
        .bind(self.edit.note.as_deref())
        .bind(micros(self.now))
        .bind(self.by.name())
        .execute(&mut *transaction)
        .await?;
        mute_again(transaction, route_key, micros(self.now)).await?;
        let zone = OneZone {
            route: &self.route,
            id: self.id,
        };
        let after = zone.answer(transaction).await?;
        let audited = Audited::of(AuditAction::ZoneCreated, &self.route, self.id);
        audited
            .write(transaction, None, after, &self.by, self.now)
            .await?;
        Ok(ZoneMade::Created)
    }
}

struct Edit {
    route: RouteId,
    id: ZoneId,
    revision: Option<i64>,
    edit: Option<ZoneEdit>,
    by: Actor,
    now: Timestamp,
}

impl Request for Edit {
    type Outcome = Edited;
    const QUEUES_JOBS: bool = false;

    async fn execute(&self, transaction: &mut SqliteConnection) -> Result<Edited, StoreError> {
        let zone = OneZone {
            route: &self.route,
            id: self.id,
        };
        let Some(before) = zone.answer(transaction).await? else {
            return Ok(Edited::Unknown);
        };
        if self.revision.is_some_and(|seen| seen != before.revision) {
            return Ok(Edited::Stale);
        }
        let changed = match &self.edit {
            Some(edit) => sqlx::query_scalar(
                "UPDATE zones SET revision = revision + 1, polygon = $2, purpose = $3, kinds = $4, \
                 until_us = $5, ended_at_us = NULL, note = $6, updated_at_us = $7 \
                 WHERE id = $1 RETURNING route_key",
            )
            .bind(self.id.to_string())
            .bind(polygon_bytes(&edit.polygon))
            .bind(edit.purpose.name())
            .bind(edit.kinds.as_ref().map(json_text).transpose()?)
            .bind(edit.until.map(micros))
            .bind(edit.note.as_deref())
            .bind(micros(self.now)),
            None => sqlx::query_scalar("DELETE FROM zones WHERE id = $1 RETURNING route_key")
                .bind(self.id.to_string()),
        };
        let route_key: i64 = changed.fetch_one(&mut *transaction).await?;
        mute_again(transaction, route_key, micros(self.now)).await?;
        let after = zone.answer(transaction).await?;
        let action = match after {
            Some(_) => AuditAction::ZoneChanged,
            None => AuditAction::ZoneDeleted,
        };
        let audited = Audited::of(action, &self.route, self.id);
        audited
            .write(transaction, Some(before), after, &self.by, self.now)
            .await?;
        Ok(Edited::Done)
    }
}

struct End(Timestamp);

impl Request for End {
    type Outcome = usize;
    const QUEUES_JOBS: bool = false;

    async fn execute(&self, transaction: &mut SqliteConnection) -> Result<usize, StoreError> {
        let now = self.0;
        let rows = sqlx::query(select_zones!(
            "WHERE until_us IS NOT NULL AND ended_at_us IS NULL AND until_us <= $1 \
             ORDER BY zones.id"
        ))
        .bind(micros(now))
        .fetch_all(&mut *transaction)
        .await?;
        for row in &rows {
            let before = zone_of(row)?;
            sqlx::query("UPDATE zones SET ended_at_us = $1 WHERE id = $2")
                .bind(micros(now))
                .bind(before.id.to_string())
                .execute(&mut *transaction)
                .await?;
            mute_again(transaction, row.try_get("route_key")?, micros(now)).await?;
            let (route, id) = (before.route_id.clone(), before.id);
            let zone = OneZone { route: &route, id };
            let after = zone.answer(transaction).await?;
            let audited = Audited::of(AuditAction::ZoneEnded, &route, id);
            let by = &Actor::System;
            audited
                .write(transaction, Some(before), after, by, now)
                .await?;
        }
        Ok(rows.len())
    }
}
