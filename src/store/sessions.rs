//! Sessions: what a person's browser holds in place of a key.

use jiff::Timestamp;
use sqlx::SqliteConnection;

use super::Store;
use super::columns::{micros, time};
use super::error::StoreError;
use super::key_records::{SESSION_IDLE_MAX, SESSION_MAX, SessionRecord};
use super::keys::{is_worth_noting, key_of};
use super::query::Query;
use super::request::Request;
use super::secrets::Secret;
use crate::ids::KeyId;

impl Store {
    /// Begins a session with a key that is live, and clears away those that have ended.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn begin_session(
        &self,
        id: &Secret,
        key: KeyId,
        now: Timestamp,
    ) -> Result<(), StoreError> {
        let id = id.digest();
        self.work(Begin { id, key, now }).await
    }

    /// The session of this id, if it goes on; notes its use from time to time.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn session(
        &self,
        id: &Secret,
        now: Timestamp,
    ) -> Result<Option<SessionRecord>, StoreError> {
        let id = id.digest();
        let found = self.read(OneSession(&id)).await?;
        let session = found.filter(|session| session.is_live(now));
        if let Some(session) = &session
            && is_worth_noting(Some(session.last_used_at), now)
        {
            // A failure to note the use is no reason to end the session.
            let _ = self.work(NoteUse { id, now }).await;
        }
        Ok(session)
    }

    /// Ends a session, if there is one of this id.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn end_session(&self, id: &Secret) -> Result<(), StoreError> {
        self.work(End { id: id.digest() }).await
    }
}

struct Begin {
    id: [u8; 32],
    key: KeyId,
    now: Timestamp,
}

impl Request for Begin {
    type Outcome = ();
    const QUEUES_JOBS: bool = false;
    const WHILE_FULL: bool = true;

    async fn execute(&self, transaction: &mut SqliteConnection) -> Result<(), StoreError> {
        let before = |age| self.now.saturating_sub(age).map_or(0, micros);
        sqlx::query("DELETE FROM sessions WHERE created_at_us <= $1 OR last_used_at_us <= $2")
            .bind(before(SESSION_MAX))
            .bind(before(SESSION_IDLE_MAX))
            .execute(&mut *transaction)
            .await?;
        sqlx::query(
            "INSERT INTO sessions (id_sha256, key_key, created_at_us, last_used_at_us) \
             SELECT $1, key_key, $3, $3 FROM keys WHERE id = $2",
        )
        .bind(self.id.as_slice())
        .bind(self.key.to_string())
        .bind(micros(self.now))
        .execute(transaction)
        .await?;
        Ok(())
    }
}

struct NoteUse {
    id: [u8; 32],
    now: Timestamp,
}

impl Request for NoteUse {
    type Outcome = ();
    const QUEUES_JOBS: bool = false;
    const WHILE_FULL: bool = true;

    async fn execute(&self, transaction: &mut SqliteConnection) -> Result<(), StoreError> {
        sqlx::query("UPDATE sessions SET last_used_at_us = $1 WHERE id_sha256 = $2")
            .bind(micros(self.now))
            .bind(self.id.as_slice())
            .execute(transaction)
            .await?;
        Ok(())
    }
}

struct End {
    id: [u8; 32],
}

impl Request for End {
    type Outcome = ();
    const QUEUES_JOBS: bool = false;
    const WHILE_FULL: bool = true;

    async fn execute(&self, transaction: &mut SqliteConnection) -> Result<(), StoreError> {
        sqlx::query("DELETE FROM sessions WHERE id_sha256 = $1")
            .bind(self.id.as_slice())
            .execute(transaction)
            .await?;
        Ok(())
    }
}

/// The session of an id's digest, whether it goes on or not.
struct OneSession<'a>(&'a [u8; 32]);

impl Query for OneSession<'_> {
    type Answer = Option<SessionRecord>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let row = sqlx::query(
            "SELECT keys.*, sessions.created_at_us AS begun_at_us, \
             sessions.last_used_at_us AS session_used_at_us \
             FROM sessions JOIN keys USING (key_key) WHERE id_sha256 = $1",
        )
        .bind(self.0.as_slice())
        .fetch_optional(reader)
        .await?;
        let record = |row: &_| {
            Ok(SessionRecord {
                key: key_of(row)?,
                created_at: time(row, "begun_at_us")?,
                last_used_at: time(row, "session_used_at_us")?,
            })
        };
        row.as_ref().map(record).transpose()
    }
}
