//! Keys: made, revoked, recognised.

use std::sync::atomic::Ordering;

use jiff::{SignedDuration, Timestamp};
use serde_json::json;
use sqlx::sqlite::SqliteRow;
use sqlx::{Row, SqliteConnection};

use super::Store;
use super::audit::{self, Change};
use super::columns::{
    corrupt, json_text, micros, optional_json, optional_name, optional_time, text, time,
};
use super::error::StoreError;
use super::key_records::{KeyRecord, NewKey};
use super::query::Query;
use super::request::Request;
use super::secrets::KeyText;
use crate::ids::KeyId;
use crate::model::{Actor, AuditAction};

/// The resolution of the last use of keys and sessions: each note is a write.
const USE_NOTED_EVERY: SignedDuration = SignedDuration::from_mins(5);

impl Store {
    /// Whether a key was ever made: from then on requests are authenticated.
    pub fn has_keys(&self) -> bool {
        self.shared.has_keys.load(Ordering::Acquire)
    }

    /// Grows with every revocation, so that long connections know when to check their key again.
    pub fn revocations(&self) -> u64 {
        self.shared.revocations.load(Ordering::Acquire)
    }

    /// Makes a key.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn create_key(&self, key: NewKey, by: &Actor) -> Result<(), StoreError> {
        let by = by.clone();
        self.work(Create { key, by }).await?;
        self.shared.has_keys.store(true, Ordering::Release);
        Ok(())
    }

    /// Ends a key and the sessions that were begun with it; one that has ended stays as it is. False if
    /// there is no such key.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn revoke_key(
        &self,
        id: KeyId,
        by: &Actor,
        now: Timestamp,
    ) -> Result<bool, StoreError> {
        let by = by.clone();
        let is_known = self.work(Revoke { id, by, now }).await?;
        self.shared.revocations.fetch_add(1, Ordering::AcqRel);
        Ok(is_known)
    }

    /// One key.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn key(&self, id: KeyId) -> Result<Option<KeyRecord>, StoreError> {
        self.read(OneKey(id)).await
    }

    /// By id, that is the oldest first, after `after`, at most `limit`.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn keys(
        &self,
        after: Option<KeyId>,
        limit: u32,
    ) -> Result<Vec<KeyRecord>, StoreError> {
        self.read(KeyPage { after, limit }).await
    }

    /// The key whose secret somebody has shown, if it is live; notes its use from time to time.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn key_shown(
        &self,
        shown: &KeyText,
        now: Timestamp,
    ) -> Result<Option<KeyRecord>, StoreError> {
        let found = self.read(KeyShown(shown)).await?;
        let key = found.filter(|key| key.is_live(now));
        if let Some(key) = &key
            && is_worth_noting(key.last_used_at, now)
        {
            let id = key.id;
            // A failure to note the use is no reason to refuse the key.
            let _ = self.work(NoteUse { id, now }).await;
        }
        Ok(key)
    }
}

/// Whether a use is noted.
pub(super) fn is_worth_noting(last: Option<Timestamp>, now: Timestamp) -> bool {
    last.is_none_or(|last| now.duration_since(last) >= USE_NOTED_EVERY)
}

/// Whether a key was ever made.
pub(super) struct AnyKey;

impl Query for AnyKey {
    type Answer = bool;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let any = sqlx::query_scalar("SELECT EXISTS (SELECT 1 FROM keys)");
        Ok(any.fetch_one(reader).await?)
    }
}

struct Create {
    key: NewKey,
    by: Actor,
}

impl Request for Create {
    type Outcome = ();
    const QUEUES_JOBS: bool = false;

    async fn execute(&self, transaction: &mut SqliteConnection) -> Result<(), StoreError> {
        let new = &self.key;
        let id = new.id.to_string();
        sqlx::query(
            "INSERT INTO keys (id, name, role, vehicle_id, routes, secret_sha256, created_at_us, \
             created_by, expires_at_us) VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9)",
        )
        .bind(&id)
        .bind(&new.name)
        .bind(new.role.name())
        .bind(new.vehicle_id.as_ref().map(|vehicle| vehicle.as_str()))
        .bind(new.routes.as_ref().map(json_text).transpose()?)
        .bind(new.secret.digest().as_slice())
        .bind(micros(new.created_at))
        .bind(self.by.name())
        .bind(new.expires_at.map(micros))
        .execute(&mut *transaction)
        .await?;
        let made = OneKey(new.id).answer(transaction).await?;
        let change = Change {
            at: new.created_at,
            actor: &self.by,
            action: AuditAction::KeyCreated,
            route_id: None,
            subject: &id,
            before: None,
            after: made.as_ref().map(audited),
        };
        audit::write(transaction, change).await
    }
}

struct Revoke {
    id: KeyId,
    by: Actor,
    now: Timestamp,
}

impl Request for Revoke {
    type Outcome = bool;
    const QUEUES_JOBS: bool = false;
    const WHILE_FULL: bool = true;

    async fn execute(&self, transaction: &mut SqliteConnection) -> Result<bool, StoreError> {
        let id = self.id.to_string();
        let Some(before) = OneKey(self.id).answer(transaction).await? else {
            return Ok(false);
        };
        if before.revoked_at.is_some() {
            return Ok(true);
        }
        sqlx::query("UPDATE keys SET revoked_at_us = $1 WHERE id = $2")
            .bind(micros(self.now))
            .bind(&id)
            .execute(&mut *transaction)
            .await?;
        sqlx::query(
            "DELETE FROM sessions WHERE key_key = (SELECT key_key FROM keys WHERE id = $1)",
        )
        .bind(&id)
        .execute(&mut *transaction)
        .await?;
        let after = OneKey(self.id).answer(transaction).await?;
        let change = Change {
            at: self.now,
            actor: &self.by,
            action: AuditAction::KeyRevoked,
            route_id: None,
            subject: &id,
            before: Some(audited(&before)),
            after: after.as_ref().map(audited),
        };
        audit::write(transaction, change).await?;
        Ok(true)
    }
}

struct NoteUse {
    id: KeyId,
    now: Timestamp,
}

impl Request for NoteUse {
    type Outcome = ();
    const QUEUES_JOBS: bool = false;
    const WHILE_FULL: bool = true;

    async fn execute(&self, transaction: &mut SqliteConnection) -> Result<(), StoreError> {
        sqlx::query("UPDATE keys SET last_used_at_us = $1 WHERE id = $2")
            .bind(micros(self.now))
            .bind(self.id.to_string())
            .execute(transaction)
            .await?;
        Ok(())
    }
}

/// A key as the audit has it.
fn audited(key: &KeyRecord) -> String {
    json!({
        "name": key.name,
        "role": key.role,
        "vehicle_id": key.vehicle_id,
        "routes": key.routes,
        "expires_at": key.expires_at,
        "revoked_at": key.revoked_at,
    })
    .to_string()
}

/// One key.
struct OneKey(KeyId);

impl Query for OneKey {
    type Answer = Option<KeyRecord>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let row = row_of(reader, self.0).await?;
        row.as_ref().map(key_of).transpose()
    }
}

/// The key of an id, if the secret is its own.
struct KeyShown<'a>(&'a KeyText);

impl Query for KeyShown<'_> {
    type Answer = Option<KeyRecord>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let Some(row) = row_of(reader, self.0.id).await? else {
            return Ok(None);
        };
        match self.0.secret.has_digest(row.try_get("secret_sha256")?) {
            true => key_of(&row).map(Some),
            false => Ok(None),
        }
    }
}

async fn row_of(reader: &mut SqliteConnection, id: KeyId) -> Result<Option<SqliteRow>, StoreError> {
    let row = sqlx::query("SELECT * FROM keys WHERE id = $1")
        .bind(id.to_string())
        .fetch_optional(reader)
        .await?;
    Ok(row)
}

/// By id, after `after`.
struct KeyPage {
    after: Option<KeyId>,
    limit: u32,
}

impl Query for KeyPage {
    type Answer = Vec<KeyRecord>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let rows = sqlx::query("SELECT * FROM keys WHERE id > $1 ORDER BY id LIMIT $2")
            .bind(self.after.map_or_else(String::new, |id| id.to_string()))
            .bind(self.limit)
            .fetch_all(reader)
            .await?;
        rows.iter().map(key_of).collect()
    }
}

/// The key of a row that has all columns of the table.
pub(super) fn key_of(row: &SqliteRow) -> Result<KeyRecord, StoreError> {
    let id: &str = row.try_get("id")?;
    Ok(KeyRecord {
        id: id.parse().map_err(|_| corrupt("id"))?,
        name: row.try_get("name")?,
        role: text(row, "role")?,
        vehicle_id: optional_name(row, "vehicle_id")?,
        routes: optional_json(row, "routes")?,
        created_at: time(row, "created_at_us")?,
        created_by: row.try_get("created_by")?,
        last_used_at: optional_time(row, "last_used_at_us")?,
        expires_at: optional_time(row, "expires_at_us")?,
        revoked_at: optional_time(row, "revoked_at_us")?,
    })
}
