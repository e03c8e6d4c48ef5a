//! The file that stands beside the database while it is open, and says how many commits it has.
//!
//! What was acknowledged is in the write-ahead log until it is moved into the database. If the log is
//! missing after a process was killed, SQLite opens the rest without an error. The number of commits is
//! therefore kept twice: in the database, with every commit, and in this file, after it. A database
//! with fewer commits than the file says has lost some. The file is not synced with each commit: what
//! was written survives the end of the process, and after a power cut it may say too few, so that a
//! loss goes unnoticed. An orderly end, after which the log is empty, removes the file.

use std::fs::{self, File};
use std::io::{self, ErrorKind};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

use sqlx::SqliteConnection;

use super::error::StoreError;
use super::files;

const FILE_NAME: &str = "mapshift.open";

/// The file that says how many commits the open database has.
#[derive(Debug)]
pub(super) struct Marker {
    file: File,
    path: PathBuf,
}

/// How many commits the database had at least when its last process was lost; `None` after an
/// orderly end, or if that is not known.
pub(super) fn commits_before(directory: &Path) -> Option<i64> {
    let text = fs::read_to_string(path(directory)).ok()?;
    text.trim().parse().ok()
}

/// Where the file of a data directory is.
pub(super) fn path(directory: &Path) -> PathBuf {
    directory.join(FILE_NAME)
}

impl Marker {
    /// Makes the file anew, on the disk before this returns.
    ///
    /// # Errors
    /// [`StoreError::Directory`].
    pub(super) fn create(directory: &Path, commits: i64) -> Result<Self, StoreError> {
        let path = path(directory);
        let failed = |source| StoreError::Directory {
            path: path.clone(),
            source,
        };
        files::tighten(&path);
        let file = files::open(&path).map_err(failed)?;
        let marker = Self {
            file,
            path: path.clone(),
        };
        marker.write(commits).map_err(failed)?;
        marker.file.sync_all().map_err(failed)?;
        files::sync_directory(directory).map_err(failed)?;
        Ok(marker)
    }

    /// Notes the commits so far. Too few if it fails, which is a weaker check and no more.
    pub(super) fn note(&self, commits: i64) {
        if let Err(error) = self.write(commits) {
            tracing::debug!(%error, "the number of commits was not noted");
        }
    }

    fn write(&self, commits: i64) -> io::Result<()> {
        // Always the same length, so that it replaces the earlier text.
        self.file
            .write_all_at(format!("{commits:019}\n").as_bytes(), 0)
    }

    /// Removes the file after the log was emptied.
    pub(super) fn remove(self) {
        match fs::remove_file(&self.path) {
            Err(error) if error.kind() != ErrorKind::NotFound => {
                tracing::warn!(%error, path = %self.path.display(), "a file could not be removed");
            }
            _ => {}
        }
    }
}

/// Counts a commit, in its transaction; returns how many there are with it.
pub(super) async fn count_commit(transaction: &mut SqliteConnection) -> Result<i64, StoreError> {
    let count = sqlx::query_scalar("UPDATE commits SET count = count + 1 RETURNING count")
        .fetch_one(transaction)
        .await?;
    Ok(count)
}

/// How many commits a database has; none before it was first written by a version that counts.
pub(super) async fn commits(connection: &mut SqliteConnection) -> Result<i64, StoreError> {
    let counts: bool =
        sqlx::query_scalar("SELECT EXISTS (SELECT 1 FROM sqlite_schema WHERE name = 'commits')")
            .fetch_one(&mut *connection)
            .await?;
    if !counts {
        return Ok(0);
    }
    let count = sqlx::query_scalar("SELECT count FROM commits")
        .fetch_one(connection)
        .await?;
    Ok(count)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_file_says_how_many_until_it_is_removed() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path();
        assert_eq!(commits_before(path), None);
        let marker = Marker::create(path, 12).unwrap();
        assert_eq!(commits_before(path), Some(12));
        marker.note(i64::MAX);
        assert_eq!(commits_before(path), Some(i64::MAX));
        let marker = Marker::create(path, 3).unwrap();
        assert_eq!(commits_before(path), Some(3));
        marker.remove();
        assert_eq!(commits_before(path), None);
        fs::write(path.join(FILE_NAME), "").unwrap();
        assert_eq!(commits_before(path), None, "cut off while it was made");
    }
}
