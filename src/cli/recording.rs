//! Recordings on disk, whatever their format.

use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};

use anyhow::Context;
use flate2::read::MultiGzDecoder;

use crate::ids::{NAME_LENGTH_MAX, StampNs, TripId};
use crate::ingest::mcap::TopicChoice;
use crate::ingest::{LidarLog, RecordedScans, Recording, format_of, format_title};

const GZIP_MAGIC: [u8; 2] = [0x1f, 0x8b];
/// Room that a batch id needs behind the trip's name.
const SEQUENCE_DIGITS: usize = 6;

/// A recording on the disk, of which everything but the scans is read.
pub(super) struct RecordingFile {
    path: PathBuf,
    /// What it holds.
    pub recording: Recording,
}

/// Reads a recording without its scans; the format is detected by its first bytes, not by its name.
pub(super) fn open(path: &Path, choice: &TopicChoice) -> anyhow::Result<RecordingFile> {
    let open = || {
        let mut reader = reader(path)?;
        let start = reader.fill_buf().context("it could not be unpacked")?;
        let format = format_of(start)?;
        anyhow::Ok(Recording::open(reader, format, choice)?)
    };
    Ok(RecordingFile {
        path: path.to_owned(),
        recording: open().with_context(|| path.display().to_string())?,
    })
}

/// Reads the scans of a recording's first lidar.
pub(super) fn read(path: &Path, beam_spacing: f64) -> anyhow::Result<LidarLog> {
    let file = open(path, &TopicChoice::default())?.with_beam_spacing(beam_spacing);
    let log = file.recording.first_lidar(file.reader()?);
    log.with_context(|| path.display().to_string())
}

fn reader(path: &Path) -> anyhow::Result<Box<dyn BufRead>> {
    let mut file = BufReader::new(File::open(path)?);
    Ok(match file.fill_buf()?.starts_with(&GZIP_MAGIC) {
        true => Box::new(BufReader::new(MultiGzDecoder::new(file))),
        false => Box::new(file),
    })
}

impl RecordingFile {
    /// Opens the file again from its beginning.
    pub(super) fn reader(&self) -> anyhow::Result<Box<dyn BufRead>> {
        reader(&self.path).with_context(|| self.path.display().to_string())
    }

    /// The recording with its beam spacing multiplied by a factor.
    pub(super) fn with_beam_spacing(mut self, factor: f64) -> Self {
        let lidars = std::mem::take(&mut self.recording.lidars).into_iter();
        self.recording.lidars = lidars
            .map(|lidar| lidar.with_beam_spacing(factor))
            .collect();
        self
    }

    /// What is used of it, in lines for people.
    pub(super) fn describe<R: Read>(
        &self,
        scans: usize,
        stamps: [StampNs; 2],
        read: &RecordedScans<'_, R>,
    ) -> Vec<String> {
        let recording = &self.recording;
        let format = format_title(recording.format);
        let duration_s = stamps[1].seconds() - stamps[0].seconds();
        let mut lines = vec![format!(
            "{}: {format}, {scans} scans in {duration_s:.1} s",
            self.path.display()
        )];
        lines.extend(recording.lidars.iter().map(|lidar| {
            let (geometry, mount) = (&lidar.geometry, &lidar.geometry.mount);
            let name = lidar.name.as_ref();
            format!(
                "  lidar{}: {} beams of {:.2}°, up to {} m, mounted at ({:.3} m, {:.3} m, {:.1}°)",
                name.map_or_else(String::new, |name| format!(" {name}")),
                lidar.beams,
                geometry.angle_increment_rad.to_degrees(),
                geometry.range_max_m,
                mount.x,
                mount.y,
                mount.theta.to_degrees(),
            )
        }));
        lines.extend(recording.notes.iter().map(|note| format!("  {note}")));
        lines.extend(resampled_line(read.resampled()));
        let skipped = read.skipped().into_iter();
        lines.extend(skipped.map(|reason| format!("  skipped {reason}")));
        lines
    }
}

/// A line if scans were resampled.
fn resampled_line(scans: usize) -> Option<String> {
    let text = "states other angles than its lidar's first: resampled to the nearest beams of it";
    (scans > 0).then(|| format!("  {scans} × a scan {text}"))
}

/// The trip's name where none is given: the file's name without its endings.
pub(super) fn trip_of(path: &Path) -> anyhow::Result<TripId> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let name = name.strip_suffix(".gz").unwrap_or(&name);
    let stem = [".log", ".clf", ".txt", ".carmen", ".mcap"]
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
        let plain = read(file(LOG.as_bytes()).path(), 1.0).unwrap();
        assert_eq!(plain, read(file(&zipped).path(), 1.0).unwrap());
        assert_eq!(plain.scans.len(), 1);
        let cut = read(file(&zipped[..zipped.len() / 2]).path(), 1.0);
        assert!(cut.is_err());
    }

    #[test]
    fn what_is_no_recording_is_named() {
        for (bytes, word) in [
            (&b"#ROSBAG V2.0\n"[..], "ROS 1"),
            (b"P5 10 10", "CARMEN"),
            (b"\x89MCAP0\r\nxxxx", "no messages"),
        ] {
            let error = format!("{:#}", read(file(bytes).path(), 1.0).unwrap_err());
            assert!(error.contains(word), "{error}");
        }
        let missing = format!("{:#}", read(Path::new("no/such.log"), 1.0).unwrap_err());
        assert!(missing.contains("no/such.log"), "{missing}");
    }

    #[test]
    fn resampled_scans_are_reported() {
        assert_eq!(resampled_line(0), None);
        let line = resampled_line(3).unwrap();
        assert!(line.contains("3 ×") && line.contains("resampled"), "{line}");
    }

    #[test]
    fn trips_are_named_after_their_files() {
        let trip = |path: &str| trip_of(Path::new(path)).map(|t| t.to_string());
        assert_eq!(trip("data/intel.log.gz").unwrap(), "intel");
        assert_eq!(trip("patrol_0.mcap").unwrap(), "patrol_0");
        assert_eq!(trip("2026-11-20.a.clf").unwrap(), "2026-11-20.a");
        assert_eq!(trip("Halle 4 früh.log").unwrap(), "Halle-4-fr-h");
        assert_eq!(trip(&"x".repeat(100)).unwrap().len(), 58);
        assert!(trip("/").is_err());
    }
}
