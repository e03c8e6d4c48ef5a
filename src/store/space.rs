//! Space on the disk: whether there is any, and a reserve for when there is none.
//!
//! Deleting a route makes room, but SQLite needs room for its log to do that. A file beside the database
//! keeps that room in reserve and is emptied when the disk is full. While it is empty, uploads are
//! refused, and only what deletes or notes a state is written.

use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use rustix::fs::{FallocateFlags, fallocate, statvfs};

use super::files;

const FILE_NAME: &str = "mapshift.reserve";
/// As long as the log grows before it is moved into the database (`wal_autocheckpoint`).
const RESERVE_BYTES: u64 = 16 << 20;
/// With less than this the disk is full: a group of uploads would find no room.
const FREE_BYTES_MIN: u64 = 1 << 20;

/// The space of a data directory.
#[derive(Clone)]
pub(super) struct Space {
    path: PathBuf,
    free_bytes: Arc<dyn Fn() -> io::Result<u64> + Send + Sync>,
}

impl Space {
    /// The space of a data directory.
    pub(super) fn of(directory: &Path) -> Self {
        let measured = directory.to_path_buf();
        Self::measured_by(directory, move || {
            let free = statvfs(&measured)?;
            Ok(free.f_bavail.saturating_mul(free.f_frsize))
        })
    }

    /// Space as a function measures it.
    pub(super) fn measured_by(
        directory: &Path,
        free_bytes: impl Fn() -> io::Result<u64> + Send + Sync + 'static,
    ) -> Self {
        Self {
            path: directory.join(FILE_NAME),
            free_bytes: Arc::new(free_bytes),
        }
    }

    /// Bytes that are free; `None` if that cannot be measured.
    pub(super) fn free_bytes(&self) -> Option<u64> {
        (self.free_bytes)().ok()
    }

    /// Whether the disk is nearly full; false if that cannot be measured, since a write will then fail
    /// by itself.
    pub(super) fn is_low(&self) -> bool {
        self.has_less_than(FREE_BYTES_MIN)
    }

    /// Whether the reserve's size is still free after so many more bytes.
    pub(super) fn has_room_for(&self, bytes: u64) -> bool {
        !self.has_less_than(bytes.saturating_add(RESERVE_BYTES))
    }

    /// Whether the reserve was given up and not restored since, by this process or an earlier one.
    pub(super) fn is_released(&self) -> bool {
        std::fs::metadata(&self.path).is_ok_and(|file| file.len() == 0)
    }

    /// Whether there is room for all writes. Gives the reserve back to the disk if there is none, and
    /// puts it back once there is room for it and more.
    pub(super) fn has_room(&self) -> bool {
        if self.is_low() {
            self.release();
            return false;
        }
        if self.is_held() {
            return true;
        }
        if self.has_less_than(RESERVE_BYTES + 2 * FREE_BYTES_MIN) {
            // A disk that never had room for the reserve is used without it.
            return !self.is_released();
        }
        if let Err(error) = self.allocate() {
            tracing::warn!(%error, "there is no reserve for a full disk");
        }
        true
    }

    /// Gives the reserve back to the disk, if it is there.
    fn release(&self) {
        if !self.is_held() {
            return;
        }
        if let Err(error) = files::open(&self.path).and_then(|file| file.set_len(0)) {
            tracing::warn!(%error, "the reserve could not be released");
        }
    }

    fn is_held(&self) -> bool {
        std::fs::metadata(&self.path).is_ok_and(|file| file.len() >= RESERVE_BYTES)
    }

    fn has_less_than(&self, bytes: u64) -> bool {
        self.free_bytes().is_some_and(|free| free < bytes)
    }

    fn allocate(&self) -> io::Result<()> {
        files::tighten(&self.path);
        let file: File = files::open(&self.path)?;
        let allocated = fallocate(&file, FallocateFlags::empty(), 0, RESERVE_BYTES);
        if allocated.is_err() {
            // Not every file system can; what was had of it is given back.
            std::fs::remove_file(&self.path)?;
        }
        Ok(allocated?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicU64, Ordering};

    #[test]
    fn a_large_file_needs_room_beside_the_reserve() {
        let directory = tempfile::tempdir().unwrap();
        let space = Space::measured_by(directory.path(), || Ok(RESERVE_BYTES + 100));
        assert!(space.has_room_for(100));
        assert!(!space.has_room_for(101));
        assert!(!space.has_room_for(u64::MAX));
        let unknown = Space::measured_by(directory.path(), || Err(io::ErrorKind::Other.into()));
        assert!(
            unknown.has_room_for(u64::MAX),
            "what cannot be measured is not refused"
        );
    }

    #[test]
    fn the_reserve_is_released_when_space_is_low_and_put_back_when_there_is_enough() {
        let directory = tempfile::tempdir().unwrap();
        let free = Arc::new(AtomicU64::new(FREE_BYTES_MIN));
        let measured = Arc::clone(&free);
        let space =
            Space::measured_by(
                directory.path(),
                move || Ok(measured.load(Ordering::SeqCst)),
            );
        let length = || std::fs::metadata(&space.path).ok().map(|file| file.len());
        assert!(space.has_room(), "a small disk is used without a reserve");
        assert_eq!(length(), None);
        free.store(1 << 30, Ordering::SeqCst);
        assert!(space.has_room());
        assert_eq!(length(), Some(RESERVE_BYTES));
        free.store(FREE_BYTES_MIN, Ordering::SeqCst);
        assert!(space.has_room());
        free.store(FREE_BYTES_MIN - 1, Ordering::SeqCst);
        assert!(!space.has_room());
        assert_eq!(length(), Some(0));
        // What the reserve was is free now, and that is not enough to take it back.
        free.store(FREE_BYTES_MIN + RESERVE_BYTES, Ordering::SeqCst);
        assert!(!space.has_room() && space.is_released());
        free.store(2 * FREE_BYTES_MIN + RESERVE_BYTES, Ordering::SeqCst);
        assert!(space.has_room() && !space.is_released());
        assert_eq!(length(), Some(RESERVE_BYTES));
    }

    #[test]
    fn the_space_of_a_directory_is_measured() {
        let directory = tempfile::tempdir().unwrap();
        let space = Space::of(directory.path());
        assert!(space.has_less_than(u64::MAX));
        assert!(!space.has_less_than(1));
    }
}
