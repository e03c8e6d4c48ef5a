//! How connections to the database are opened.

use std::path::{Path, PathBuf};
use std::time::Duration;

use sqlx::sqlite::{
    SqliteConnectOptions, SqliteJournalMode, SqlitePool, SqlitePoolOptions, SqliteSynchronous,
};
use sqlx::{ConnectOptions, Connection, SqliteConnection};

use super::error::StoreError;
use super::migrations::{MIGRATIONS, newest_schema};
use super::{archive, files};

const FILE_NAME: &str = "mapshift.db";
/// Before it, two connections that write and checkpoint at one instant can corrupt the file.
const SQLITE_VERSION_MIN: [u32; 3] = [3, 51, 3];
const READERS: u32 = 3;
const WRITER_BUSY_TIMEOUT: Duration = Duration::from_secs(1);
const READER_BUSY_TIMEOUT: Duration = Duration::from_secs(5);
const WAL_AUTOCHECKPOINT_PAGES: &str = "4000";
/// The log is truncated above this length.
pub(super) const WAL_BYTES_MAX: u64 = 64 << 20;
const WAL_BYTES_MAX_TEXT: &str = "67108864";

/// The migration that gave every route's `false_alarm_rate` another meaning and the default.
const RATES_PER_LAP: i64 = 9;

/// What bringing the schema up to date did that operators should know.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Migrated {
    /// Routes whose `false_alarm_rate` was set to the default, as false alerts per lap.
    pub(super) rates_set: i64,
}

/// The database file of a data directory.
#[derive(Debug, Clone)]
pub(super) struct Database {
    path: PathBuf,
}

impl Database {
    /// The database of a data directory.
    pub(super) fn in_directory(directory: &Path) -> Self {
        Self {
            path: directory.join(FILE_NAME),
        }
    }

    /// The database in a file, wherever that is.
    pub(super) fn at(path: &Path) -> Self {
        Self {
            path: path.to_path_buf(),
        }
    }

    /// Where its file is.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// The files that it may consist of.
    pub(super) fn files(&self) -> [PathBuf; 3] {
        [self.path.clone(), self.beside("-wal"), self.beside("-shm")]
    }

    /// Makes the file if it is missing, and takes it from everybody but its owner; SQLite gives the
    /// files beside it the same mode.
    ///
    /// # Errors
    /// [`StoreError::Directory`].
    pub(super) fn make_files(&self) -> Result<(), StoreError> {
        for path in self.files() {
            files::tighten(&path);
        }
        let path = self.path.clone();
        files::open(&path).map_err(|source| StoreError::Directory { path, source })?;
        Ok(())
    }

    /// Where it is, as SQLite takes it in a statement.
    pub(super) fn path_text(&self) -> String {
        self.path.to_string_lossy().into_owned()
    }

    /// Writes a copy as it is at this moment into a directory, which is made if it is missing. A
    /// service may be writing meanwhile: the copy is one long read.
    ///
    /// # Errors
    /// [`StoreError::Directory`], or if there is a database in that directory.
    pub(super) async fn copy_into(&self, directory: &Path) -> Result<(), StoreError> {
        files::make_directory(directory).map_err(|source| StoreError::Directory {
            path: directory.to_path_buf(),
            source,
        })?;
        self.copy_to(&Self::in_directory(directory).path).await
    }

    /// Writes a copy as it is at this moment to a file, which is missing or empty. A service may be
    /// writing meanwhile: the copy is one long read.
    ///
    /// # Errors
    /// If there is something in that file.
    pub(super) async fn copy_to(&self, file: &Path) -> Result<(), StoreError> {
        let mut reader = self.options().read_only(true).connect().await?;
        sqlx::query("VACUUM INTO $1")
            .bind(Self::at(file).path_text())
            .execute(&mut reader)
            .await?;
        Ok(reader.close().await?)
    }

    /// Makes it readable and writable as `other` by a connection to another database.
    pub(super) async fn attach_to(
        &self,
        connection: &mut SqliteConnection,
    ) -> Result<(), sqlx::Error> {
        sqlx::query("ATTACH $1 AS other")
            .bind(self.path_text())
            .execute(connection)
            .await?;
        Ok(())
    }

    /// A connection that copies to another database, beside the one that writes.
    pub(super) async fn open_copier(&self) -> Result<SqliteConnection, StoreError> {
        let options = self.options().busy_timeout(READER_BUSY_TIMEOUT);
        Ok(options.connect().await?)
    }

    fn beside(&self, suffix: &str) -> PathBuf {
        let mut path = self.path.clone().into_os_string();
        path.push(suffix);
        path.into()
    }

    /// Length of the write-ahead log; 0 if there is none.
    pub(super) fn wal_bytes(&self) -> u64 {
        std::fs::metadata(self.beside("-wal")).map_or(0, |log| log.len())
    }

    /// Length of the database and its write-ahead log.
    pub(super) fn file_bytes(&self) -> u64 {
        let database = std::fs::metadata(&self.path).map_or(0, |file| file.len());
        database + self.wal_bytes()
    }

    /// The connection that writes; there is one at a time.
    ///
    /// # Errors
    /// [`StoreError::Setting`] if a setting that durability rests on does not hold.
    pub(super) async fn open_writer(&self) -> Result<SqliteConnection, StoreError> {
        let mut connection = self
            .options()
            .create_if_missing(true)
            .journal_mode(SqliteJournalMode::Wal)
            .synchronous(SqliteSynchronous::Full)
            .busy_timeout(WRITER_BUSY_TIMEOUT)
            .pragma("wal_autocheckpoint", WAL_AUTOCHECKPOINT_PAGES)
            .pragma("journal_size_limit", WAL_BYTES_MAX_TEXT)
            .connect()
            .await?;
        check_version(&mut connection).await?;
        check_settings(&mut connection).await?;
        Ok(connection)
    }

    /// Whether the schema is what this version of the program needs.
    pub(super) async fn is_up_to_date(
        &self,
        writer: &mut SqliteConnection,
    ) -> Result<bool, StoreError> {
        has_migration(writer, newest_schema()).await
    }

    /// Brings the schema up to date.
    ///
    /// # Errors
    /// [`StoreError::Migration`] if a migration cannot be applied; those before it have been.
    pub(super) async fn migrate(
        &self,
        writer: &mut SqliteConnection,
    ) -> Result<Migrated, StoreError> {
        let had_rates_per_lap = has_migration(writer, RATES_PER_LAP).await?;
        // A migration that rebuilds a table drops the old one. With foreign keys enforced that would
        // delete every row that refers to it, and inside a migration's transaction it is too late to
        // turn them off.
        set(writer, "PRAGMA foreign_keys = OFF").await?;
        // An index over millions of rows is sorted in files, in whatever directory SQLite finds for
        // them: in memory it would take as much as the rows. It happens once, and a new database has
        // none.
        if !is_new(writer).await? {
            set(writer, "PRAGMA temp_store = FILE").await?;
        }
        MIGRATIONS.run(&mut *writer).await?;
        set(writer, "PRAGMA foreign_keys = ON").await?;
        check_settings(writer).await?;
        archive::fill_if_missing(writer).await?;
        set(writer, "PRAGMA temp_store = MEMORY").await?;
        if had_rates_per_lap {
            return Ok(Migrated { rates_set: 0 });
        }
        let rates_set = sqlx::query_scalar("SELECT count(*) FROM routes")
            .fetch_one(writer)
            .await?;
        Ok(Migrated { rates_set })
    }

    /// A connection that reads, for one long read. The database is there already.
    pub(super) async fn open_reader(&self) -> Result<SqliteConnection, StoreError> {
        Ok(self.reader_options().connect().await?)
    }

    /// The pool of connections that read. The database is there already.
    pub(super) async fn open_readers(&self) -> Result<SqlitePool, StoreError> {
        let options = self.reader_options();
        let pool = SqlitePoolOptions::new()
            .max_connections(READERS)
            .min_connections(1)
            .acquire_timeout(READER_BUSY_TIMEOUT)
            .idle_timeout(None)
            .max_lifetime(None)
            .connect_with(options)
            .await?;
        Ok(pool)
    }

    fn reader_options(&self) -> SqliteConnectOptions {
        self.options()
            .read_only(true)
            .busy_timeout(READER_BUSY_TIMEOUT)
            .pragma("query_only", "ON")
    }

    fn options(&self) -> SqliteConnectOptions {
        SqliteConnectOptions::new()
            .filename(&self.path)
            .foreign_keys(true)
            .pragma("mmap_size", "0")
            .pragma("cell_size_check", "ON")
            .pragma("trusted_schema", "OFF")
            // Temporary tables are small, or are sorted for an answer that is held in memory anyway.
            // In files, every statement would depend on a directory that is not the data directory.
            .pragma("temp_store", "MEMORY")
            .disable_statement_logging()
    }
}

/// Ends [`Database::attach_to`].
pub(super) async fn detach(connection: &mut SqliteConnection) -> Result<(), sqlx::Error> {
    sqlx::query("DETACH other").execute(connection).await?;
    Ok(())
}

/// Moves the log into the database and truncates it. Returns false if a reader was in the way.
pub(super) async fn truncate_wal(writer: &mut SqliteConnection) -> Result<bool, sqlx::Error> {
    let (busy, _, _): (i64, i64, i64) = sqlx::query_as("PRAGMA wal_checkpoint(TRUNCATE)")
        .fetch_one(writer)
        .await?;
    Ok(busy == 0)
}

/// Whether a database has no schema yet.
async fn is_new(connection: &mut SqliteConnection) -> Result<bool, StoreError> {
    let is_new = sqlx::query_scalar(
        "SELECT NOT EXISTS (SELECT 1 FROM sqlite_schema WHERE name = '_sqlx_migrations')",
    );
    Ok(is_new.fetch_one(connection).await?)
}

/// Whether a migration has been applied; of a new database none has.
async fn has_migration(
    connection: &mut SqliteConnection,
    version: i64,
) -> Result<bool, StoreError> {
    if is_new(connection).await? {
        return Ok(false);
    }
    let applied = sqlx::query_scalar(
        "SELECT EXISTS (SELECT 1 FROM _sqlx_migrations WHERE version = $1 AND success)",
    )
    .bind(version)
    .fetch_one(connection)
    .await?;
    Ok(applied)
}

async fn set(connection: &mut SqliteConnection, pragma: &'static str) -> Result<(), StoreError> {
    sqlx::query(pragma).execute(connection).await?;
    Ok(())
}

async fn check_version(connection: &mut SqliteConnection) -> Result<(), StoreError> {
    let version: String = sqlx::query_scalar("SELECT sqlite_version()")
        .fetch_one(connection)
        .await?;
    if is_recent(&version) {
        Ok(())
    } else {
        Err(StoreError::SqliteTooOld(version))
    }
}

fn is_recent(version: &str) -> bool {
    let parts: Result<Vec<u32>, _> = version.split('.').map(str::parse).collect();
    parts.is_ok_and(|parts| parts.as_slice() >= SQLITE_VERSION_MIN.as_slice())
}

fn check_setting(name: &'static str, found: String, wanted: &str) -> Result<(), StoreError> {
    if found == wanted {
        Ok(())
    } else {
        Err(StoreError::Setting { name, found })
    }
}

/// Reads back what durability rests on.
async fn check_settings(connection: &mut SqliteConnection) -> Result<(), StoreError> {
    let mode: String = sqlx::query_scalar("PRAGMA journal_mode")
        .fetch_one(&mut *connection)
        .await?;
    check_setting("journal_mode", mode, "wal")?;
    let synchronous: i64 = sqlx::query_scalar("PRAGMA synchronous")
        .fetch_one(&mut *connection)
        .await?;
    check_setting("synchronous", synchronous.to_string(), "2")?;
    let foreign_keys: i64 = sqlx::query_scalar("PRAGMA foreign_keys")
        .fetch_one(&mut *connection)
        .await?;
    check_setting("foreign_keys", foreign_keys.to_string(), "1")
}

#[cfg(test)]
mod migration_tests;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn versions_are_compared_as_numbers() {
        for good in ["3.51.3", "3.52.0", "3.100.0", "4.0.0"] {
            assert!(is_recent(good), "{good}");
        }
        for bad in ["3.51.2", "3.9.9", "3.51", "", "3.x.9"] {
            assert!(!is_recent(bad), "{bad}");
        }
    }

    #[tokio::test]
    async fn rates_of_another_meaning_are_set_once() {
        let directory = tempfile::tempdir().unwrap();
        let database = Database::in_directory(directory.path());
        let mut writer = database.open_writer().await.unwrap();
        let before = RATES_PER_LAP - 1;
        MIGRATIONS.run_to(before, &mut writer).await.unwrap();
        for (id, rate) in [("a", 1e-4), ("b", 0.5)] {
            sqlx::query(
                "INSERT INTO routes (id, detector, false_alarm_rate, hold_s, stage, map_version, \
                 epoch, revision, next_node_id, next_edge_id, created_at_us, updated_at_us) \
                 VALUES ($1, 'fused', $2, 600, 'mapping', 1, 1, 0, 1, 1, 0, 0)",
            )
            .bind(id)
            .bind(rate)
            .execute(&mut writer)
            .await
            .unwrap();
        }
        let migrated = database.migrate(&mut writer).await.unwrap();
        assert_eq!(migrated, Migrated { rates_set: 2 });
        let rates: Vec<f64> = sqlx::query_scalar("SELECT false_alarm_rate FROM routes")
            .fetch_all(&mut writer)
            .await
            .unwrap();
        assert_eq!(rates, [0.01, 0.01]);
        let again = database.migrate(&mut writer).await.unwrap();
        assert_eq!(again, Migrated { rates_set: 0 });
    }

    #[tokio::test]
    async fn settings_hold_on_both_kinds_of_connection() {
        let directory = tempfile::tempdir().unwrap();
        let database = Database::in_directory(directory.path());
        let mut writer = database.open_writer().await.unwrap();
        database.migrate(&mut writer).await.unwrap();
        database.migrate(&mut writer).await.unwrap();
        for (pragma, wanted) in [
            ("PRAGMA wal_autocheckpoint", 4000_i64),
            ("PRAGMA journal_size_limit", 64 << 20),
            ("PRAGMA mmap_size", 0),
            ("PRAGMA cell_size_check", 1),
            ("PRAGMA trusted_schema", 0),
            ("PRAGMA temp_store", 2),
        ] {
            let found: i64 = sqlx::query_scalar(pragma)
                .fetch_one(&mut writer)
                .await
                .unwrap();
            assert_eq!(found, wanted, "{pragma}");
        }
        let readers = database.open_readers().await.unwrap();
        let temp_store: i64 = sqlx::query_scalar("PRAGMA temp_store")
            .fetch_one(&readers)
            .await
            .unwrap();
        assert_eq!(temp_store, 2);
        let write = sqlx::query("DELETE FROM routes").execute(&readers).await;
        assert!(write.is_err());
        assert!(truncate_wal(&mut writer).await.unwrap());
        assert_eq!(database.wal_bytes(), 0);
    }
}
