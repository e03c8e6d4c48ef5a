//! The figures of the whole store that its operators watch: what waits, what is open, what the disk
//! holds.
//!
//! Each is read from an index that holds little more than what is counted.

use std::collections::BTreeMap;

use jiff::Timestamp;
use sqlx::{Row, SqliteConnection};

use super::Store;
use super::columns::{json_text, optional_time, text};
use super::error::StoreError;
use super::migrations::MIGRATIONS;
use super::query::Query;
use crate::model::{BatchStatus, ChangeKind, Stage, Tier};

/// The statuses of batches that are not in a map. Batches in a map, and those removed from one, are too
/// many to be counted.
pub const NOT_IN_A_MAP: [BatchStatus; 5] = [
    BatchStatus::Queued,
    BatchStatus::Processing,
    BatchStatus::Held,
    BatchStatus::Unanchored,
    BatchStatus::Quarantined,
];

/// What is counted over all routes, one figure after the other.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Figures {
    /// Batches by status, of [`NOT_IN_A_MAP`].
    pub batches: BTreeMap<BatchStatus, i64>,
    /// When the oldest batch arrived that waits for its first try; `None` if none does.
    pub oldest_queued: Option<Timestamp>,
    /// Alerts that wait for a decision and are not muted.
    pub open_alerts: BTreeMap<(ChangeKind, Tier), i64>,
    /// Vehicles with an undecided alert about them; one counts on every route.
    pub suspect_vehicles: i64,
    /// Vehicles whose uploads somebody keeps out of a map; one counts on every route.
    pub quarantined_vehicles: i64,
    /// Routes by stage.
    pub routes: BTreeMap<Stage, i64>,
    /// Bytes within the database that hold nothing and are used before its file grows.
    pub unused_bytes: u64,
}

/// What a data directory takes of its disk, bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DiskUse {
    /// The database without its log.
    pub database: u64,
    /// The write-ahead log.
    pub log: u64,
    /// Free on the disk, for the user that the service runs as; `None` if that cannot be known.
    pub free: Option<u64>,
}

/// The version of the schema that this program writes.
pub fn schema_version() -> i64 {
    let versions = MIGRATIONS.iter().map(|migration| migration.version);
    versions.max().unwrap_or_default()
}

impl Store {
    /// The figures as they are now.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn figures(&self) -> Result<Figures, StoreError> {
        self.read(FiguresNow).await
    }

    /// What the data directory takes of its disk.
    pub fn disk_use(&self) -> DiskUse {
        let log = self.shared.database.wal_bytes();
        DiskUse {
            database: self.file_bytes().saturating_sub(log),
            log,
            free: self.shared.space.free_bytes(),
        }
    }
}

/// The figures as they are now. Each is right for its moment; they need not be of the same one.
struct FiguresNow;

impl Query for FiguresNow {
    type Answer = Figures;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        Ok(Figures {
            batches: batches(reader).await?,
            oldest_queued: oldest_queued(reader).await?,
            open_alerts: open_alerts(reader).await?,
            suspect_vehicles: suspect_vehicles(reader).await?,
            quarantined_vehicles: quarantined_vehicles(reader).await?,
            routes: routes(reader).await?,
            unused_bytes: unused_bytes(reader).await?,
        })
    }
}

async fn suspect_vehicles(reader: &mut SqliteConnection) -> Result<i64, StoreError> {
    let count = sqlx::query_scalar(
        "SELECT count(*) FROM (SELECT DISTINCT route_key, value \
             FROM alerts, json_each(alerts.vehicles) \
             WHERE status IN ('open', 'acknowledged') AND kind = 'vehicle_suspect')",
    );
    Ok(count.fetch_one(reader).await?)
}

async fn quarantined_vehicles(reader: &mut SqliteConnection) -> Result<i64, StoreError> {
    let count = sqlx::query_scalar("SELECT count(*) FROM vehicle_quarantines");
    Ok(count.fetch_one(reader).await?)
}

async fn batches(reader: &mut SqliteConnection) -> Result<BTreeMap<BatchStatus, i64>, StoreError> {
    let rows = sqlx::query(
        "SELECT status, sum((SELECT count(*) FROM batches \
             WHERE batches.route_key = routes.route_key AND batches.status = wanted.status)) AS count \
         FROM routes, (SELECT value AS status FROM json_each($1)) AS wanted GROUP BY status",
    )
    .bind(json_text(&NOT_IN_A_MAP)?)
    .fetch_all(reader)
    .await?;
    let counted = rows
        .iter()
        .map(|row| Ok((text(row, "status")?, row.try_get("count")?)));
    counted.collect()
}

/// When the first batch arrived, in the order of arrival, that was never tried: one that is tried again
/// arrived long ago.
async fn oldest_queued(reader: &mut SqliteConnection) -> Result<Option<Timestamp>, StoreError> {
    let row = sqlx::query(
        "SELECT received_at_us FROM jobs CROSS JOIN batches USING (batch_key) \
         WHERE processed_at_us IS NULL ORDER BY jobs.batch_key LIMIT 1",
    )
    .fetch_optional(reader)
    .await?;
    match row {
        Some(row) => optional_time(&row, "received_at_us"),
        None => Ok(None),
    }
}

async fn open_alerts(
    reader: &mut SqliteConnection,
) -> Result<BTreeMap<(ChangeKind, Tier), i64>, StoreError> {
    let rows = sqlx::query(
        "SELECT kind, tier, count(*) AS count FROM alerts \
         WHERE status IN ('open', 'acknowledged') \
         AND NOT EXISTS (SELECT 1 FROM alert_handling AS handling \
             WHERE handling.alert_key = alerts.alert_key AND muted_until_us IS NOT NULL) \
         GROUP BY kind, tier",
    )
    .fetch_all(reader)
    .await?;
    let counted = rows.iter().map(|row| {
        let of = (text(row, "kind")?, text(row, "tier")?);
        Ok((of, row.try_get("count")?))
    });
    counted.collect()
}

async fn routes(reader: &mut SqliteConnection) -> Result<BTreeMap<Stage, i64>, StoreError> {
    let rows = sqlx::query("SELECT stage, count(*) AS count FROM routes GROUP BY stage")
        .fetch_all(reader)
        .await?;
    let counted = rows
        .iter()
        .map(|row| Ok((text(row, "stage")?, row.try_get("count")?)));
    counted.collect()
}

async fn unused_bytes(reader: &mut SqliteConnection) -> Result<u64, StoreError> {
    let (pages, page_bytes): (i64, i64) = sqlx::query_as(
        "SELECT freelist_count, page_size FROM pragma_freelist_count, pragma_page_size",
    )
    .fetch_one(reader)
    .await?;
    Ok(u64::try_from(pages.saturating_mul(page_bytes)).unwrap_or_default())
}
