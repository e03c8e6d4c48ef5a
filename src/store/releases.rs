//! Releasing a version of a route's map for vehicles, and withdrawing it.

use jiff::Timestamp;
use serde::Serialize;
use sqlx::SqliteConnection;

use super::Store;
use super::alert_records::{Decided, Release};
use super::audit::{self, Change};
use super::columns::{json_text, micros};
use super::decisions::raise_revision;
use super::error::StoreError;
use super::inputs::{self, Input};
use super::map_versions::{self, Beginning, SealedPicture};
use super::request::Request;
use crate::ids::RouteId;
use crate::model::{Actor, AuditAction, VersionState};

impl Store {
    /// Releases the present version of a route's map and begins the next one, all or nothing.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn apply_release(&self, release: Release) -> Result<Decided, StoreError> {
        let sealed = tokio::task::spawn_blocking(|| ApplyRelease::seal(release));
        let request = sealed.await.map_err(|_| StoreError::Unavailable)??;
        self.work(request).await
    }

    /// Withdraws a released version of a route's map. False if it is not released, or not there.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn retire_version(
        &self,
        route: &RouteId,
        version: i64,
        by: &Actor,
        at: Timestamp,
    ) -> Result<bool, StoreError> {
        let request = RetireVersion {
            route: route.clone(),
            version,
            by: by.clone(),
            at,
        };
        self.work(request).await
    }
}

/// Releases a version, unless the route has another revision by now.
struct ApplyRelease {
    release: Release,
    picture: SealedPicture,
}

impl ApplyRelease {
    /// Compresses the picture; milliseconds of work for a large map.
    fn seal(mut release: Release) -> Result<Self, StoreError> {
        let picture = SealedPicture::seal(std::mem::take(&mut release.picture))?;
        Ok(Self { release, picture })
    }

    async fn note(
        &self,
        transaction: &mut SqliteConnection,
        route_key: i64,
    ) -> Result<(), StoreError> {
        let Release {
            route_id,
            version,
            actor,
            release,
            ..
        } = &self.release;
        let input = Input::VersionReleased {
            version: *version,
            by: release.by.clone(),
            note: release.note.clone(),
        };
        inputs::note(transaction, route_key, release.at, &input).await?;
        let sha256 = self.picture.sha256().iter();
        let after = AuditedVersion {
            state: VersionState::Released,
            sha256: Some(sha256.map(|byte| format!("{byte:02x}")).collect()),
            note: release.note.as_deref(),
        };
        let before = AuditedVersion::of(VersionState::Draft);
        let change = Change {
            at: release.at,
            actor,
            action: AuditAction::VersionReleased,
            route_id: Some(route_id.as_str()),
            subject: &version.to_string(),
            before: Some(json_text(&before)?),
            after: Some(json_text(&after)?),
        };
        audit::write(transaction, change).await
    }
}

impl Request for ApplyRelease {
    type Outcome = Decided;
    const QUEUES_JOBS: bool = false;

    async fn execute(&self, transaction: &mut SqliteConnection) -> Result<Decided, StoreError> {
        let Release {
            route_id,
            version,
            base_revision,
            release,
            ..
        } = &self.release;
        let route_key: Option<i64> = sqlx::query_scalar(
            "SELECT route_key FROM routes WHERE id = $1 AND revision = $2 AND map_version = $3",
        )
        .bind(route_id.as_str())
        .bind(base_revision)
        .bind(version)
        .fetch_optional(&mut *transaction)
        .await?;
        let Some(route_key) = route_key else {
            return Ok(Decided::Stale);
        };
        let at_us = micros(release.at);
        map_versions::file(transaction, route_key, &self.picture, at_us).await?;
        sqlx::query(
            "UPDATE map_versions SET released_at_us = $1, released_by = $2, release_note = $3 \
             WHERE route_key = $4 AND version = $5",
        )
        .bind(at_us)
        .bind(&release.by)
        .bind(&release.note)
        .bind(route_key)
        .bind(version)
        .execute(&mut *transaction)
        .await?;
        let next = Beginning {
            at_us,
            decided: None,
            by: Some(&release.by),
            note: release.note.as_deref(),
            max_displacement_m: 0.0,
        };
        map_versions::begin(transaction, route_key, &next).await?;
        raise_revision(transaction, route_key, at_us).await?;
        self.note(transaction, route_key).await?;
        Ok(Decided::Committed)
    }
}

struct RetireVersion {
    route: RouteId,
    version: i64,
    by: Actor,
    at: Timestamp,
}

impl Request for RetireVersion {
    type Outcome = bool;
    const QUEUES_JOBS: bool = false;

    async fn execute(&self, transaction: &mut SqliteConnection) -> Result<bool, StoreError> {
        let retired: Option<i64> = sqlx::query_scalar(
            "UPDATE map_versions SET retired_at_us = $1 \
             WHERE route_key = (SELECT route_key FROM routes WHERE id = $2) AND version = $3 \
             AND released_at_us IS NOT NULL AND retired_at_us IS NULL RETURNING route_key",
        )
        .bind(micros(self.at))
        .bind(self.route.as_str())
        .bind(self.version)
        .fetch_optional(&mut *transaction)
        .await?;
        let Some(route_key) = retired else {
            return Ok(false);
        };
        let input = Input::VersionRetired {
            version: self.version,
        };
        inputs::note(transaction, route_key, self.at, &input).await?;
        let states = [VersionState::Released, VersionState::Retired];
        let [before, after] = states.map(|state| json_text(&AuditedVersion::of(state)));
        let change = Change {
            at: self.at,
            actor: &self.by,
            action: AuditAction::VersionRetired,
            route_id: Some(self.route.as_str()),
            subject: &self.version.to_string(),
            before: Some(before?),
            after: Some(after?),
        };
        audit::write(transaction, change).await?;
        Ok(true)
    }
}

/// A version as the audit has it.
#[derive(Serialize)]
struct AuditedVersion<'a> {
    state: VersionState,
    #[serde(skip_serializing_if = "Option::is_none")]
    sha256: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    note: Option<&'a str>,
}

impl AuditedVersion<'_> {
    fn of(state: VersionState) -> Self {
        Self {
            state,
            sha256: None,
            note: None,
        }
    }
}
