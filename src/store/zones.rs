//! Zones: parts of a route's map where alerts are treated otherwise.

use jiff::Timestamp;
use serde::Serialize;
use sqlx::sqlite::SqliteRow;
use sqlx::{Row, SqliteConnection, SqliteExecutor};

use super::audit::{self, Change};
use super::columns::{
    corrupt, json_text, micros, name, optional_json, optional_time, polygon, polygon_bytes, text,
    time,
};
use super::error::StoreError;
use super::handling::{NO_END_US, count_open, handled_of, mute};
use super::request::Request;
use super::webhook_records::Edited;
use super::{Store, named};
use crate::geometry::{Vector2, distance_to_polygon};
use crate::ids::{RouteId, ZoneId};
use crate::model::{Actor, AuditAction, ChangeKind, ZonePurpose};

/// Zones that a route can have.
pub const ZONES_MAX: u32 = 200;

/// What somebody says about a zone.
#[derive(Debug, Clone, PartialEq)]
pub struct ZoneEdit {
    /// A simple polygon, map frame, metres.
    pub polygon: Vec<Vector2<f64>>,
    /// What it does.
    pub purpose: ZonePurpose,
    /// With alerts of these kinds; `None` for all.
    pub kinds: Option<Vec<ChangeKind>>,
    /// Until then; `None` for as long as it is there.
    pub until: Option<Timestamp>,
    /// Why, for people.
    pub note: Option<String>,
}

/// A zone.
#[derive(Debug, Clone, PartialEq)]
pub struct ZoneRecord {
    /// Sorts by when it was made.
    pub id: ZoneId,
    /// Its route.
    pub route_id: RouteId,
    /// 1 when it is made, and one more with every edit.
    pub revision: i64,
    /// What it is.
    pub edit: ZoneEdit,
    /// When its time was over; `None` while it is in effect.
    pub ended_at: Option<Timestamp>,
    /// When it was made.
    pub created_at: Timestamp,
    /// By whom.
    pub created_by: String,
    /// When it was last edited.
    pub updated_at: Timestamp,
}

/// What became of a new zone.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ZoneMade {
    /// It is there.
    Created,
    /// The route has as many as it can have.
    TooMany,
    /// There is no such route.
    UnknownRoute,
}

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
        named(zone(&self.shared.readers, route, id).await)
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
        let rows = sqlx::query(select_zones!(
            "WHERE routes.id = $1 AND zones.id > $2 ORDER BY zones.id LIMIT $3"
        ))
        .bind(route.as_str())
        .bind(after.map_or_else(String::new, |id| id.to_string()))
        .bind(limit)
        .fetch_all(&self.shared.readers)
        .await;
        let rows = rows.map_err(StoreError::from);
        named(rows.and_then(|rows| rows.iter().map(zone_of).collect()))
    }

    /// Ends the zones whose time is over: their alerts are sent and counted again. Says how many there
    /// were.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn end_zones(&self, now: Timestamp) -> Result<usize, StoreError> {
        let waiting: Result<bool, _> = sqlx::query_scalar(
            "SELECT EXISTS (SELECT 1 FROM zones INDEXED BY zones_ending \
             WHERE until_us IS NOT NULL AND ended_at_us IS NULL AND until_us <= $1)",
        )
        .bind(micros(now))
        .fetch_one(&self.shared.readers)
        .await;
        match named(waiting.map_err(StoreError::from))? {
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
use select_zones;

async fn zone(
    reader: impl SqliteExecutor<'_>,
    route: &RouteId,
    id: ZoneId,
) -> Result<Option<ZoneRecord>, StoreError> {
    let row = sqlx::query(select_zones!("WHERE routes.id = $1 AND zones.id = $2"))
        .bind(route.as_str())
        .bind(id.to_string())
        .fetch_optional(reader)
        .await?;
    row.as_ref().map(zone_of).transpose()
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

/// The zones of a route that mute alerts now.
pub(super) struct Mutes(Vec<(ZoneEdit, i64)>);

impl Mutes {
    pub(super) async fn of(
        transaction: &mut SqliteConnection,
        route_key: i64,
    ) -> Result<Self, StoreError> {
        let rows = sqlx::query(select_zones!(
            "WHERE route_key = $1 AND ended_at_us IS NULL AND purpose = 'mute' ORDER BY zones.id"
        ))
        .bind(route_key)
        .fetch_all(transaction)
        .await?;
        let mute = |row| {
            let zone: ZoneRecord = zone_of(row)?;
            let until_us = zone.edit.until.map_or(NO_END_US, micros);
            Ok((zone.edit, until_us))
        };
        let mutes: Result<_, StoreError> = rows.iter().map(mute).collect();
        mutes.map(Self)
    }

    /// Until when an alert at a place is muted; `None` if it is not.
    pub(super) fn until_us(&self, kind: ChangeKind, place: &Vector2<f64>) -> Option<i64> {
        let of_kind = |zone: &ZoneEdit| zone.kinds.as_ref().is_none_or(|k| k.contains(&kind));
        let holding = self
            .0
            .iter()
            .filter(|(zone, _)| of_kind(zone) && distance_to_polygon(place, &zone.polygon) == 0.0);
        holding.map(|(_, until_us)| *until_us).max()
    }
}

/// Brings every alert of a route that waits, or is muted, up to date with the zones that are in effect.
async fn mute_again(
    transaction: &mut SqliteConnection,
    route_key: i64,
    at_us: i64,
) -> Result<(), StoreError> {
    let mutes = Mutes::of(transaction, route_key).await?;
    let rows = sqlx::query(
        "SELECT route_key, alert_key, revision, confirmed_revision, status, kind, x, y, \
         muted_until_us FROM alerts LEFT JOIN alert_handling USING (alert_key) \
         WHERE route_key = $1 AND (status IN ('open', 'acknowledged') OR muted_until_us IS NOT NULL) \
         ORDER BY alert_key",
    )
    .bind(route_key)
    .fetch_all(&mut *transaction)
    .await?;
    for row in &rows {
        let place = Vector2::new(row.try_get("x")?, row.try_get("y")?);
        let until_us = mutes.until_us(text(row, "kind")?, &place);
        let before: Option<i64> = row.try_get("muted_until_us")?;
        if until_us != before {
            let alert = handled_of(row)?;
            mute(transaction, &alert, until_us, at_us).await?;
        }
    }
    count_open(transaction, route_key).await
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
            "SELECT route_key, (SELECT count(*) FROM zones WHERE zones.route_key = routes.route_key) \
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
             created_at_us, created_by, updated_at_us) VALUES ($1, $2, 1, $3, $4, $5, $6, $7, $8, $9, $8)",
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
        let after = zone(&mut *transaction, &self.route, self.id).await?;
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
        let Some(before) = zone(&mut *transaction, &self.route, self.id).await? else {
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
        let after = zone(&mut *transaction, &self.route, self.id).await?;
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
            "WHERE until_us IS NOT NULL AND ended_at_us IS NULL AND until_us <= $1 ORDER BY zones.id"
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
            let after = zone(&mut *transaction, &route, id).await?;
            let audited = Audited::of(AuditAction::ZoneEnded, &route, id);
            let by = &Actor::System;
            audited
                .write(transaction, Some(before), after, by, now)
                .await?;
        }
        Ok(rows.len())
    }
}

/// The change of a zone, as the audit has it.
struct Audited<'a> {
    action: AuditAction,
    route: &'a RouteId,
    id: ZoneId,
}

impl<'a> Audited<'a> {
    fn of(action: AuditAction, route: &'a RouteId, id: ZoneId) -> Self {
        Self { action, route, id }
    }

    async fn write(
        &self,
        transaction: &mut SqliteConnection,
        before: Option<ZoneRecord>,
        after: Option<ZoneRecord>,
        by: &Actor,
        at: Timestamp,
    ) -> Result<(), StoreError> {
        let change = Change {
            at,
            actor: by,
            action: self.action,
            route_id: Some(self.route.as_str()),
            subject: &self.id.to_string(),
            before: before.as_ref().map(zone_text).transpose()?,
            after: after.as_ref().map(zone_text).transpose()?,
        };
        audit::write(transaction, change).await
    }
}

/// A zone as the audit has it.
fn zone_text(zone: &ZoneRecord) -> Result<String, StoreError> {
    #[derive(Serialize)]
    struct Text<'a> {
        polygon: Vec<[f64; 2]>,
        purpose: ZonePurpose,
        kinds: Option<&'a [ChangeKind]>,
        until: Option<Timestamp>,
        ended_at: Option<Timestamp>,
        note: Option<&'a str>,
    }
    let ZoneEdit {
        polygon,
        purpose,
        kinds,
        until,
        note,
    } = &zone.edit;
    json_text(&Text {
        polygon: polygon.iter().map(|corner| [corner.x, corner.y]).collect(),
        purpose: *purpose,
        kinds: kinds.as_deref(),
        until: *until,
        ended_at: zone.ended_at,
        note: note.as_deref(),
    })
}
