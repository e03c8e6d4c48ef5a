//! A small disk that can be filled.

use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use tempfile::TempDir;

/// A mounted tmpfs; unmounted when dropped.
pub struct Tmpfs {
    directory: TempDir,
}

/// Why none can be mounted here, if none can.
pub fn obstacle() -> Option<String> {
    Tmpfs::mount(1).err()
}

impl Tmpfs {
    /// A disk of this many MiB, or why there is none.
    pub fn mount(size_mib: usize) -> Result<Self, String> {
        let directory = TempDir::new().unwrap();
        let mounted = Command::new("mount")
            .args(["-t", "tmpfs", "-o", &format!("size={size_mib}m"), "tmpfs"])
            .arg(directory.path())
            .output();
        let refused = |why: &str| format!("no tmpfs can be mounted here: {why}");
        match mounted {
            Ok(Output { status, .. }) if status.success() => Ok(Self { directory }),
            Ok(Output { stderr, .. }) => Err(refused(String::from_utf8_lossy(&stderr).trim())),
            Err(error) => Err(refused(&error.to_string())),
        }
    }

    pub fn path(&self) -> &Path {
        self.directory.path()
    }

    fn ballast(&self) -> PathBuf {
        self.path().join("ballast")
    }

    /// Takes all the space that is left.
    pub fn fill(&self) {
        let mut file = File::options()
            .create(true)
            .append(true)
            .open(self.ballast())
            .unwrap();
        for length in [1 << 20, 4096] {
            while file.write_all(&vec![1; length]).is_ok() {}
        }
    }

    /// Gives the space back.
    pub fn free(&self) {
        std::fs::remove_file(self.ballast()).unwrap();
    }
}

impl Drop for Tmpfs {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg(self.path()).status();
    }
}
