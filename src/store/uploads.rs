//! An upload on its way into the journal: its row, its body and its job are one commit.

use sqlx::SqliteConnection;

use super::batch_ends::batch_ended;
use super::body::SealedBody;
use super::columns::{flags_text, micros};
use super::error::StoreError;
use super::records::{Journaled, NewBatch};
use super::request::Request;
use super::trips::{Place, Placement, add_job, place};
use super::{Store, news, outcome};
use crate::model::BatchStatus;

impl Store {
    /// Stores an upload and, if it is its turn in its trip, its job. Returns after the commit has
    /// reached the disk. A fault of its place in its trip becomes its status.
    ///
    /// # Errors
    /// [`StoreError::UnknownRoute`], [`StoreError::Full`], [`StoreError::Unavailable`].
    pub async fn journal_batch(&self, mut batch: NewBatch) -> Result<Journaled, StoreError> {
        let body = std::mem::take(&mut batch.body);
        // Compressing a large body takes milliseconds: not on the async threads, not in the
        // writer.
        let body = tokio::task::spawn_blocking(move || SealedBody::seal(&body))
            .await
            .map_err(|_| StoreError::Unavailable)??;
        let request = Journal { batch, body };
        let reply = self.shared.outbox.send_upload(request).await?;
        let written = outcome::<Journal>(reply).await?;
        let (journaled, _) = written.ok_or(StoreError::UnknownRoute)?;
        Ok(journaled)
    }
}

/// Stores an upload and, if it is its turn, its job.
pub(super) struct Journal {
    /// The upload; its body is in `body`.
    pub(super) batch: NewBatch,
    /// The body as it is stored.
    pub(super) body: SealedBody,
}

impl Request for Journal {
    /// With the place of a batch that is stored; `None`: there is no such route.
    type Outcome = Option<(Journaled, Option<Placement>)>;
    const QUEUES_JOBS: bool = true;

    async fn execute(
        &self,
        transaction: &mut SqliteConnection,
    ) -> Result<Self::Outcome, StoreError> {
        // The id is queried before the insert, so that a replay writes nothing. There is only one
        // writer, and the table has a UNIQUE constraint as well.
        let found: Option<(i64, Option<Vec<u8>>)> = sqlx::query_as(
            "SELECT routes.route_key, body_sha256 FROM routes \
             LEFT JOIN batches ON batches.route_key = routes.route_key AND batches.id = $1 \
             WHERE routes.id = $2",
        )
        .bind(self.batch.id.as_str())
        .bind(self.batch.route_id.as_str())
        .fetch_optional(&mut *transaction)
        .await?;
        let written = match found {
            None => return Ok(None),
            Some((_, Some(sha256))) if sha256 == self.body.sha256 => (Journaled::Replayed, None),
            Some((_, Some(_))) => (Journaled::Conflict, None),
            Some((route_key, None)) => {
                let placement = self.store(transaction, route_key).await?;
                (Journaled::Stored, Some(placement))
            }
        };
        Ok(Some(written))
    }

    fn committed(&self, written: &Self::Outcome) {
        let placement = written
            .as_ref()
            .and_then(|(_, placement)| placement.as_ref());
        if let Some(placement) = placement.filter(|it| it.status == BatchStatus::Quarantined) {
            let reason = placement.reason.as_deref().unwrap_or_default();
            news::quarantined(self.batch.route_id.as_str(), self.batch.id.as_str(), reason);
        }
    }
}

impl Journal {
    /// Writes the batch, whose id is not there, and its job if it is its turn.
    pub(super) async fn store(
        &self,
        transaction: &mut SqliteConnection,
        route_key: i64,
    ) -> Result<Placement, StoreError> {
        self.count(transaction, route_key).await?;
        let placement = place(transaction, route_key, &self.batch).await?;
        let batch_key = self.insert(transaction, route_key, &placement).await?;
        sqlx::query("INSERT INTO batch_bodies (batch_key, body) VALUES ($1, $2)")
            .bind(batch_key)
            .bind(&self.body.compressed)
            .execute(&mut *transaction)
            .await?;
        if placement.status == BatchStatus::Queued {
            let place = Place {
                batch_key,
                route_key,
                trip_id: self.batch.trip_id.to_string(),
                sequence: placement.sequence,
            };
            add_job(transaction, &place).await?;
        }
        if placement.status == BatchStatus::Quarantined {
            batch_ended(transaction, batch_key, self.batch.received_at).await?;
        }
        Ok(placement)
    }

    /// Adds the batch to the route's counts; before the insert, since a vehicle is counted with its
    /// first batch.
    async fn count(
        &self,
        transaction: &mut SqliteConnection,
        route_key: i64,
    ) -> Result<(), StoreError> {
        sqlx::query(
            "UPDATE routes SET batches = batches + 1, scans = scans + $1, vehicles = vehicles + \
             NOT EXISTS (SELECT 1 FROM batches WHERE route_key = $2 AND vehicle_id = $3) \
             WHERE route_key = $2",
        )
        .bind(self.batch.content.scans())
        .bind(route_key)
        .bind(self.batch.vehicle_id.as_str())
        .execute(transaction)
        .await?;
        Ok(())
    }

    async fn insert(
        &self,
        transaction: &mut SqliteConnection,
        route_key: i64,
        placement: &Placement,
    ) -> Result<i64, StoreError> {
        let batch = &self.batch;
        let batch_key = sqlx::query_scalar(
            "INSERT INTO batches (route_key, id, vehicle_id, trip_id, kind, sequence, status, \
             reason, flags, above_range_max, below_range_min, extensions, scans, body_sha256, \
             body_bytes, received_at_us) \
             VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11, $12, $13, $14, $15, $16) \
             RETURNING batch_key",
        )
        .bind(route_key)
        .bind(batch.id.as_str())
        .bind(batch.vehicle_id.as_str())
        .bind(batch.trip_id.as_str())
        .bind(batch.content.kind().name())
        .bind(placement.sequence)
        .bind(placement.status.name())
        .bind(placement.reason.as_deref())
        .bind(flags_text(&batch.flags))
        .bind(batch.out_of_range.map(|readings| readings.above_range_max))
        .bind(batch.out_of_range.map(|readings| readings.below_range_min))
        .bind(batch.extensions.as_deref())
        .bind(batch.content.scans())
        .bind(self.body.sha256.as_slice())
        .bind(self.body.bytes)
        .bind(micros(batch.received_at))
        .fetch_one(transaction)
        .await?;
        Ok(batch_key)
    }
}
