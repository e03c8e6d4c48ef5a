//! Putting a backup in the place of a data directory's database.

use std::fs::{self, DirBuilder};
use std::io::{self, ErrorKind};
use std::os::unix::fs::{DirBuilderExt, MetadataExt, lchown};
use std::path::{Path, PathBuf};

use super::connection::Database;
use super::error::StoreError;
use super::lock::{DirectoryLock, LOCK_FILE};
use super::{files, marker};

const ROOT: u32 = 0;

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
        let held = Self {
            path: path.to_path_buf(),
            _lock: DirectoryLock::acquire(path)?,
        };
        let given = held.give_to_owner(&path.join(LOCK_FILE));
        given.map_err(|source| held.failed(source))?;
        Ok(held)
    }

    /// The files in it that belong to a database.
    pub fn database_files(&self) -> Vec<PathBuf> {
        let database = Database::in_directory(&self.path).files();
        let beside = [marker::path(&self.path)];
        let all = database.into_iter().chain(beside);
        all.filter(|file| file.exists()).collect()
    }

    /// Puts a file, which lies on the same disk, in the place of the database. The files of a database
    /// that is there are moved to the directory `aside`, which is made. What root puts there belongs to
    /// the owner of the data directory.
    ///
    /// If the process is stopped at any moment, the database that was there or the new one is in place.
    /// The marker is moved last: a database without its log, which lacks commits, is not opened.
    ///
    /// # Errors
    /// [`StoreError::Directory`]; the database is as it was, unless the new one is in its place.
    pub fn put(self, file: &Path, aside: &Path) -> Result<(), StoreError> {
        let put = match self.database_files().is_empty() {
            true => self.put_in(file).and_then(|()| self.sync()),
            false => self.replace(file, aside),
        };
        put.map_err(|source| self.failed(source))
    }

    fn replace(&self, file: &Path, aside: &Path) -> io::Result<()> {
        DirBuilder::new().mode(0o700).create(aside)?;
        if let Err(error) = self.keep(aside).and_then(|()| self.put_in(file)) {
            return Err(match self.put_back(aside) {
                Ok(()) => error,
                Err(left) => io::Error::new(
                    error.kind(),
                    format!(
                        "{error}; what is in {} could not be put back: {left}",
                        aside.display()
                    ),
                ),
            });
        }
        self.sync()?;
        move_if_there(&marker::path(&self.path), aside)?;
        files::sync_directory(aside)?;
        self.sync()
    }

    /// Moves the log away, which SQLite would replay into the new database, and gives the old database
    /// a second name, so that there is a database in place at every moment.
    fn keep(&self, aside: &Path) -> io::Result<()> {
        self.give_to_owner(aside)?;
        let [database, log, index] = Database::in_directory(&self.path).files();
        move_if_there(&log, aside)?;
        move_if_there(&index, aside)?;
        if database.exists() {
            fs::hard_link(&database, within(aside, &database))?;
        }
        files::sync_directory(aside)?;
        self.sync()
    }

    /// Undoes [`HeldDirectory::keep`], however far it came.
    fn put_back(&self, aside: &Path) -> io::Result<()> {
        let [database, log, index] = Database::in_directory(&self.path).files();
        move_if_there(&within(aside, &log), &self.path)?;
        move_if_there(&within(aside, &index), &self.path)?;
        let second_name = within(aside, &database);
        if second_name.exists() {
            fs::remove_file(second_name)?;
        }
        fs::remove_dir(aside)?;
        self.sync()
    }

    fn put_in(&self, file: &Path) -> io::Result<()> {
        self.give_to_owner(file)?;
        fs::rename(file, Database::in_directory(&self.path).path())
    }

    /// Gives what root made to the owner of the directory: the service has to open it.
    fn give_to_owner(&self, path: &Path) -> io::Result<()> {
        let (directory, made) = (fs::metadata(&self.path)?, fs::symlink_metadata(path)?);
        if made.uid() != ROOT || directory.uid() == ROOT {
            return Ok(());
        }
        match lchown(path, Some(directory.uid()), Some(directory.gid())) {
            // A root without that right, in a container: the service may be the same user.
            Err(error) if error.kind() == ErrorKind::PermissionDenied => Ok(()),
            given => given,
        }
    }

    fn sync(&self) -> io::Result<()> {
        files::sync_directory(&self.path)
    }

    fn failed(&self, source: io::Error) -> StoreError {
        StoreError::Directory {
            path: self.path.clone(),
            source,
        }
    }
}

/// Where a file is once it is in a directory.
fn within(directory: &Path, file: &Path) -> PathBuf {
    directory.join(file.file_name().unwrap_or_default())
}

fn move_if_there(file: &Path, directory: &Path) -> io::Result<()> {
    match fs::rename(file, within(directory, file)) {
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(()),
        moved => moved,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::{Store, StoreOptions, back_up};

    async fn made(data_dir: &Path) {
        let data_dir = data_dir.to_path_buf();
        let store = Store::open(StoreOptions { data_dir }).await.unwrap();
        store.close().await.unwrap();
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
        assert!(data.join(LOCK_FILE).exists());
        assert_eq!(held.database_files().len(), 3);
        held.put(&file, &aside).unwrap();
        assert_eq!(fs::read(data.join("mapshift.db")).unwrap(), b"restored");
        assert_eq!(fs::read(aside.join("mapshift.db-wal")).unwrap(), b"log");
        assert!(aside.join("mapshift.db").exists() && aside.join("mapshift.open").exists());
        assert!(!data.join("mapshift.open").exists() && !data.join("mapshift.db-wal").exists());
    }

    #[tokio::test]
    async fn what_was_there_is_put_back_if_nothing_takes_its_place() {
        let directory = tempfile::tempdir().unwrap();
        let (data, aside) = (directory.path().to_path_buf(), directory.path().join("old"));
        made(&data).await;
        fs::write(data.join("mapshift.db-wal"), "log").unwrap();
        fs::write(data.join("mapshift.open"), "7").unwrap();
        let database = fs::read(data.join("mapshift.db")).unwrap();
        let held = HeldDirectory::hold(&data).unwrap();
        let put = held.put(&data.join("missing"), &aside);
        assert!(matches!(put, Err(StoreError::Directory { .. })));
        assert_eq!(fs::read(data.join("mapshift.db")).unwrap(), database);
        assert_eq!(fs::read(data.join("mapshift.db-wal")).unwrap(), b"log");
        assert_eq!(fs::read(data.join("mapshift.open")).unwrap(), b"7");
        assert!(!aside.exists());
    }

    #[tokio::test]
    async fn a_directory_in_which_it_was_stopped_halfway_is_not_started() {
        let directory = tempfile::tempdir().unwrap();
        let data = directory.path().join("data");
        let (file, aside) = (data.join("new"), data.join("old"));
        made(&data).await;
        back_up(&data, &file).await.unwrap();
        fs::write(data.join("mapshift.db-wal"), "log").unwrap();
        fs::write(data.join("mapshift.open"), "99").unwrap();
        fs::create_dir(&aside).unwrap();
        let refused = async || {
            let data_dir = data.clone();
            let opened = Store::open(StoreOptions { data_dir }).await;
            matches!(opened.err(), Some(StoreError::LostLog { .. }))
        };

        HeldDirectory::hold(&data).unwrap().keep(&aside).unwrap();
        assert!(refused().await, "the old one lacks its log");
        HeldDirectory::hold(&data).unwrap().put_in(&file).unwrap();
        assert!(refused().await, "the new one has its marker");
        assert!(matches!(
            back_up(&data, &file).await,
            Err(StoreError::LostLog { .. })
        ));
    }

    #[tokio::test]
    async fn what_root_restores_is_the_directorys_owners() {
        const OWNER: u32 = 12_345;
        let directory = tempfile::tempdir().unwrap();
        let (data, aside) = (directory.path().to_path_buf(), directory.path().join("old"));
        made(&data).await;
        fs::remove_file(data.join(LOCK_FILE)).unwrap();
        let file = data.join("new");
        fs::write(&file, "restored").unwrap();
        // Root alone may.
        if lchown(&data, Some(OWNER), Some(OWNER)).is_err() {
            return;
        }
        let held = HeldDirectory::hold(&data).unwrap();
        held.put(&file, &aside).unwrap();
        for path in [data.join("mapshift.db"), data.join(LOCK_FILE), aside] {
            let owner = fs::metadata(&path).unwrap();
            assert_eq!((owner.uid(), owner.gid()), (OWNER, OWNER), "{path:?}");
        }
    }
}
