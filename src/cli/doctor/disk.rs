//! Space on the disk, and how long it lasts.

use std::path::Path;

use jiff::{SignedDuration, Timestamp};

use super::finding::Finding;
use crate::store::Checkup;

const CHECK: &str = "disk";
/// Days over which growth is measured.
pub(super) const RECENT_DAYS: i64 = 7;
/// Free space below which the service soon refuses uploads, bytes: its reserve and some work.
const FREE_BYTES_MIN: u64 = 256 << 20;
const DAYS_MIN: f64 = 30.0;
const DAY_S: f64 = 86_400.0;
const MEBIBYTE: u64 = 1 << 20;
/// The reserve, empty once the disk was full.
const RESERVE: &str = "mapshift.reserve";

/// Since when uploads count as recent.
pub(super) fn recent(now: Timestamp) -> Timestamp {
    now.saturating_sub(SignedDuration::from_hours(24 * RECENT_DAYS))
        .unwrap_or(Timestamp::UNIX_EPOCH)
}

/// Checks the disk of a data directory.
pub(super) fn check(data: &Path, checkup: Option<&Checkup>, now: Timestamp) -> Finding {
    let free_bytes = match rustix::fs::statvfs(data) {
        Ok(disk) => disk.f_bavail.saturating_mul(disk.f_frsize),
        Err(error) => {
            let finding = format!("its space cannot be known: {error}");
            return Finding::warning(CHECK, finding, "check that the directory is there");
        }
    };
    let was_full = std::fs::metadata(data.join(RESERVE)).is_ok_and(|file| file.len() == 0);
    judge(
        free_bytes,
        was_full,
        checkup.and_then(|c| growth_a_day(c, now)),
    )
}

fn judge(free_bytes: u64, was_full: bool, bytes_a_day: Option<f64>) -> Finding {
    let free = format!("{} MiB are free", free_bytes / MEBIBYTE);
    let make_room = "make room, delete routes, or keep bodies for fewer days (keep-bodies-days)";
    if was_full {
        let finding = format!("{free}, and the disk was full: uploads may be refused");
        return Finding::error(CHECK, finding, make_room);
    }
    if free_bytes < FREE_BYTES_MIN {
        return Finding::error(CHECK, free, make_room);
    }
    let Some(bytes_a_day) = bytes_a_day.filter(|bytes| *bytes > 0.0) else {
        return Finding::ok(CHECK, free);
    };
    let days = free_bytes as f64 / bytes_a_day;
    let finding = format!(
        "{free}: full in {days:.0} days at {:.1} MiB a day, the mean of the last {RECENT_DAYS} days",
        bytes_a_day / MEBIBYTE as f64
    );
    match days < DAYS_MIN {
        true => Finding::warning(CHECK, finding, make_room),
        false => Finding::ok(CHECK, finding),
    }
}

/// How much the files grow, by the uploads of the last days; `None` before there was one whole day.
fn growth_a_day(checkup: &Checkup, now: Timestamp) -> Option<f64> {
    let first = checkup.first_batch_at?;
    let days = now.duration_since(first).as_secs_f64() / DAY_S;
    if days < 1.0 || checkup.body_bytes == 0 {
        return None;
    }
    // Maps and alerts grow with the uploads that they come from.
    let kept = checkup.file_bytes as f64 / checkup.body_bytes as f64;
    Some(checkup.recent_body_bytes as f64 * kept / days.min(RECENT_DAYS as f64))
}

#[cfg(test)]
mod tests {
    use super::super::finding::Level;
    use super::*;

    #[test]
    fn a_disk_that_is_nearly_full_is_named_in_time() {
        let gibibyte = 1 << 30;
        let level = |free, was_full, growth| judge(free, was_full, growth).level;
        assert_eq!(level(100 * gibibyte, false, None), Level::Ok);
        assert_eq!(
            level(100 * gibibyte, false, Some(gibibyte as f64)),
            Level::Ok
        );
        assert_eq!(
            level(20 * gibibyte, false, Some(gibibyte as f64)),
            Level::Warning
        );
        assert_eq!(level(100 << 20, false, None), Level::Error);
        assert_eq!(level(100 * gibibyte, true, None), Level::Error);
        let text = judge(60 * gibibyte, false, Some(gibibyte as f64)).finding;
        assert!(
            text.contains("full in 60 days at 1024.0 MiB a day"),
            "{text}"
        );
    }
}
