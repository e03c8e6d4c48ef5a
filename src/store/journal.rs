//! The journal of uploads, read.

use sqlx::sqlite::SqliteRow;
use sqlx::{QueryBuilder, Row, Sqlite, SqliteConnection};

use super::Store;
use super::body::unseal;
use super::columns::{json_text, name, optional_time, parse_flags, text, time};
use super::error::{Corruption, StoreError};
use super::query::Query;
use super::records::{BatchFilter, BatchRecord, JournalEntry, OutOfRange};
use crate::ids::{BatchId, RouteId};

impl Store {
    /// One upload.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn batch(
        &self,
        route: &RouteId,
        id: &BatchId,
    ) -> Result<Option<BatchRecord>, StoreError> {
        self.read(OneBatch { route, id }).await
    }

    /// One upload with its body; `None` also if the body was deleted when its time was over.
    ///
    /// # Errors
    /// [`StoreError::Corrupt`] with [`Corruption::Body`] if the body has lost its checksum.
    pub async fn journal_entry(
        &self,
        route: &RouteId,
        id: &BatchId,
    ) -> Result<Option<JournalEntry>, StoreError> {
        match self.read(OneEntry { route, id }).await? {
            Some(sealed) => sealed.open().await.map(Some),
            None => Ok(None),
        }
    }

    /// In the order of arrival, after `after`, at most `limit`; none if `after` is not there.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn batches(
        &self,
        route: &RouteId,
        filter: &BatchFilter,
        after: Option<&BatchId>,
        limit: u32,
    ) -> Result<Vec<BatchRecord>, StoreError> {
        let page = BatchPage {
            route,
            filter,
            after,
            limit,
        };
        self.read(page).await
    }
}

macro_rules! select_batches {
    ($columns:literal, $rest:literal) => {
        concat!(
            "SELECT routes.id AS route_id, batches.id, vehicle_id, trip_id, kind, sequence, \
             status, reason, flags, above_range_max, below_range_min, extensions, batches.scans, \
             nodes_added, batches.loop_closures, received_at_us, \
             processed_at_us",
            $columns,
            " FROM batches JOIN routes USING (route_key) ",
            $rest
        )
    };
}

/// One upload.
struct OneBatch<'a> {
    route: &'a RouteId,
    id: &'a BatchId,
}

impl Query for OneBatch<'_> {
    type Answer = Option<BatchRecord>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let row = sqlx::query(select_batches!(
            "",
            "WHERE routes.id = $1 AND batches.id = $2"
        ))
        .bind(self.route.as_str())
        .bind(self.id.as_str())
        .fetch_optional(reader)
        .await?;
        row.as_ref().map(batch_of).transpose()
    }
}

/// Uploads in the order of arrival, after `after`; none after an id that is not there.
pub(super) struct BatchPage<'a> {
    pub(super) route: &'a RouteId,
    pub(super) filter: &'a BatchFilter,
    pub(super) after: Option<&'a BatchId>,
    pub(super) limit: u32,
}

impl Query for BatchPage<'_> {
    type Answer = Vec<BatchRecord>;

    /// One condition for each wish: SQLite chooses an index only for a condition that is there.
    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let mut query: QueryBuilder<Sqlite> =
            QueryBuilder::new(select_batches!("", "WHERE routes.id = "));
        query.push_bind(self.route.as_str());
        if let Some(ids) = &self.filter.ids {
            query.push(" AND batches.id IN (SELECT value FROM json_each(");
            query.push_bind(json_text(ids)?).push("))");
        }
        if let Some(vehicle_id) = &self.filter.vehicle_id {
            query.push(" AND vehicle_id = ");
            query.push_bind(vehicle_id.as_str());
        }
        if let Some(status) = self.filter.status {
            query.push(" AND status = ");
            query.push_bind(status.name());
        }
        if let Some(after) = self.after {
            query.push(
                " AND batch_key > (SELECT cursor.batch_key FROM batches AS cursor \
                 WHERE cursor.route_key = routes.route_key AND cursor.id = ",
            );
            query.push_bind(after.as_str());
            query.push(")");
        }
        query.push(" ORDER BY batch_key LIMIT ");
        query.push_bind(self.limit);
        let rows = query.build().fetch_all(reader).await?;
        rows.iter().map(batch_of).collect()
    }
}

/// An upload with its body as it is stored; `None` also if the body was deleted.
pub(super) struct OneEntry<'a> {
    pub(super) route: &'a RouteId,
    pub(super) id: &'a BatchId,
}

impl Query for OneEntry<'_> {
    type Answer = Option<SealedEntry>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let row = sqlx::query(select_batches!(
            ", body, body_bytes, body_sha256, body_kept",
            "LEFT JOIN batch_bodies USING (batch_key) WHERE routes.id = $1 AND batches.id = $2"
        ))
        .bind(self.route.as_str())
        .bind(self.id.as_str())
        .fetch_optional(reader)
        .await?;
        let Some(row) = row else { return Ok(None) };
        if !row.try_get::<bool, _>("body_kept")? {
            return Ok(None);
        }
        Ok(Some(SealedEntry {
            batch: batch_of(&row)?,
            compressed: row.try_get("body")?,
            bytes: row.try_get("body_bytes")?,
            sha256: row.try_get("body_sha256")?,
        }))
    }
}

/// An upload with its body as it is stored: opened once no reader is held any more.
pub(super) struct SealedEntry {
    batch: BatchRecord,
    compressed: Option<Vec<u8>>,
    bytes: i64,
    sha256: Vec<u8>,
}

impl SealedEntry {
    /// Decompresses the body and verifies its checksum.
    ///
    /// # Errors
    /// [`Corruption::Body`].
    pub(super) async fn open(self) -> Result<JournalEntry, StoreError> {
        let Self {
            batch,
            compressed,
            bytes,
            sha256,
        } = self;
        // A large body takes milliseconds: not on the async threads.
        let body = tokio::task::spawn_blocking(move || unseal(&compressed?, bytes, &sha256));
        match body.await.map_err(|_| StoreError::Unavailable)? {
            Some(body) => Ok(JournalEntry { batch, body }),
            None => Err(StoreError::Corrupt(Corruption::Body {
                route_id: batch.route_id,
                batch_id: batch.id,
            })),
        }
    }
}

fn batch_of(row: &SqliteRow) -> Result<BatchRecord, StoreError> {
    Ok(BatchRecord {
        id: name(row, "id")?,
        route_id: name(row, "route_id")?,
        vehicle_id: name(row, "vehicle_id")?,
        trip_id: name(row, "trip_id")?,
        kind: text(row, "kind")?,
        sequence: row.try_get("sequence")?,
        status: text(row, "status")?,
        reason: row.try_get("reason")?,
        flags: parse_flags(row.try_get("flags")?)?,
        out_of_range: out_of_range(row)?,
        extensions: row.try_get("extensions")?,
        scans: row.try_get("scans")?,
        nodes_added: row.try_get("nodes_added")?,
        loop_closures: row.try_get("loop_closures")?,
        received_at: time(row, "received_at_us")?,
        processed_at: optional_time(row, "processed_at_us")?,
    })
}

fn out_of_range(row: &SqliteRow) -> Result<Option<OutOfRange>, StoreError> {
    let above: Option<i64> = row.try_get("above_range_max")?;
    let below: Option<i64> = row.try_get("below_range_min")?;
    let readings = above.zip(below);
    Ok(
        readings.map(|(above_range_max, below_range_min)| OutOfRange {
            above_range_max,
            below_range_min,
        }),
    )
}
