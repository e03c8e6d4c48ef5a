//! Copies of a database to keep elsewhere, made beside a running service, and what is in them.

use std::path::Path;

use jiff::Timestamp;
use serde::Serialize;
use sqlx::{Connection, Row, SqliteConnection};

use super::columns::optional_time;
use super::connection::Database;
use super::error::StoreError;
use super::migrations::newest_schema;
use super::query::Query;
use super::{files, marker};

/// What a database holds.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Contents {
    /// The schema's version: the number of its newest migration.
    pub schema: i64,
    /// Routes.
    pub routes: u64,
    /// Uploads, whatever became of them.
    pub batches: u64,
    /// Nodes of all maps.
    pub nodes: u64,
    /// Alerts, whatever was decided.
    pub alerts: u64,
    /// Commits since the database was made.
    pub commits: i64,
    /// When the newest upload arrived.
    pub newest_batch_at: Option<Timestamp>,
}

/// How a schema stands to the one of this program.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SchemaAge {
    /// A service of this version brings it up to date when it starts.
    Older,
    /// The same.
    Same,
    /// This program is too old for it.
    Newer,
}

impl Contents {
    /// How its schema stands to the one of this program.
    pub fn schema_age(&self) -> SchemaAge {
        match self.schema.cmp(&newest_schema()) {
            std::cmp::Ordering::Less => SchemaAge::Older,
            std::cmp::Ordering::Equal => SchemaAge::Same,
            std::cmp::Ordering::Greater => SchemaAge::Newer,
        }
    }
}

/// Writes a copy of the database of a data directory, as it is at this moment, to a file of its own
/// that only its owner can read, on the disk before this returns. A service may hold the directory.
///
/// # Errors
/// [`StoreError`], also if the file is there already; [`StoreError::LostLog`] if the database has
/// fewer commits than it had.
pub async fn back_up(data_dir: &Path, file: &Path) -> Result<(), StoreError> {
    let failed = |source| StoreError::Directory {
        path: file.to_path_buf(),
        source,
    };
    // Before the database is read: a service may commit meanwhile.
    let noted = marker::commits_before(data_dir).unwrap_or_default();
    // SQLite writes into an empty file, and leaves its mode as it is.
    files::create_new(file).map_err(failed)?;
    let copied = Database::in_directory(data_dir).copy_to(file).await;
    copied.map_err(StoreError::named)?;
    let copied = commits_of(&Database::at(file)).await;
    let lost = noted.saturating_sub(copied.map_err(StoreError::named)?);
    if lost > 0 {
        return Err(StoreError::LostLog {
            directory: data_dir.to_path_buf(),
            commits: lost,
        });
    }
    let copy = files::open(file).map_err(failed)?;
    copy.sync_all().map_err(failed)
}

async fn commits_of(database: &Database) -> Result<i64, StoreError> {
    let mut reader = database.open_reader().await?;
    let commits = marker::commits(&mut reader).await;
    reader.close().await?;
    commits
}

/// What the database of a data directory holds. A service may hold the directory.
///
/// # Errors
/// [`StoreError`] if there is no database.
pub async fn contents(data_dir: &Path) -> Result<Contents, StoreError> {
    contents_of(&Database::in_directory(data_dir)).await
}

/// What a backup holds.
///
/// # Errors
/// [`StoreError`] if the file is not a database of this service.
pub async fn backup_contents(file: &Path) -> Result<Contents, StoreError> {
    contents_of(&Database::at(file)).await
}

async fn contents_of(database: &Database) -> Result<Contents, StoreError> {
    let mut reader = database.open_reader().await.map_err(StoreError::named)?;
    let contents = ContentsNow.answer(&mut reader).await;
    reader.close().await?;
    contents.map_err(StoreError::named)
}

/// What a database holds.
struct ContentsNow;

impl Query for ContentsNow {
    type Answer = Contents;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let row = sqlx::query(
            "SELECT (SELECT coalesce(max(version), 0) FROM _sqlx_migrations WHERE success) \
                 AS schema, \
             (SELECT count(*) FROM routes) AS routes, (SELECT count(*) FROM batches) AS batches, \
             (SELECT count(*) FROM nodes) AS nodes, (SELECT count(*) FROM alerts) AS alerts, \
             (SELECT max(received_at_us) FROM batches) AS newest_batch_at_us",
        )
        .fetch_one(&mut *reader)
        .await?;
        let count = |column| row.try_get(column).map(i64::unsigned_abs);
        Ok(Contents {
            schema: row.try_get("schema")?,
            routes: count("routes")?,
            batches: count("batches")?,
            nodes: count("nodes")?,
            alerts: count("alerts")?,
            newest_batch_at: optional_time(&row, "newest_batch_at_us")?,
            commits: marker::commits(reader).await?,
        })
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;
    use crate::store::{Store, StoreOptions};

    async fn made(data_dir: &Path) {
        let data_dir = data_dir.to_path_buf();
        let store = Store::open(StoreOptions { data_dir }).await.unwrap();
        store.close().await.unwrap();
    }

    #[tokio::test]
    async fn a_copy_is_the_owners_alone_and_overwrites_nothing() {
        use std::os::unix::fs::PermissionsExt;
        let directory = tempfile::tempdir().unwrap();
        let (data, file) = (directory.path().join("data"), directory.path().join("b.db"));
        made(&data).await;
        back_up(&data, &file).await.unwrap();
        let mode = fs::metadata(&file).unwrap().permissions().mode();
        assert_eq!(mode & 0o777, 0o600);
        let found = backup_contents(&file).await.unwrap();
        assert_eq!(found, contents(&data).await.unwrap());
        assert_eq!(found.schema_age(), SchemaAge::Same);
        let before = fs::read(&file).unwrap();
        assert!(back_up(&data, &file).await.is_err());
        assert_eq!(fs::read(&file).unwrap(), before);
        let left: Vec<_> = fs::read_dir(directory.path()).unwrap().collect();
        assert_eq!(left.len(), 2, "nothing beside it: {left:?}");
    }
}
