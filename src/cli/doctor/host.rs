//! The machine: file modes, the file system, the limit of open files.

use std::os::unix::fs::PermissionsExt;
use std::path::Path;

use super::finding::Finding;

const MODE_OF_OTHERS: u32 = 0o077;
/// File systems by their magic numbers: those over a network, whose locks and syncs SQLite cannot rely
/// on, and the one that is gone with the power.
const NETWORK: [(u32, &str); 4] = [
    (0x6969, "NFS"),
    (0xfe53_4d42, "SMB"),
    (0xff53_4d42, "CIFS"),
    (0x6573_5546, "FUSE"),
];
const TMPFS: u32 = 0x0102_1994;
/// As many connections as the service takes, files and all.
const OPEN_FILES_MIN: u64 = 1_024;

/// Checks the machine for a data directory.
pub(super) fn check(data: &Path) -> Vec<Finding> {
    vec![modes(data), file_system(data), sync(data), open_files()]
}

fn modes(data: &Path) -> Finding {
    let check = "file modes";
    let mut lax = Vec::new();
    let entries = std::fs::read_dir(data).into_iter().flatten().flatten();
    for path in entries.map(|entry| entry.path()) {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let Ok(metadata) = path.metadata() else {
            continue;
        };
        let mode = metadata.permissions().mode() & 0o777;
        if name.starts_with("mapshift.") && mode & MODE_OF_OTHERS != 0 {
            lax.push(format!("{name} has mode {mode:o}"));
        }
    }
    match lax.is_empty() {
        true => Finding::ok(check, "the database is its owner's alone"),
        false => Finding::warning(
            check,
            lax.join(", "),
            format!(
                "others can read maps and keys: chmod 600 {}/mapshift.*",
                data.display()
            ),
        ),
    }
}

#[cfg(target_os = "linux")]
fn file_system(data: &Path) -> Finding {
    let check = "file system";
    let magic = match rustix::fs::statfs(data) {
        // Only the lower half is a number; its type differs from one machine to the next.
        Ok(found) => (found.f_type as u64 & 0xffff_ffff) as u32,
        Err(error) => {
            let finding = format!("its kind cannot be known: {error}");
            return Finding::warning(check, finding, "check that the directory is there");
        }
    };
    if let Some((_, name)) = NETWORK.iter().find(|(network, _)| *network == magic) {
        return Finding::error(
            check,
            format!("the data directory is on {name}"),
            "put it on a disk of this machine: SQLite's log and locks do not hold on such a file system",
        );
    }
    match magic {
        TMPFS => Finding::error(
            check,
            "the data directory is in memory (tmpfs)",
            "put it on a disk: what was acknowledged is lost with the next restart of the machine",
        ),
        _ => Finding::ok(check, "a local one"),
    }
}

#[cfg(not(target_os = "linux"))]
fn file_system(_data: &Path) -> Finding {
    Finding::ok("file system", "not checked on this system")
}

/// Whether a file can be written there and synced.
fn sync(data: &Path) -> Finding {
    let check = "sync";
    let written = tempfile::Builder::new()
        .prefix(".mapshift-doctor-")
        .tempfile_in(data)
        .and_then(|file| file.as_file().set_len(1).and(file.as_file().sync_all()));
    match written {
        Ok(()) => Finding::ok(check, "a file can be written and synced"),
        Err(error) => Finding::warning(
            check,
            format!("a file cannot be written and synced: {error}"),
            "run doctor as the user of the service; if it is that user, the service cannot write",
        ),
    }
}

fn open_files() -> Finding {
    let check = "open files";
    let limits = std::fs::read_to_string("/proc/self/limits").unwrap_or_default();
    match open_file_limit(&limits) {
        None => Finding::ok(check, "the limit cannot be known here"),
        Some(limit) if limit < OPEN_FILES_MIN => Finding::warning(
            check,
            format!("{limit} files can be open in this shell"),
            "raise it for the service (ulimit -n 8192, LimitNOFILE=8192): each connection is one",
        ),
        Some(limit) => Finding::ok(check, format!("{limit} can be open in this shell")),
    }
}

/// The soft limit in what the kernel says of a process.
fn open_file_limit(limits: &str) -> Option<u64> {
    let line = limits
        .lines()
        .find_map(|line| line.strip_prefix("Max open files"))?;
    let soft = line.split_whitespace().next()?;
    match soft {
        "unlimited" => Some(u64::MAX),
        soft => soft.parse().ok(),
    }
}

#[cfg(test)]
mod tests {
    use super::super::finding::Level;
    use super::*;

    #[test]
    fn the_limit_is_the_soft_one() {
        let limits = "Limit    Soft Limit  Hard Limit  Units\n\
                      Max open files            1024                 524288               files\n";
        assert_eq!(open_file_limit(limits), Some(1024));
        assert_eq!(
            open_file_limit("Max open files  unlimited unlimited files"),
            Some(u64::MAX)
        );
        assert_eq!(open_file_limit(""), None);
    }

    #[test]
    fn lax_modes_are_named() {
        let directory = tempfile::tempdir().unwrap();
        let file = directory.path().join("mapshift.db");
        std::fs::write(&file, "").unwrap();
        std::fs::set_permissions(&file, std::fs::Permissions::from_mode(0o644)).unwrap();
        let found = modes(directory.path());
        assert_eq!(found.level, Level::Warning);
        assert!(found.finding.contains("mapshift.db has mode 644"));
        std::fs::set_permissions(&file, std::fs::Permissions::from_mode(0o600)).unwrap();
        assert_eq!(modes(directory.path()).level, Level::Ok);
    }
}
