//! The order of the batches of a trip.
//!
//! A trip's batches are processed one after the other: the one whose sequence is due has a job, later
//! ones are held. When the turn of a batch ends, with whatever status, the next one is due. Batches of
//! edges are numbered as they arrive, so that each is due at once.

use sqlx::sqlite::SqliteRow;
use sqlx::{Row, SqliteConnection};

use super::error::StoreError;
use super::records::{BatchContent, NewBatch};
use crate::model::{BatchKind, BatchStatus};

/// Where a batch is put when it arrives.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Placement {
    /// Queued, held or quarantined.
    pub(super) status: BatchStatus,
    /// Why it is quarantined.
    pub(super) reason: Option<String>,
    /// Its place in its trip.
    pub(super) sequence: i64,
}

/// A batch's place in its trip.
#[derive(Debug, Clone)]
pub(super) struct Place {
    pub(super) batch_key: i64,
    pub(super) route_key: i64,
    pub(super) trip_id: String,
    pub(super) sequence: i64,
}

impl Place {
    /// Of a row of a batch or a job.
    pub(super) fn of(row: &SqliteRow, route_key: i64) -> Result<Self, StoreError> {
        Ok(Self {
            batch_key: row.try_get("batch_key")?,
            route_key,
            trip_id: row.try_get("trip_id")?,
            sequence: row.try_get("sequence")?,
        })
    }
}

/// Decides the status of a new batch; makes its trip if it is the first.
pub(super) async fn place(
    transaction: &mut SqliteConnection,
    route_key: i64,
    batch: &NewBatch,
) -> Result<Placement, StoreError> {
    // A trip all of whose batches were removed may be taken over by another vehicle.
    sqlx::query(
        "INSERT INTO trips (route_key, trip_id, vehicle_id, next_sequence) VALUES ($1, $2, $3, 0) \
         ON CONFLICT DO UPDATE SET vehicle_id = $3 WHERE vehicle_id <> $3 AND NOT EXISTS ( \
             SELECT 1 FROM batches WHERE batches.route_key = $1 AND batches.trip_id = $2 \
             AND batches.vehicle_id = trips.vehicle_id AND status <> 'removed')",
    )
    .bind(route_key)
    .bind(batch.trip_id.as_str())
    .bind(batch.vehicle_id.as_str())
    .execute(&mut *transaction)
    .await?;
    let (vehicle_id, next_sequence): (String, i64) = sqlx::query_as(
        "SELECT vehicle_id, next_sequence FROM trips WHERE route_key = $1 AND trip_id = $2",
    )
    .bind(route_key)
    .bind(batch.trip_id.as_str())
    .fetch_one(&mut *transaction)
    .await?;
    let trip_id = &batch.trip_id;
    let sequence = match batch.content {
        BatchContent::Scans { sequence, .. } => sequence,
        BatchContent::Edges => sequence_after_all(transaction, route_key, batch).await?,
    };
    let quarantined = |reason: String| {
        Ok(Placement {
            status: BatchStatus::Quarantined,
            reason: Some(reason),
            sequence,
        })
    };
    if vehicle_id != batch.vehicle_id.as_str() {
        return quarantined(format!("trip {trip_id} belongs to vehicle {vehicle_id}"));
    }
    if has_others(transaction, route_key, batch).await? {
        return quarantined(match batch.content.kind() {
            BatchKind::Scans => format!("trip {trip_id} has edges: send scans as another trip"),
            BatchKind::Edges => format!("trip {trip_id} has scans: send edges as another trip"),
        });
    }
    let holder = holder(transaction, route_key, batch, sequence).await?;
    if let Some(holder) = holder {
        return quarantined(format!(
            "sequence {sequence} of trip {trip_id} was already used by {holder}"
        ));
    }
    let status = match (batch.content, sequence.cmp(&next_sequence)) {
        (BatchContent::Edges, _) | (_, std::cmp::Ordering::Equal) => BatchStatus::Queued,
        (_, std::cmp::Ordering::Greater) => BatchStatus::Held,
        (_, std::cmp::Ordering::Less) => {
            return quarantined(format!(
                "sequence {sequence} of trip {trip_id} came after its successors were used"
            ));
        }
    };
    Ok(Placement {
        status,
        reason: None,
        sequence,
    })
}

/// The sequence after those of all batches of the trip.
async fn sequence_after_all(
    transaction: &mut SqliteConnection,
    route_key: i64,
    batch: &NewBatch,
) -> Result<i64, StoreError> {
    let sequence = sqlx::query_scalar(
        "SELECT coalesce(max(sequence) + 1, 0) FROM batches WHERE route_key = $1 AND trip_id = $2",
    )
    .bind(route_key)
    .bind(batch.trip_id.as_str())
    .fetch_one(transaction)
    .await?;
    Ok(sequence)
}

/// Whether the trip has batches of another kind, but for those that were refused on arrival.
async fn has_others(
    transaction: &mut SqliteConnection,
    route_key: i64,
    batch: &NewBatch,
) -> Result<bool, StoreError> {
    let has_others = sqlx::query_scalar(
        "SELECT EXISTS (SELECT 1 FROM batches WHERE route_key = $1 AND trip_id = $2 AND kind <> $3 \
         AND status <> 'removed' \
         AND (status <> 'quarantined' OR processed_at_us IS NOT NULL))",
    )
    .bind(route_key)
    .bind(batch.trip_id.as_str())
    .bind(batch.content.kind().name())
    .fetch_one(transaction)
    .await?;
    Ok(has_others)
}

/// The batch that has the sequence already; those that were refused on arrival do not count.
async fn holder(
    transaction: &mut SqliteConnection,
    route_key: i64,
    batch: &NewBatch,
    sequence: i64,
) -> Result<Option<String>, StoreError> {
    let holder: Option<String> = sqlx::query_scalar(
        "SELECT id FROM batches WHERE route_key = $1 AND trip_id = $2 AND sequence = $3 \
         AND status <> 'removed' \
         AND (status <> 'quarantined' OR processed_at_us IS NOT NULL) LIMIT 1",
    )
    .bind(route_key)
    .bind(batch.trip_id.as_str())
    .bind(sequence)
    .fetch_optional(transaction)
    .await?;
    Ok(holder)
}

/// Gives a batch a job that is due at once.
pub(super) async fn queue(
    transaction: &mut SqliteConnection,
    place: &Place,
) -> Result<(), StoreError> {
    sqlx::query("UPDATE batches SET status = 'queued' WHERE batch_key = $1")
        .bind(place.batch_key)
        .execute(&mut *transaction)
        .await?;
    add_job(transaction, place).await
}

/// Adds the job of a batch whose row says `queued` already.
pub(super) async fn add_job(
    transaction: &mut SqliteConnection,
    place: &Place,
) -> Result<(), StoreError> {
    sqlx::query(
        "INSERT INTO jobs (batch_key, route_key, trip_id, sequence, state) \
         VALUES ($1, $2, $3, $4, 'queued')",
    )
    .bind(place.batch_key)
    .bind(place.route_key)
    .bind(&place.trip_id)
    .bind(place.sequence)
    .execute(transaction)
    .await?;
    Ok(())
}

/// Ends a batch's turn: its job goes, and a held successor whose turn it is gets one.
pub(super) async fn end_turn(
    transaction: &mut SqliteConnection,
    place: &Place,
) -> Result<(), StoreError> {
    sqlx::query("DELETE FROM jobs WHERE batch_key = $1")
        .bind(place.batch_key)
        .execute(&mut *transaction)
        .await?;
    // The greater of the two: an unanchored batch has its turn again after later ones had theirs.
    let next_sequence: i64 = sqlx::query_scalar(
        "UPDATE trips SET next_sequence = max(next_sequence, $1) \
         WHERE route_key = $2 AND trip_id = $3 RETURNING next_sequence",
    )
    .bind(place.sequence + 1)
    .bind(place.route_key)
    .bind(&place.trip_id)
    .fetch_one(&mut *transaction)
    .await?;
    let successor: Option<i64> = sqlx::query_scalar(
        "SELECT batch_key FROM batches \
         WHERE route_key = $1 AND trip_id = $2 AND sequence = $3 AND status = 'held'",
    )
    .bind(place.route_key)
    .bind(&place.trip_id)
    .bind(next_sequence)
    .fetch_optional(&mut *transaction)
    .await?;
    if let Some(batch_key) = successor {
        let successor = Place {
            batch_key,
            sequence: next_sequence,
            ..place.clone()
        };
        queue(transaction, &successor).await?;
    }
    Ok(())
}

/// Continues a trip at a held batch whose predecessor never came.
pub(super) async fn skip_gap(
    transaction: &mut SqliteConnection,
    place: &Place,
) -> Result<(), StoreError> {
    sqlx::query("UPDATE trips SET next_sequence = $1 WHERE route_key = $2 AND trip_id = $3")
        .bind(place.sequence)
        .bind(place.route_key)
        .bind(&place.trip_id)
        .execute(&mut *transaction)
        .await?;
    queue(transaction, place).await
}
