//! The versions of a route's map.

use sqlx::sqlite::SqliteRow;
use sqlx::{Row, SqliteConnection, SqlitePool};

use super::alert_records::{MapPicture, MapVersionRecord, VersionCause};
use super::body::{SealedBody, unseal};
use super::columns::{alert_id, corrupt, optional_time, text, time};
use super::error::StoreError;
use super::{Store, named};
use crate::change::AlertAction;
use crate::ids::{AlertId, RouteId};

impl Store {
    /// The versions of a route's map after `after`, the oldest first, at most `limit`; the
    /// present one is the last.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn map_versions(
        &self,
        route: &RouteId,
        after: i64,
        limit: u32,
    ) -> Result<Vec<MapVersionRecord>, StoreError> {
        named(map_versions(&self.shared.readers, route, after, limit).await)
    }

    /// The picture of a version that another one has followed.
    ///
    /// # Errors
    /// [`StoreError::Corrupt`] if it has lost its checksum.
    pub async fn map_version_picture(
        &self,
        route: &RouteId,
        version: i64,
    ) -> Result<Option<MapPicture>, StoreError> {
        named(picture(&self.shared.readers, route, version).await)
    }
}

/// Versions after `after`, the oldest first.
pub(super) async fn map_versions(
    readers: &SqlitePool,
    route: &RouteId,
    after: i64,
    limit: u32,
) -> Result<Vec<MapVersionRecord>, StoreError> {
    let rows = sqlx::query(
        "SELECT version, map_versions.epoch, map_versions.created_at_us AS began_at_us, \
         superseded_at_us, cause_alert_id, cause_action, pgm_sha256 \
         FROM routes JOIN map_versions USING (route_key) WHERE routes.id = ?1 AND version > ?2 \
         UNION ALL \
         SELECT map_version, epoch, coalesce(version_created_at_us, created_at_us), \
         NULL, version_alert_id, version_action, NULL \
         FROM routes WHERE id = ?1 AND map_version > ?2 \
         ORDER BY 1 LIMIT ?3",
    )
    .bind(route.as_str())
    .bind(after)
    .bind(limit)
    .fetch_all(readers)
    .await?;
    rows.iter().map(version_of).collect()
}

fn version_of(row: &SqliteRow) -> Result<MapVersionRecord, StoreError> {
    let caused: Option<&str> = row.try_get("cause_alert_id")?;
    let cause = match caused {
        None => None,
        Some(_) => Some(VersionCause {
            alert_id: alert_id(row, "cause_alert_id")?,
            action: text(row, "cause_action")?,
        }),
    };
    let sha256: Option<Vec<u8>> = row.try_get("pgm_sha256")?;
    let sha256 = sha256.map(|bytes| bytes.try_into().map_err(|_| corrupt("pgm_sha256")));
    Ok(MapVersionRecord {
        version: row.try_get("version")?,
        epoch: row.try_get("epoch")?,
        created_at: time(row, "began_at_us")?,
        superseded_at: optional_time(row, "superseded_at_us")?,
        cause,
        sha256: sha256.transpose()?,
    })
}

/// The picture of a version that another one has followed.
pub(super) async fn picture(
    readers: &SqlitePool,
    route: &RouteId,
    version: i64,
) -> Result<Option<MapPicture>, StoreError> {
    let row = sqlx::query(
        "SELECT png, pgm, pgm_bytes, pgm_sha256, yaml FROM routes \
         JOIN map_versions USING (route_key) WHERE routes.id = ? AND version = ?",
    )
    .bind(route.as_str())
    .bind(version)
    .fetch_optional(readers)
    .await?;
    let Some(row) = row else { return Ok(None) };
    let pgm = unseal(
        row.try_get("pgm")?,
        row.try_get("pgm_bytes")?,
        row.try_get("pgm_sha256")?,
    );
    Ok(Some(MapPicture {
        png: row.try_get("png")?,
        pgm: pgm.ok_or_else(|| corrupt("pgm"))?,
        yaml: row.try_get("yaml")?,
    }))
}

/// The picture of the version that ends, its PGM compressed.
pub(super) struct SealedPicture {
    pub(super) png: Vec<u8>,
    pub(super) pgm: SealedBody,
    pub(super) yaml: String,
}

/// What begins a version.
pub(super) struct Beginning {
    pub(super) at_us: i64,
    pub(super) alert_id: AlertId,
    pub(super) action: AlertAction,
}

/// Files the route's present version with its picture, and begins the next one.
pub(super) async fn begin_next(
    transaction: &mut SqliteConnection,
    route_key: i64,
    picture: &SealedPicture,
    next: &Beginning,
) -> Result<(), StoreError> {
    sqlx::query(
        "INSERT INTO map_versions (route_key, version, epoch, created_at_us, superseded_at_us, \
         cause_alert_id, cause_action, png, pgm, pgm_bytes, pgm_sha256, yaml) \
         SELECT route_key, map_version, epoch, coalesce(version_created_at_us, created_at_us), \
         ?2, version_alert_id, version_action, ?3, ?4, ?5, ?6, ?7 \
         FROM routes WHERE route_key = ?1",
    )
    .bind(route_key)
    .bind(next.at_us)
    .bind(picture.png.as_slice())
    .bind(picture.pgm.compressed.as_slice())
    .bind(picture.pgm.bytes)
    .bind(picture.pgm.sha256.as_slice())
    .bind(&picture.yaml)
    .execute(&mut *transaction)
    .await?;
    sqlx::query(
        "UPDATE routes SET map_version = map_version + 1, epoch = epoch + 1, \
         version_created_at_us = ?2, version_alert_id = ?3, version_action = ?4 \
         WHERE route_key = ?1",
    )
    .bind(route_key)
    .bind(next.at_us)
    .bind(next.alert_id.to_string())
    .bind(next.action.name())
    .execute(transaction)
    .await?;
    Ok(())
}
