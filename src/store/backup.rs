//! Copies of a database to keep elsewhere: made beside a running service, checked, put back.

use std::fs;
use std::path::{Path, PathBuf};

use jiff::Timestamp;
use serde::Serialize;
use sqlx::{Connection, Row, SqliteConnection};

use super::columns::optional_time;
use super::connection::Database;
use super::error::StoreError;
use super::lock::DirectoryLock;
use super::migrations::newest_schema;
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
/// [`StoreError`], also if the file is there already.
pub async fn back_up(data_dir: &Path, file: &Path) -> Result<(), StoreError> {
    let failed = |source| StoreError::Directory {
        path: file.to_path_buf(),
        source,
    };
    // SQLite writes into an empty file, and leaves its mode as it is.
    files::create_new(file).map_err(failed)?;
    let copied = Database::in_directory(data_dir).copy_to(file).await;
    copied.map_err(StoreError::named)?;
    let copy = files::open(file).map_err(failed)?;
    copy.sync_all().map_err(failed)
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
    let contents = read_contents(&mut reader).await;
    reader.close().await?;
    contents.map_err(StoreError::named)
}

async fn read_contents(reader: &mut SqliteConnection) -> Result<Contents, StoreError> {
    let row = sqlx::query(
        "SELECT (SELECT coalesce(max(version), 0) FROM _sqlx_migrations WHERE success) AS schema, \
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

/// A data directory that this process holds, to put a backup into it.
pub struct HeldDirectory {
    path: PathBuf,
    _lock: DirectoryLock,
}

impl HeldDirectory {
    /// Makes the directory if it is missing, and locks it.
    ///
    /// # Errors
    /// [`StoreError::Locked`] if a service runs on it.
    pub fn hold(path: &Path) -> Result<Self, StoreError> {
        Ok(Self {
            path: path.to_path_buf(),
            _lock: DirectoryLock::acquire(path)?,
        })
    }

    /// The files in it that belong to a database.
    pub fn database_files(&self) -> Vec<PathBuf> {
        let database = Database::in_directory(&self.path).files();
        let beside = [marker::path(&self.path)];
        let all = database.into_iter().chain(beside);
        all.filter(|file| file.exists()).collect()
    }

    /// Puts a file, which lies on the same disk, in the place of the database, whose files go to
    /// another directory if there are any.
    ///
    /// # Errors
    /// [`StoreError::Directory`]; a database that was there is in the one directory or the other.
    pub fn put(self, file: &Path, aside: &Path) -> Result<(), StoreError> {
        let failed = |source| StoreError::Directory {
            path: self.path.clone(),
            source,
        };
        let earlier = self.database_files();
        if !earlier.is_empty() {
            files::make_directory(aside).map_err(failed)?;
        }
        for path in &earlier {
            let name = path.file_name().unwrap_or_default();
            fs::rename(path, aside.join(name)).map_err(failed)?;
        }
        if !earlier.is_empty() {
            files::sync_directory(aside).map_err(failed)?;
        }
        let database = Database::in_directory(&self.path);
        fs::rename(file, database.path()).map_err(failed)?;
        files::sync_directory(&self.path).map_err(failed)
    }
}

#[cfg(test)]
mod tests {
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

    #[tokio::test]
    async fn what_was_there_goes_aside_with_its_log() {
        let directory = tempfile::tempdir().unwrap();
        let data = directory.path().join("data");
        made(&data).await;
        fs::write(data.join("mapshift.db-wal"), "log").unwrap();
        fs::write(data.join("mapshift.open"), "7").unwrap();
        let (file, aside) = (data.join("new"), data.join("replaced"));
        fs::write(&file, "restored").unwrap();
        let held = HeldDirectory::hold(&data).unwrap();
        assert!(matches!(
            HeldDirectory::hold(&data),
            Err(StoreError::Locked(_))
        ));
        assert_eq!(held.database_files().len(), 3);
        held.put(&file, &aside).unwrap();
        assert_eq!(fs::read(data.join("mapshift.db")).unwrap(), b"restored");
        assert_eq!(fs::read(aside.join("mapshift.db-wal")).unwrap(), b"log");
        assert!(!data.join("mapshift.open").exists() && !data.join("mapshift.db-wal").exists());
    }
}
