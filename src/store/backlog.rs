//! The batches that wait for a place in the map, and which of them a job processes with its own.
//!
//! All batches of a job are loaded and decoded together, so their number is bounded. The oldest of a
//! trip come first, since scans enter the map in the order of their trip; once they are in it, the
//! next ones get a job, and so on.

use jiff::Timestamp;
use sqlx::sqlite::SqliteRow;
use sqlx::{Row, SqliteConnection};

use super::columns::{micros, name, text};
use super::error::StoreError;
use super::inputs;
use super::jobs::Job;
use super::trips::{Place, end_turn, queue};
use crate::ids::BatchId;
use crate::model::BatchKind;

/// Batches of scans of a job, at most: all are decoded whenever the trip is localised globally.
const BATCHES_MAX: i64 = 256;
/// Their bodies, decompressed, at most, unless a single one is longer.
const BYTES_MAX: i64 = 64 << 20;
/// Batches of edges that a job processes with its own, at most.
const EDGE_BATCHES_MAX: i64 = 63;

/// The batches of a job.
pub(super) struct Taken {
    /// Those that waited, then the job's own.
    pub(super) batch_ids: Vec<BatchId>,
    /// Whether the batch before the first of them is in no way part of the trip.
    pub(super) after_gap: bool,
    /// Whether the job's own is tried alone although others wait before it.
    pub(super) apart: bool,
}

/// A batch that waits, or a job's own.
struct Waiting {
    batch_id: BatchId,
    batch_key: i64,
    sequence: i64,
    body_bytes: i64,
}

/// The batches of a job: those that waited before its own in the trip, and its own. A job during which
/// a process was lost takes its own alone. `None` if more waits before it than a job may load: then its
/// batch waits as well, and the oldest that wait get a job if that can lead to anything.
pub(super) async fn take(
    transaction: &mut SqliteConnection,
    job: &Job,
    now: Timestamp,
) -> Result<Option<Taken>, StoreError> {
    let place = &job.place;
    let (kind, own) = own(transaction, place).await?;
    if kind == BatchKind::Edges {
        let batches = match job.orphaned {
            0 => of_edges(transaction, place, own).await?,
            _ => vec![own],
        };
        return Ok(Some(taken(batches, false)));
    }
    let mut waiting = before(transaction, place).await?;
    if job.orphaned > 0 && !waiting.is_empty() {
        let apart = true;
        return Ok(Some(Taken {
            apart,
            ..taken(vec![own], false)
        }));
    }
    waiting.push(own);
    let whole = waiting.len();
    cut(&mut waiting);
    if waiting.len() < whole {
        leave(transaction, place, &waiting, now).await?;
        return Ok(None);
    }
    let first = waiting.first().map_or(place.sequence, |w| w.sequence);
    let after_gap = first > 0 && !is_used(transaction, place, first - 1).await?;
    Ok(Some(taken(waiting, after_gap)))
}

fn taken(batches: Vec<Waiting>, after_gap: bool) -> Taken {
    Taken {
        batch_ids: batches.into_iter().map(|batch| batch.batch_id).collect(),
        after_gap,
        apart: false,
    }
}

/// Cuts a list to what one job may load, at least its first.
fn cut(batches: &mut Vec<Waiting>) {
    let mut bytes = 0_i64;
    let fits = |batch: &&Waiting| {
        bytes = bytes.saturating_add(batch.body_bytes);
        bytes <= BYTES_MAX
    };
    let count = batches.iter().take_while(fits).count();
    let most = usize::try_from(BATCHES_MAX).unwrap_or(usize::MAX);
    batches.truncate(count.clamp(1, most));
}

/// Queues a job for the oldest batches of a trip that wait, as many as one may take, unless a batch of
/// the trip has a job: after a batch of the trip has entered the map.
pub(super) async fn queue_oldest(
    transaction: &mut SqliteConnection,
    place: &Place,
) -> Result<(), StoreError> {
    let has_job: bool = sqlx::query_scalar(
        "SELECT EXISTS (SELECT 1 FROM jobs WHERE route_key = $1 AND trip_id = $2)",
    )
    .bind(place.route_key)
    .bind(&place.trip_id)
    .fetch_one(&mut *transaction)
    .await?;
    if has_job {
        return Ok(());
    }
    let all = Place {
        sequence: i64::MAX,
        ..place.clone()
    };
    let mut waiting = before(transaction, &all).await?;
    cut(&mut waiting);
    queue_last(transaction, place, &waiting).await
}

async fn queue_last(
    transaction: &mut SqliteConnection,
    place: &Place,
    batches: &[Waiting],
) -> Result<(), StoreError> {
    let Some(last) = batches.last() else {
        return Ok(());
    };
    let place = Place {
        batch_key: last.batch_key,
        sequence: last.sequence,
        ..place.clone()
    };
    queue(transaction, &place).await
}

/// Leaves a job's batch to wait behind others of its trip. The oldest of them get a job if the trip is
/// in the map, or if the map has grown since they were tried.
async fn leave(
    transaction: &mut SqliteConnection,
    place: &Place,
    oldest: &[Waiting],
    now: Timestamp,
) -> Result<(), StoreError> {
    let last_key = oldest.last().map(|last| last.batch_key);
    let is_worth_a_try: bool = sqlx::query_scalar(
        "SELECT EXISTS (SELECT 1 FROM batches WHERE route_key = $1 AND trip_id = $2 \
             AND status = 'merged' AND nodes_added > 0) \
         OR EXISTS (SELECT 1 FROM batches JOIN routes USING (route_key) \
             WHERE batch_key = $3 AND 4 * routes.nodes >= 5 * nodes_at_try + 80)",
    )
    .bind(place.route_key)
    .bind(&place.trip_id)
    .bind(last_key)
    .fetch_one(&mut *transaction)
    .await?;
    sqlx::query(
        "UPDATE batches SET status = 'unanchored', processed_at_us = $2, \
         reason = 'the trip has no place in the map yet: this batch follows when those before it \
         are in it', \
         nodes_at_try = (SELECT nodes FROM routes WHERE routes.route_key = batches.route_key) \
         WHERE batch_key = $1",
    )
    .bind(place.batch_key)
    .bind(micros(now))
    .execute(&mut *transaction)
    .await?;
    inputs::note_kept_out(transaction, place.batch_key, now).await?;
    end_turn(transaction, place).await?;
    match is_worth_a_try {
        true => queue_last(transaction, place, oldest).await,
        false => Ok(()),
    }
}

async fn own(
    transaction: &mut SqliteConnection,
    place: &Place,
) -> Result<(BatchKind, Waiting), StoreError> {
    let row = sqlx::query(
        "SELECT kind, id, batch_key, sequence, body_bytes FROM batches WHERE batch_key = $1",
    )
    .bind(place.batch_key)
    .fetch_one(transaction)
    .await?;
    Ok((text(&row, "kind")?, waiting_of(&row)?))
}

/// The oldest batches that wait before a place in a trip, one more than a job may take.
async fn before(
    transaction: &mut SqliteConnection,
    place: &Place,
) -> Result<Vec<Waiting>, StoreError> {
    let rows = sqlx::query(
        "SELECT id, batch_key, sequence, body_bytes FROM batches \
         WHERE route_key = $1 AND trip_id = $2 AND status = 'unanchored' AND sequence < $3 \
         AND kind = 'scans' ORDER BY sequence LIMIT $4",
    )
    .bind(place.route_key)
    .bind(&place.trip_id)
    .bind(place.sequence)
    .bind(BATCHES_MAX + 1)
    .fetch_all(transaction)
    .await?;
    rows.iter().map(waiting_of).collect()
}

/// The newest batches of edges of the job's vehicle that are not connected to the map yet, in the
/// order of arrival, and the job's own.
async fn of_edges(
    transaction: &mut SqliteConnection,
    place: &Place,
    own: Waiting,
) -> Result<Vec<Waiting>, StoreError> {
    let rows = sqlx::query(
        "SELECT id, batch_key, sequence, body_bytes FROM batches \
         WHERE route_key = $2 AND batch_key <> $1 AND status = 'unanchored' AND kind = 'edges' \
         AND vehicle_id = (SELECT vehicle_id FROM batches WHERE batch_key = $1) \
         ORDER BY batch_key DESC LIMIT $3",
    )
    .bind(place.batch_key)
    .bind(place.route_key)
    .bind(EDGE_BATCHES_MAX)
    .fetch_all(transaction)
    .await?;
    let mut newest_first = vec![own];
    for row in &rows {
        newest_first.push(waiting_of(row)?);
    }
    cut(&mut newest_first);
    newest_first.reverse();
    Ok(newest_first)
}

fn waiting_of(row: &SqliteRow) -> Result<Waiting, StoreError> {
    Ok(Waiting {
        batch_id: name(row, "id")?,
        batch_key: row.try_get("batch_key")?,
        sequence: row.try_get("sequence")?,
        body_bytes: row.try_get("body_bytes")?,
    })
}

/// Whether a sequence of a trip is in the map, or waits to be localised.
async fn is_used(
    transaction: &mut SqliteConnection,
    place: &Place,
    sequence: i64,
) -> Result<bool, StoreError> {
    let used = sqlx::query_scalar(
        "SELECT EXISTS (SELECT 1 FROM batches WHERE route_key = $1 AND trip_id = $2 \
         AND sequence = $3 AND status IN ('merged', 'unanchored'))",
    )
    .bind(place.route_key)
    .bind(&place.trip_id)
    .bind(sequence)
    .fetch_one(transaction)
    .await?;
    Ok(used)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lengths_cut(lengths: &[i64]) -> usize {
        let waiting = |(sequence, body_bytes): (i64, &i64)| Waiting {
            batch_id: BatchId::new("b").unwrap(),
            batch_key: sequence,
            sequence,
            body_bytes: *body_bytes,
        };
        let mut batches: Vec<_> = (0..).zip(lengths).map(waiting).collect();
        cut(&mut batches);
        batches.len()
    }

    #[test]
    fn what_a_job_loads_is_bounded_by_length_and_number() {
        assert_eq!(lengths_cut(&[31 << 20; 60]), 2);
        assert_eq!(lengths_cut(&[32 << 20, 32 << 20, 1]), 2);
        assert_eq!(lengths_cut(&[65 << 20, 1]), 1);
        assert_eq!(lengths_cut(&[i64::MAX, i64::MAX]), 1);
        assert_eq!(lengths_cut(&[1_000; 300]), 256);
        assert_eq!(lengths_cut(&[]), 0);
    }
}
