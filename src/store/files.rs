//! The files of a data directory: made for their owner alone.

use std::fs::{self, DirBuilder, File, OpenOptions, Permissions};
use std::io;
use std::os::unix::fs::{DirBuilderExt, OpenOptionsExt, PermissionsExt};
use std::path::Path;

/// Bodies and maps are nobody else's business.
const FILE_MODE: u32 = 0o600;
const DIRECTORY_MODE: u32 = 0o700;
const MODE_OF_OTHERS: u32 = 0o077;

/// Makes a directory if it is missing; one that is there is left as it is.
pub(super) fn make_directory(path: &Path) -> io::Result<()> {
    DirBuilder::new()
        .recursive(true)
        .mode(DIRECTORY_MODE)
        .create(path)
}

/// Opens a file to read and write it, made if it is missing.
pub(super) fn open(path: &Path) -> io::Result<File> {
    OpenOptions::new()
        .create(true)
        .truncate(false)
        .read(true)
        .write(true)
        .mode(FILE_MODE)
        .open(path)
}

/// Makes a file that is not there yet.
pub(super) fn create_new(path: &Path) -> io::Result<File> {
    OpenOptions::new()
        .create_new(true)
        .write(true)
        .mode(FILE_MODE)
        .open(path)
}

/// Takes a file from everybody but its owner, if it is there. What cannot be taken is logged: the
/// file may be somebody else's.
pub(super) fn tighten(path: &Path) {
    let Ok(metadata) = fs::metadata(path) else {
        return;
    };
    let mode = metadata.permissions().mode();
    if mode & MODE_OF_OTHERS == 0 {
        return;
    }
    let path_text = path.display();
    let mode = format!("{:o}", mode & 0o7777);
    match fs::set_permissions(path, Permissions::from_mode(FILE_MODE)) {
        Ok(()) => {
            tracing::warn!(path = %path_text, mode, "others could open a file: its mode is 600 now")
        }
        Err(error) => tracing::warn!(path = %path_text, mode, %error, "others can open a file"),
    }
}

/// Writes the entries of a directory to the disk.
pub(super) fn sync_directory(path: &Path) -> io::Result<()> {
    File::open(path)?.sync_all()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mode(path: &Path) -> u32 {
        fs::metadata(path).unwrap().permissions().mode() & 0o777
    }

    #[test]
    fn what_is_made_is_the_owners_alone() {
        let directory = tempfile::tempdir().unwrap();
        let made = directory.path().join("deep/data");
        make_directory(&made).unwrap();
        assert_eq!(mode(&made), 0o700);
        open(&made.join("file")).unwrap();
        assert_eq!(mode(&made.join("file")), 0o600);
        fs::set_permissions(&made, Permissions::from_mode(0o750)).unwrap();
        make_directory(&made).unwrap();
        assert_eq!(
            mode(&made),
            0o750,
            "a directory that is there is its keeper's"
        );
    }

    #[test]
    fn a_lax_mode_is_tightened() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("file");
        open(&path).unwrap();
        fs::set_permissions(&path, Permissions::from_mode(0o644)).unwrap();
        tighten(&path);
        assert_eq!(mode(&path), 0o600);
        tighten(&directory.path().join("missing"));
    }
}
