//! The versions of a route's map.

use jiff::Timestamp;
use sqlx::sqlite::SqliteRow;
use sqlx::{Row, SqliteConnection};

use super::Store;
use super::alert_records::{MapPicture, MapVersionRecord, VersionCause, VersionRelease};
use super::body::{SealedBody, unseal};
use super::columns::{alert_id, corrupt, micros, optional_time, text, time};
use super::error::StoreError;
use super::query::Query;
use crate::ids::{AlertId, RouteId};
use crate::model::{AlertStatus, VersionAction};

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
        let page = VersionPage {
            route,
            after,
            limit,
        };
        self.read(page).await
    }

    /// One version of a route's map.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn map_version(
        &self,
        route: &RouteId,
        version: i64,
    ) -> Result<Option<MapVersionRecord>, StoreError> {
        let after = version.saturating_sub(1);
        let mut found = self.map_versions(route, after, 1).await?;
        found.retain(|record| record.version == version);
        Ok(found.pop())
    }

    /// The newest released version of a route's map; `None` while none is.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn newest_release(&self, route: &RouteId) -> Result<Option<i64>, StoreError> {
        self.read(NewestRelease(route)).await
    }

    /// The alerts that a route's map has taken in, or let go again, after one moment and until another, by
    /// id.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn alerts_in_map_between(
        &self,
        route: &RouteId,
        after: Timestamp,
        until: Timestamp,
    ) -> Result<Vec<AlertId>, StoreError> {
        let alerts = AlertsInMapBetween {
            route,
            after,
            until,
        };
        self.read(alerts).await
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
        self.read(VersionPicture { route, version }).await
    }
}

/// Versions after `after`, the oldest first.
pub(super) struct VersionPage<'a> {
    pub(super) route: &'a RouteId,
    pub(super) after: i64,
    pub(super) limit: u32,
}

impl Query for VersionPage<'_> {
    type Answer = Vec<MapVersionRecord>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let rows = sqlx::query(
            "SELECT version, map_versions.epoch, map_versions.created_at_us AS began_at_us, \
             superseded_at_us, cause_alert_id, cause_action, cause_by, cause_note, \
             max_displacement_m, released_at_us, released_by, release_note, retired_at_us, \
             pgm_sha256 FROM routes JOIN map_versions USING (route_key) \
             WHERE routes.id = $1 AND version > $2 \
             UNION ALL \
             SELECT map_version, epoch, coalesce(version_created_at_us, created_at_us), \
             NULL, version_alert_id, version_action, version_by, version_note, \
             version_max_displacement_m, NULL, NULL, NULL, NULL, NULL \
             FROM routes WHERE id = $1 AND map_version > $2 \
             ORDER BY 1 LIMIT $3",
        )
        .bind(self.route.as_str())
        .bind(self.after)
        .bind(self.limit)
        .fetch_all(reader)
        .await?;
        rows.iter().map(version_of).collect()
    }
}

fn version_of(row: &SqliteRow) -> Result<MapVersionRecord, StoreError> {
    let sha256: Option<Vec<u8>> = row.try_get("pgm_sha256")?;
    let sha256 = sha256.map(|bytes| bytes.try_into().map_err(|_| corrupt("pgm_sha256")));
    let released = optional_time(row, "released_at_us")?.map(|at| {
        Ok::<_, StoreError>(VersionRelease {
            at,
            by: row.try_get("released_by")?,
            note: row.try_get("release_note")?,
        })
    });
    Ok(MapVersionRecord {
        version: row.try_get("version")?,
        epoch: row.try_get("epoch")?,
        created_at: time(row, "began_at_us")?,
        superseded_at: optional_time(row, "superseded_at_us")?,
        cause: cause_of(row)?,
        max_displacement_m: row.try_get("max_displacement_m")?,
        released: released.transpose()?,
        retired_at: optional_time(row, "retired_at_us")?,
        sha256: sha256.transpose()?,
    })
}

/// A version that no decision about an alert began is the first, or began with a release.
fn cause_of(row: &SqliteRow) -> Result<Option<VersionCause>, StoreError> {
    let version: i64 = row.try_get("version")?;
    let decided: Option<&str> = row.try_get("cause_alert_id")?;
    let (alert_id, action) = match decided {
        Some(_) => (
            Some(alert_id(row, "cause_alert_id")?),
            text(row, "cause_action")?,
        ),
        None if version > 1 => (None, VersionAction::Release),
        None => return Ok(None),
    };
    Ok(Some(VersionCause {
        alert_id,
        action,
        by: row.try_get("cause_by")?,
        note: row.try_get("cause_note")?,
    }))
}

/// The newest version that is released and not withdrawn.
struct NewestRelease<'a>(&'a RouteId);

impl Query for NewestRelease<'_> {
    type Answer = Option<i64>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let newest = sqlx::query_scalar(
            "SELECT max(version) FROM routes JOIN map_versions USING (route_key) \
             WHERE routes.id = $1 AND released_at_us IS NOT NULL AND retired_at_us IS NULL",
        )
        .bind(self.0.as_str())
        .fetch_one(reader)
        .await?;
        Ok(newest)
    }
}

/// Alerts that became accepted in a time, or were accepted before it and undone in it: nothing but
/// an undo ends that status.
struct AlertsInMapBetween<'a> {
    route: &'a RouteId,
    after: Timestamp,
    until: Timestamp,
}

impl Query for AlertsInMapBetween<'_> {
    type Answer = Vec<AlertId>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let rows = sqlx::query(
            "SELECT DISTINCT alerts.id \
             FROM alert_history AS entry INDEXED BY alert_history_by_time \
                 JOIN alerts USING (alert_key) JOIN routes USING (route_key) \
             WHERE entry.at_us > $1 AND entry.at_us <= $2 AND routes.id = $3 \
             AND (entry.status = $4 OR EXISTS ( \
                 SELECT 1 FROM alert_history AS before WHERE before.alert_key = entry.alert_key \
                 AND before.position = entry.position - 1 AND before.status = $4)) \
             ORDER BY alerts.id",
        )
        .bind(micros(self.after))
        .bind(micros(self.until))
        .bind(self.route.as_str())
        .bind(AlertStatus::Accepted.name())
        .fetch_all(reader)
        .await?;
        rows.iter().map(|row| alert_id(row, "id")).collect()
    }
}

/// The picture of a version that another one has followed.
pub(super) struct VersionPicture<'a> {
    pub(super) route: &'a RouteId,
    pub(super) version: i64,
}

impl Query for VersionPicture<'_> {
    type Answer = Option<MapPicture>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let row = sqlx::query(
            "SELECT png, pgm, pgm_bytes, pgm_sha256, yaml FROM routes \
             JOIN map_versions USING (route_key) WHERE routes.id = $1 AND version = $2",
        )
        .bind(self.route.as_str())
        .bind(self.version)
        .fetch_optional(reader)
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
}

/// The picture of the version that ends, its PGM compressed.
pub(super) struct SealedPicture {
    png: Vec<u8>,
    pgm: SealedBody,
    yaml: String,
}

impl SealedPicture {
    /// Compresses the PGM.
    ///
    /// # Errors
    /// [`StoreError::Compression`].
    pub(super) fn seal(picture: MapPicture) -> Result<Self, StoreError> {
        Ok(Self {
            png: picture.png,
            pgm: SealedBody::seal(&picture.pgm)?,
            yaml: picture.yaml,
        })
    }

    /// SHA-256 of the PGM.
    pub(super) fn sha256(&self) -> &[u8; 32] {
        &self.pgm.sha256
    }
}

/// What begins a version.
pub(super) struct Beginning<'a> {
    pub(super) at_us: i64,
    /// The alert and what was decided; `None` for a release.
    pub(super) decided: Option<(AlertId, VersionAction)>,
    pub(super) by: Option<&'a str>,
    pub(super) note: Option<&'a str>,
    pub(super) max_displacement_m: f64,
}

/// Files the route's present version with its picture as one that has ended.
pub(super) async fn file(
    transaction: &mut SqliteConnection,
    route_key: i64,
    picture: &SealedPicture,
    at_us: i64,
) -> Result<(), StoreError> {
    sqlx::query(
        "INSERT INTO map_versions (route_key, version, epoch, created_at_us, superseded_at_us, \
         cause_alert_id, cause_action, cause_by, cause_note, max_displacement_m, \
         png, pgm, pgm_bytes, pgm_sha256, yaml) \
         SELECT route_key, map_version, epoch, coalesce(version_created_at_us, created_at_us), \
         $2, version_alert_id, version_action, version_by, version_note, \
         version_max_displacement_m, $3, $4, $5, $6, $7 \
         FROM routes WHERE route_key = $1",
    )
    .bind(route_key)
    .bind(at_us)
    .bind(picture.png.as_slice())
    .bind(picture.pgm.compressed.as_slice())
    .bind(picture.pgm.bytes)
    .bind(picture.pgm.sha256.as_slice())
    .bind(&picture.yaml)
    .execute(transaction)
    .await?;
    Ok(())
}

/// Begins the route's next version. A decision begins an epoch too; a release leaves what new scans
/// are compared with as it is.
pub(super) async fn begin(
    transaction: &mut SqliteConnection,
    route_key: i64,
    next: &Beginning<'_>,
) -> Result<(), StoreError> {
    sqlx::query(
        "UPDATE routes SET map_version = map_version + 1, epoch = epoch + ($3 IS NOT NULL), \
         version_created_at_us = $2, version_alert_id = $3, version_action = $4, \
         version_by = $5, version_note = $6, version_max_displacement_m = $7 \
         WHERE route_key = $1",
    )
    .bind(route_key)
    .bind(next.at_us)
    .bind(next.decided.map(|(alert, _)| alert.to_string()))
    .bind(next.decided.map(|(_, action)| action.name()))
    .bind(next.by)
    .bind(next.note)
    .bind(next.max_displacement_m)
    .execute(transaction)
    .await?;
    Ok(())
}
