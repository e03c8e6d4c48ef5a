//! What operators should know of a database, in one short read beside a running service.

use std::path::Path;

use jiff::Timestamp;
use sqlx::sqlite::SqliteRow;
use sqlx::{Connection, Row, SqliteConnection};

use super::alert_records::{AlertFilter, AlertRecord};
use super::alerts::AlertPage;
use super::columns::{micros, optional_time};
use super::connection::Database;
use super::error::StoreError;
use super::marker;
use super::query::{Query, in_snapshot};
use crate::model::{AlertStatus, BatchStatus, ChangeKind, DeliveryStatus};

/// Alerts that are read.
const SUSPECTS_MAX: u32 = 100;

/// What operators should know of a database.
#[derive(Debug)]
pub struct Checkup {
    /// Batches that were quarantined lately, by their reason, the most frequent first.
    pub quarantined: Vec<(String, u64)>,
    /// Batches that wait for one before them in their trip.
    pub held: Backlog,
    /// Batches that wait for a worker, or are being processed.
    pub queued: Backlog,
    /// Batches that could not be localised so far.
    pub unanchored: u64,
    /// Open alerts about vehicles, the newest first.
    pub suspects: Vec<AlertRecord>,
    /// Webhooks whose events do not arrive.
    pub webhooks: Vec<FailingWebhook>,
    /// The newest stamp that the service wrote.
    pub newest_write_at: Option<Timestamp>,
    /// Length of all bodies that were ever uploaded, bytes, decompressed.
    pub body_bytes: u64,
    /// That of the bodies since a given time.
    pub recent_body_bytes: u64,
    /// When the first batch arrived.
    pub first_batch_at: Option<Timestamp>,
    /// Length of the write-ahead log, bytes.
    pub log_bytes: u64,
    /// Length of the database and its log, bytes.
    pub file_bytes: u64,
    /// Commits that the last process had made and that are not there any more.
    pub lost_commits: u64,
}

/// Batches that wait.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Backlog {
    /// How many.
    pub batches: u64,
    /// When the oldest arrived.
    pub oldest_at: Option<Timestamp>,
}

/// A webhook whose events do not arrive.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FailingWebhook {
    /// Its id.
    pub id: String,
    /// Where events are sent.
    pub url: String,
    /// Events that were given up.
    pub failed: u64,
    /// Events that were tried in vain and are tried again.
    pub pending: u64,
    /// Whether its receiver said that it is gone, which disabled it.
    pub gone: bool,
}

/// Reads what operators should know; bodies since `recent` are counted apart. A service may hold the
/// directory.
///
/// # Errors
/// [`StoreError`], also if the schema is not that of this program.
pub async fn checkup(data_dir: &Path, recent: Timestamp) -> Result<Checkup, StoreError> {
    // Before the database is read: a service may commit meanwhile.
    let noted_commits = marker::commits_before(data_dir);
    let database = Database::in_directory(data_dir);
    let mut reader = database.open_reader().await.map_err(StoreError::named)?;
    let query = CheckupNow {
        recent,
        noted_commits,
    };
    let read = match database.is_up_to_date(&mut reader).await {
        Ok(true) => in_snapshot(&mut reader, &query).await,
        Ok(false) => Err(StoreError::OldSchema),
        Err(error) => Err(error),
    };
    reader.close().await?;
    let mut checkup = read.map_err(StoreError::named)?;
    checkup.log_bytes = database.wal_bytes();
    checkup.file_bytes = database.file_bytes();
    Ok(checkup)
}

/// What the tables say; the lengths of the files are left 0.
struct CheckupNow {
    recent: Timestamp,
    /// The commits that the last process had made at least.
    noted_commits: Option<i64>,
}

impl Query for CheckupNow {
    type Answer = Checkup;
    const ONE_SNAPSHOT: bool = true;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let row = sqlx::query(
            "SELECT coalesce(sum(body_bytes), 0) AS body_bytes, \
                 coalesce(sum(body_bytes) FILTER (WHERE received_at_us >= $1), 0) AS recent_bytes, \
                 min(received_at_us) AS first_at_us, \
                 nullif(max(max(received_at_us), coalesce(max(processed_at_us), 0)), 0) \
                     AS newest_at_us, \
                 count(*) FILTER (WHERE status = $2) AS held, \
                 min(received_at_us) FILTER (WHERE status = $2) AS held_at_us, \
                 count(*) FILTER (WHERE status IN ($3, $4)) AS queued, \
                 min(received_at_us) FILTER (WHERE status IN ($3, $4)) AS queued_at_us, \
                 count(*) FILTER (WHERE status = $5) AS unanchored FROM batches",
        )
        .bind(micros(self.recent))
        .bind(BatchStatus::Held.name())
        .bind(BatchStatus::Queued.name())
        .bind(BatchStatus::Processing.name())
        .bind(BatchStatus::Unanchored.name())
        .fetch_one(&mut *reader)
        .await?;
        let count = |column| row.try_get(column).map(i64::unsigned_abs);
        let commits = marker::commits(reader).await?;
        let lost = self
            .noted_commits
            .map(|noted| noted.saturating_sub(commits));
        Ok(Checkup {
            quarantined: quarantined(reader, self.recent).await?,
            held: Backlog {
                batches: count("held")?,
                oldest_at: optional_time(&row, "held_at_us")?,
            },
            queued: Backlog {
                batches: count("queued")?,
                oldest_at: optional_time(&row, "queued_at_us")?,
            },
            unanchored: count("unanchored")?,
            suspects: suspects(reader).await?,
            webhooks: failing_webhooks(reader).await?,
            newest_write_at: optional_time(&row, "newest_at_us")?,
            body_bytes: count("body_bytes")?,
            recent_body_bytes: count("recent_bytes")?,
            first_batch_at: optional_time(&row, "first_at_us")?,
            log_bytes: 0,
            file_bytes: 0,
            lost_commits: lost.unwrap_or_default().max(0).unsigned_abs(),
        })
    }
}

/// Alerts about vehicles that wait for a decision: the open ones, then those acknowledged.
async fn suspects(reader: &mut SqliteConnection) -> Result<Vec<AlertRecord>, StoreError> {
    let mut suspects = Vec::new();
    for status in [AlertStatus::Open, AlertStatus::Acknowledged] {
        let filter = AlertFilter {
            kind: Some(ChangeKind::VehicleSuspect),
            status: Some(status),
            ..AlertFilter::default()
        };
        let page = AlertPage {
            filter: &filter,
            before: None,
            limit: SUSPECTS_MAX,
        };
        suspects.extend(page.answer(reader).await?);
    }
    Ok(suspects)
}

async fn quarantined(
    reader: &mut SqliteConnection,
    since: Timestamp,
) -> Result<Vec<(String, u64)>, StoreError> {
    let rows: Vec<(String, i64)> = sqlx::query_as(
        "SELECT coalesce(reason, 'no reason'), count(*) AS batches FROM batches \
         WHERE status = $1 AND processed_at_us >= $2 GROUP BY 1 ORDER BY batches DESC, 1 LIMIT 10",
    )
    .bind(BatchStatus::Quarantined.name())
    .bind(micros(since))
    .fetch_all(reader)
    .await?;
    let rows = rows.into_iter();
    Ok(rows
        .map(|(reason, count)| (reason, count.unsigned_abs()))
        .collect())
}

async fn failing_webhooks(
    reader: &mut SqliteConnection,
) -> Result<Vec<FailingWebhook>, StoreError> {
    let rows = sqlx::query(
        "SELECT webhooks.id, url, gone_at_us IS NOT NULL AS gone, \
             count(*) FILTER (WHERE d.status = $1) AS failed, \
             count(*) FILTER (WHERE d.status = $2 AND attempts > 0) AS pending \
         FROM webhooks LEFT JOIN webhook_deliveries AS d USING (webhook_key) \
         GROUP BY webhook_key HAVING gone OR failed > 0 OR pending > 0 ORDER BY webhook_key",
    )
    .bind(DeliveryStatus::Failed.name())
    .bind(DeliveryStatus::Pending.name())
    .fetch_all(reader)
    .await?;
    let webhook = |row: &SqliteRow| {
        Ok(FailingWebhook {
            id: row.try_get("id")?,
            url: row.try_get("url")?,
            failed: row.try_get("failed").map(i64::unsigned_abs)?,
            pending: row.try_get("pending").map(i64::unsigned_abs)?,
            gone: row.try_get("gone")?,
        })
    };
    rows.iter().map(webhook).collect()
}
