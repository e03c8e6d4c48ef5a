//! The lock that keeps a second process out of a data directory.

use std::fs::{File, TryLockError};
use std::path::Path;

use super::error::StoreError;
use super::files;

/// The file in a data directory that is locked.
pub(super) const LOCK_FILE: &str = "mapshift.lock";

/// Held for the life of a store. The operating system releases it when the process ends, however it
/// ends: the holder of the lock knows that no worker of an earlier process is alive.
#[derive(Debug)]
pub(super) struct DirectoryLock {
    _file: File,
}

impl DirectoryLock {
    /// Creates the directory if it is missing, and locks it. Blocks on the disk.
    pub(super) fn acquire(directory: &Path) -> Result<Self, StoreError> {
        let failed = |source| StoreError::Directory {
            path: directory.to_path_buf(),
            source,
        };
        files::make_directory(directory).map_err(failed)?;
        let path = directory.join(LOCK_FILE);
        files::tighten(&path);
        let file = files::open(&path).map_err(failed)?;
        match file.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => {
                return Err(StoreError::Locked(directory.to_path_buf()));
            }
            Err(TryLockError::Error(source)) => return Err(failed(source)),
        }
        // A directory that was just made must itself survive a power cut.
        if let Some(parent) = directory.canonicalize().map_err(failed)?.parent() {
            files::sync_directory(parent).map_err(failed)?;
        }
        Ok(Self { _file: file })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_holder_at_a_time() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("deep").join("data");
        let first = DirectoryLock::acquire(&path).unwrap();
        assert!(matches!(
            DirectoryLock::acquire(&path),
            Err(StoreError::Locked(locked)) if locked == path
        ));
        drop(first);
        assert!(DirectoryLock::acquire(&path).is_ok());
    }
}
