//! Recordings on disk, whatever their format.

use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;

use anyhow::{Context, bail};
use flate2::read::MultiGzDecoder;

use crate::ids::{NAME_LENGTH_MAX, TripId};
use crate::ingest::{CarmenClock, CarmenLog};

const GZIP_MAGIC: [u8; 2] = [0x1f, 0x8b];
/// Room that a batch id needs behind the trip's name.
const SEQUENCE_DIGITS: usize = 6;

/// Beginnings of files that are no CARMEN logs, and what to tell who sends them.
const FOREIGN: [(&[u8], &str); 6] = [
    (
        b"\x89MCAP0\r\n",
        "an MCAP recording: this version reads CARMEN logs only",
    ),
    (
        b"#ROSBAG V",
        "a ROS 1 bag: this version reads CARMEN logs only",
    ),
    (
        b"SQLite format 3\0",
        "a database (a ROS 2 bag?): this version reads CARMEN logs only",
    ),
    (
        b"\x28\xb5\x2f\xfd",
        "compressed with zstd: unpack it first, or use gzip",
    ),
    (b"PK\x03\x04", "a zip archive: unpack it first"),
    (
        b"BZh",
        "compressed with bzip2: unpack it first, or use gzip",
    ),
];

/// Reads a recording; the format is known by its first bytes, not by its name.
pub(super) fn read(path: &Path) -> anyhow::Result<CarmenLog> {
    read_log(path).with_context(|| path.display().to_string())
}

fn read_log(path: &Path) -> anyhow::Result<CarmenLog> {
    let mut file = BufReader::new(File::open(path)?);
    if file.fill_buf()?.starts_with(&GZIP_MAGIC) {
        parse(BufReader::new(MultiGzDecoder::new(file)))
    } else {
        parse(file)
    }
}

fn parse(mut reader: BufReader<impl Read>) -> anyhow::Result<CarmenLog> {
    let start = reader.fill_buf().context("it could not be unpacked")?;
    if start.is_empty() {
        bail!("the file is empty");
    }
    if let Some((_, advice)) = FOREIGN.iter().find(|(magic, _)| start.starts_with(magic)) {
        bail!("this is {advice}");
    }
    Ok(CarmenLog::read(reader)?)
}

/// The trip's name where none is given: the file's name without its endings.
pub(super) fn trip_of(path: &Path) -> anyhow::Result<TripId> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let name = name.strip_suffix(".gz").unwrap_or(&name);
    let stem = [".log", ".clf", ".txt", ".carmen"]
        .iter()
        .find_map(|ending| name.strip_suffix(ending))
        .unwrap_or(name);
    let plain = stem.chars().map(|c| match c {
        'a'..='z' | 'A'..='Z' | '0'..='9' | '.' | '_' | '-' => c,
        _ => '-',
    });
    let name: String = plain.take(NAME_LENGTH_MAX - SEQUENCE_DIGITS).collect();
    TripId::new(name).with_context(|| {
        format!(
            "{} gives no name for its trip: choose one with --trip",
            path.display()
        )
    })
}

/// What was found in a recording, line by line for people.
pub(super) fn describe(path: &Path, log: &CarmenLog) -> Vec<String> {
    let beams = log.scans.first().map_or(0, |s| s.ranges_m.len());
    let mount = &log.lidar.mount;
    let mut lines = vec![format!(
        "{}: CARMEN log, {} scans × {beams} beams in {:.1} s, lidar up to {} m, mounted at \
         ({:.3} m, {:.3} m, {:.1}°)",
        path.display(),
        log.scans.len(),
        log.duration_s(),
        log.lidar.range_max_m,
        mount.x,
        mount.y,
        mount.theta.to_degrees(),
    )];
    if log.clock == CarmenClock::Relative {
        lines.push("  its times count from an unknown start: taken as 2000-01-01T00:00:00Z".into());
    }
    for (reason, lines_skipped) in &log.skipped {
        lines.push(format!("  skipped {lines_skipped} × {reason}"));
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;

    const LOG: &str = "ROBOTLASER1 0 -0.1 0.2 0.1 5 0 0 3 1 2 3 0 0 0 0 0 0 0 0 0 0 0 0 7 h 7\n";

    fn file(bytes: &[u8]) -> tempfile::NamedTempFile {
        let mut file = tempfile::NamedTempFile::new().unwrap();
        file.write_all(bytes).unwrap();
        file
    }

    #[test]
    fn gzip_is_known_by_its_bytes() {
        let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
        encoder.write_all(LOG.as_bytes()).unwrap();
        let zipped = encoder.finish().unwrap();
        let plain = read(file(LOG.as_bytes()).path()).unwrap();
        assert_eq!(plain, read(file(&zipped).path()).unwrap());
        assert_eq!(plain.scans.len(), 1);
        let cut = read(file(&zipped[..zipped.len() / 2]).path());
        assert!(cut.is_err());
    }

    #[test]
    fn other_formats_are_named() {
        for (bytes, word) in [
            (&b"\x89MCAP0\r\nxxxx"[..], "MCAP"),
            (b"#ROSBAG V2.0\n", "ROS 1"),
            (b"\x28\xb5\x2f\xfdxx", "zstd"),
            (b"", "empty"),
            (b"P5 10 10", "CARMEN"),
        ] {
            let error = format!("{:#}", read(file(bytes).path()).unwrap_err());
            assert!(error.contains(word), "{error}");
        }
        let missing = format!("{:#}", read(Path::new("no/such.log")).unwrap_err());
        assert!(missing.contains("no/such.log"), "{missing}");
    }

    #[test]
    fn trips_are_named_after_their_files() {
        let trip = |path: &str| trip_of(Path::new(path)).map(|t| t.to_string());
        assert_eq!(trip("data/intel.log.gz").unwrap(), "intel");
        assert_eq!(trip("2026-11-20.a.clf").unwrap(), "2026-11-20.a");
        assert_eq!(trip("Halle 4 früh.log").unwrap(), "Halle-4-fr-h");
        assert_eq!(trip(&"x".repeat(100)).unwrap().len(), 58);
        assert!(trip("/").is_err());
    }
}
