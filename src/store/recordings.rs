//! Recordings: trips that come as one file, journalled as batches of scans in one commit.

use std::fs::File;
use std::io;
use std::path::PathBuf;

use sqlx::SqliteConnection;

use super::body::{Checksum, SealedBody};
use super::error::StoreError;
use super::query::Query;
use super::records::NewBatch;
use super::request::Request;
use super::uploads::Journal;
use super::{Store, outcome};
use crate::ids::{BatchId, RouteId, TripId};

/// The batches of a recording in the order of time, ready to be stored. The last one has the recording's
/// name.
#[derive(Default)]
pub struct RecordedBatches {
    parts: Vec<Journal>,
    compressed_bytes: usize,
}

/// What became of a recording.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RecordingJournaled {
    /// All its batches are committed to disk.
    Stored,
    /// The same recording was there already.
    Replayed,
    /// The name of one of its batches is taken by another upload; nothing was stored.
    Conflict,
    /// The trip has batches already; nothing was stored.
    TripTaken,
}

impl RecordedBatches {
    /// Compresses and adds the next batch: milliseconds of work.
    ///
    /// # Errors
    /// [`StoreError::Compression`].
    pub fn push(&mut self, mut batch: NewBatch) -> Result<(), StoreError> {
        let body = SealedBody::seal(&std::mem::take(&mut batch.body))?;
        self.compressed_bytes += body.compressed.len();
        self.parts.push(Journal { batch, body });
        Ok(())
    }

    /// The memory that they take.
    pub fn compressed_bytes(&self) -> usize {
        self.compressed_bytes
    }

    /// The batch that was added last, to be named.
    pub fn last_mut(&mut self) -> Option<&mut NewBatch> {
        self.parts.last_mut().map(|part| &mut part.batch)
    }
}

impl Store {
    /// Stores the batches of a recording, all of them or none. `identity` is the checksum of everything
    /// that makes the recording the same one.
    ///
    /// # Errors
    /// [`StoreError::UnknownRoute`], [`StoreError::Full`], [`StoreError::Unavailable`].
    pub async fn journal_recording(
        &self,
        batches: RecordedBatches,
        identity: Checksum,
    ) -> Result<RecordingJournaled, StoreError> {
        let request = JournalRecording {
            parts: batches.parts,
            identity,
        };
        let reply = self.shared.outbox.send_upload(request).await?;
        let journaled = outcome::<JournalRecording>(reply).await?;
        journaled.ok_or(StoreError::UnknownRoute)
    }

    /// Whether a batch of this name is the recording that is about to be stored, or another upload;
    /// `None` if there is no such batch.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn recording(
        &self,
        route: &RouteId,
        id: &BatchId,
        identity: &Checksum,
    ) -> Result<Option<RecordingJournaled>, StoreError> {
        let recorded = RecordedAs {
            route,
            id,
            identity,
        };
        self.read(recorded).await
    }

    /// A file for at most so many bytes in the data directory that nobody else can open, and that is gone
    /// when it is closed, also by a crash.
    ///
    /// # Errors
    /// [`StoreError::Full`] if the disk has no room for it, [`StoreError::Directory`].
    pub async fn temporary_file(&self, bytes: u64) -> Result<File, StoreError> {
        let path = self.shared.data_dir.clone();
        let space = self.shared.space.clone();
        let made = tokio::task::spawn_blocking(move || match space.has_room_for(bytes) {
            true => tempfile::tempfile_in(&path).map_err(|source| not_made(path, source)),
            false => Err(StoreError::Full),
        });
        made.await.map_err(|_| StoreError::Unavailable)?
    }
}

/// Whether a batch of this name is a recording that is about to be stored.
struct RecordedAs<'a> {
    route: &'a RouteId,
    id: &'a BatchId,
    identity: &'a Checksum,
}

impl Query for RecordedAs<'_> {
    type Answer = Option<RecordingJournaled>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let found: Option<Option<Vec<u8>>> = sqlx::query_scalar(
            "SELECT recording_sha256 FROM batches JOIN routes USING (route_key) \
             WHERE routes.id = $1 AND batches.id = $2",
        )
        .bind(self.route.as_str())
        .bind(self.id.as_str())
        .fetch_optional(reader)
        .await?;
        Ok(found.map(|stored| same_or_conflict(stored.as_deref(), self.identity)))
    }
}

fn not_made(path: PathBuf, source: io::Error) -> StoreError {
    match source.kind() {
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => StoreError::Full,
        _ => StoreError::Directory { path, source },
    }
}

fn same_or_conflict(stored: Option<&[u8]>, identity: &Checksum) -> RecordingJournaled {
    match stored == Some(identity.as_slice()) {
        true => RecordingJournaled::Replayed,
        false => RecordingJournaled::Conflict,
    }
}

/// Stores all batches of a recording.
struct JournalRecording {
    parts: Vec<Journal>,
    identity: Checksum,
}

impl Request for JournalRecording {
    /// `None`: there is no such route.
    type Outcome = Option<RecordingJournaled>;
    const QUEUES_JOBS: bool = true;

    async fn execute(
        &self,
        transaction: &mut SqliteConnection,
    ) -> Result<Option<RecordingJournaled>, StoreError> {
        let Some(last) = self.parts.last().map(|part| &part.batch) else {
            return Err(StoreError::InvalidResult(
                "a recording without batches".into(),
            ));
        };
        let route_key: Option<i64> =
            sqlx::query_scalar("SELECT route_key FROM routes WHERE id = $1")
                .bind(last.route_id.as_str())
                .fetch_optional(&mut *transaction)
                .await?;
        let Some(route_key) = route_key else {
            return Ok(None);
        };
        // The last one first: it says whether the recording is there.
        for part in self.parts.iter().rev() {
            let stored = identity_of(transaction, route_key, &part.batch.id).await?;
            if let Some(stored) = stored {
                return Ok(Some(same_or_conflict(stored.as_deref(), &self.identity)));
            }
        }
        if is_taken(transaction, route_key, &last.trip_id).await? {
            return Ok(Some(RecordingJournaled::TripTaken));
        }
        for part in &self.parts {
            part.store(transaction, route_key).await?;
        }
        sqlx::query("UPDATE batches SET recording_sha256 = $1 WHERE route_key = $2 AND id = $3")
            .bind(self.identity.as_slice())
            .bind(route_key)
            .bind(last.id.as_str())
            .execute(&mut *transaction)
            .await?;
        Ok(Some(RecordingJournaled::Stored))
    }
}

/// The identity of the recording that a batch of this name stands for, if it stands for one; `None` if
/// there is no such batch.
async fn identity_of(
    transaction: &mut SqliteConnection,
    route_key: i64,
    id: &BatchId,
) -> Result<Option<Option<Vec<u8>>>, StoreError> {
    let found =
        sqlx::query_scalar("SELECT recording_sha256 FROM batches WHERE route_key = $1 AND id = $2")
            .bind(route_key)
            .bind(id.as_str())
            .fetch_optional(transaction)
            .await?;
    Ok(found)
}

/// Whether a trip has batches, or had some whose turn is over.
async fn is_taken(
    transaction: &mut SqliteConnection,
    route_key: i64,
    trip_id: &TripId,
) -> Result<bool, StoreError> {
    let is_taken = sqlx::query_scalar(
        "SELECT EXISTS (SELECT 1 FROM trips WHERE route_key = $1 AND trip_id = $2 \
         AND next_sequence > 0) \
         OR EXISTS (SELECT 1 FROM batches WHERE route_key = $1 AND trip_id = $2 \
         AND status <> 'removed')",
    )
    .bind(route_key)
    .bind(trip_id.as_str())
    .fetch_one(transaction)
    .await?;
    Ok(is_taken)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::StoreOptions;

    #[tokio::test]
    async fn a_file_that_the_disk_has_no_room_for_is_not_begun() {
        let directory = tempfile::tempdir().unwrap();
        let data_dir = directory.path().to_path_buf();
        let store = Store::open(StoreOptions { data_dir }).await.unwrap();
        assert!(store.temporary_file(1).await.is_ok());
        let refused = store.temporary_file(u64::MAX).await;
        assert!(matches!(refused, Err(StoreError::Full)), "{refused:?}");
        store.close().await.unwrap();
    }

    #[test]
    fn a_full_disk_is_distinguished_from_other_failures() {
        let error = |kind: io::ErrorKind| not_made(PathBuf::from("data"), kind.into());
        assert!(matches!(
            error(io::ErrorKind::StorageFull),
            StoreError::Full
        ));
        assert!(matches!(
            error(io::ErrorKind::PermissionDenied),
            StoreError::Directory { .. }
        ));
    }
}
