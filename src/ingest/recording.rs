//! Recordings of a trip in any supported format.
//!
//! A recording is read twice: once to open it, once for its scans, so that no scans are kept in memory.

use std::io::{BufRead, Read};

use super::carmen::{CarmenClock, CarmenError, CarmenLog};
use super::mcap::{McapError, Plan, ScanReader, Survey, TopicChoice};
use super::recorded::{LidarLog, RELATIVE_TIMES_NOTE, RecordedLidar, RecordedScan};
use crate::model::RecordingFormat;

/// First bytes of files that are not recordings, with what they are and what to do with them.
const FOREIGN: [(&[u8], &str); 6] = [
    (
        b"#ROSBAG V",
        "a ROS 1 bag: convert it with `mcap convert in.bag out.mcap`",
    ),
    (
        b"SQLite format 3\0",
        "a database, perhaps a ROS 2 bag: convert it with `mcap convert in.db3 out.mcap`, or the whole \
         bag with `ros2 bag convert` and the storage mcap",
    ),
    (
        b"\x28\xb5\x2f\xfd",
        "compressed with zstd: unpack it first with `unzstd`, or use gzip",
    ),
    (b"\x1f\x8b", "compressed with gzip: unpack it first"),
    (b"PK\x03\x04", "a zip archive: unpack it first"),
    (
        b"BZh",
        "compressed with bzip2: unpack it first, or use gzip",
    ),
];

/// Why a recording cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// Another kind of file.
    #[error("this is {0}")]
    Foreign(&'static str),
    /// An empty file.
    #[error("the file is empty")]
    Empty,
    /// A CARMEN log that cannot be used.
    #[error(transparent)]
    Carmen(#[from] CarmenError),
    /// An MCAP recording that cannot be used.
    #[error(transparent)]
    Mcap(#[from] McapError),
    /// Topics are chosen, but the format has none.
    #[error("a CARMEN log has no topics: leave the topics out")]
    NoTopics,
}

/// A recording of one trip.
#[derive(Debug)]
pub struct Recording {
    /// Its format.
    pub format: RecordingFormat,
    /// Its lidars; the first takes keyframes.
    pub lidars: Vec<RecordedLidar>,
    /// Decisions and assumptions, for people.
    pub notes: Vec<String>,
    content: Content,
}

#[derive(Debug)]
enum Content {
    /// All scans of an only lidar, and what gave none.
    InMemory(Vec<RecordedScan>, Vec<String>),
    /// What a second reading takes.
    Mcap(Plan),
}

/// The scans of a recording in the order of time, each with the index of its lidar.
pub enum RecordedScans<'a, R> {
    /// Of a recording whose scans were all read when it was opened.
    InMemory(std::slice::Iter<'a, RecordedScan>, &'a [String]),
    /// Of an MCAP recording.
    Mcap(Box<ScanReader<'a, R>>),
}

/// Detects a file's format by its first bytes.
///
/// # Errors
/// [`RecordingError::Foreign`] with what to do with it.
pub fn format_of(start: &[u8]) -> Result<RecordingFormat, RecordingError> {
    if start.is_empty() {
        return Err(RecordingError::Empty);
    }
    if let Some((_, advice)) = FOREIGN.iter().find(|(magic, _)| start.starts_with(magic)) {
        return Err(RecordingError::Foreign(advice));
    }
    Ok(match start.starts_with(super::mcap::MAGIC) {
        true => RecordingFormat::Mcap,
        false => RecordingFormat::Carmen,
    })
}

/// What a format is called, for people.
pub fn format_title(format: RecordingFormat) -> &'static str {
    match format {
        RecordingFormat::Carmen => "CARMEN log",
        RecordingFormat::Mcap => "MCAP recording",
    }
}

impl Recording {
    /// Reads a recording without its scans.
    ///
    /// # Errors
    /// [`RecordingError`] if it cannot be used.
    pub fn open(
        reader: impl BufRead,
        format: RecordingFormat,
        choice: &TopicChoice,
    ) -> Result<Self, RecordingError> {
        match format {
            RecordingFormat::Carmen => Self::of_carmen(CarmenLog::read(reader)?, choice),
            RecordingFormat::Mcap => {
                let mut plan = Plan::of(&Survey::of(reader)?, choice)?;
                Ok(Self {
                    format,
                    lidars: plan.lidars.clone(),
                    notes: std::mem::take(&mut plan.notes),
                    content: Content::Mcap(plan),
                })
            }
        }
    }

    fn of_carmen(log: CarmenLog, choice: &TopicChoice) -> Result<Self, RecordingError> {
        if !choice.lidars.is_empty() || choice.odometry.is_some() {
            return Err(RecordingError::NoTopics);
        }
        let mut geometry = log.lidar;
        let (mount, stated) = (&mut geometry.mount, &choice.mount);
        mount.x = stated.x.unwrap_or(mount.x);
        mount.y = stated.y.unwrap_or(mount.y);
        mount.theta = stated.theta.unwrap_or(mount.theta);
        let mut notes = Vec::new();
        if log.clock == CarmenClock::Relative {
            notes.push(RELATIVE_TIMES_NOTE.into());
        }
        let skipped = log.skipped.iter();
        let skipped = skipped.map(|(reason, lines)| format!("{lines} × {reason}"));
        Ok(Self {
            format: RecordingFormat::Carmen,
            lidars: vec![RecordedLidar {
                name: None,
                geometry: geometry.validated().map_err(CarmenError::from)?,
                beams: log.scans.first().map_or(0, |scan| scan.ranges_m.len()),
                time_increment_s: 0.0,
                scan_time_s: 0.0,
            }],
            notes,
            content: Content::InMemory(log.scans, skipped.collect()),
        })
    }

    /// The scans, in a second reading of the same bytes.
    ///
    /// # Errors
    /// [`RecordingError`] if they are not those that were opened.
    pub fn scans<R: Read>(&self, reader: R) -> Result<RecordedScans<'_, R>, RecordingError> {
        Ok(match &self.content {
            Content::InMemory(scans, skipped) => RecordedScans::InMemory(scans.iter(), skipped),
            Content::Mcap(plan) => RecordedScans::Mcap(Box::new(ScanReader::new(plan, reader)?)),
        })
    }

    /// The scans of the first lidar, all of them, in a second reading of the same bytes.
    ///
    /// # Errors
    /// [`RecordingError`] if there are none.
    pub fn first_lidar(&self, reader: impl Read) -> Result<LidarLog, RecordingError> {
        let mut scans = Vec::new();
        for read in self.scans(reader)? {
            let (place, scan) = read?;
            if place == 0 {
                scans.push(scan);
            }
        }
        Ok(LidarLog {
            lidar: self.lidars[0].geometry.clone(),
            scans,
        })
    }
}

impl<R: Read> RecordedScans<'_, R> {
    /// What was skipped so far and why, for people.
    pub fn skipped(&self) -> Vec<String> {
        match self {
            Self::InMemory(_, skipped) => skipped.to_vec(),
            Self::Mcap(reader) => {
                let skipped = reader.skipped().iter();
                skipped
                    .map(|(reason, scans)| format!("{scans} × {reason}"))
                    .collect()
            }
        }
    }

    /// How many scans so far were resampled to the angles of their lidar's first one.
    pub fn resampled(&self) -> usize {
        match self {
            Self::InMemory(..) => 0,
            Self::Mcap(reader) => reader.resampled(),
        }
    }

    /// That none of the scans could be used.
    pub fn none_usable(&self) -> RecordingError {
        let skipped = self.skipped();
        let reasons = match skipped.is_empty() {
            true => String::new(),
            false => format!(" (skipped {})", skipped.join("; ")),
        };
        McapError::NoScans(reasons).into()
    }
}

impl<R: Read> Iterator for RecordedScans<'_, R> {
    type Item = Result<(usize, RecordedScan), RecordingError>;

    fn next(&mut self) -> Option<Self::Item> {
        match self {
            Self::InMemory(scans, _) => scans.next().map(|scan| Ok((0, scan.clone()))),
            Self::Mcap(reader) => reader.next().map(|read| read.map_err(RecordingError::from)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ingest::mcap::MountOverride;

    const LOG: &str = "ROBOTLASER1 0 -0.1 0.2 0.1 5 0 0 3 1 2 3 0 0 0 0 0 0 0 0 0 0 0 0 7 h 7\n";

    #[test]
    fn formats_are_known_by_their_first_bytes() {
        assert_eq!(format_of(LOG.as_bytes()).unwrap(), RecordingFormat::Carmen);
        assert_eq!(
            format_of(b"\x89MCAP0\r\nxxxx").unwrap(),
            RecordingFormat::Mcap
        );
        for (bytes, word) in [
            (&b"#ROSBAG V2.0\n"[..], "mcap convert"),
            (b"SQLite format 3\0", "ros2 bag convert"),
            (b"\x28\xb5\x2f\xfdxx", "zstd"),
            (b"", "empty"),
        ] {
            let error = format_of(bytes).unwrap_err().to_string();
            assert!(error.contains(word), "{error}");
        }
    }

    #[test]
    fn a_log_has_a_mount_and_no_topics() {
        let open =
            |choice: &TopicChoice| Recording::open(LOG.as_bytes(), RecordingFormat::Carmen, choice);
        let choice = TopicChoice {
            mount: MountOverride {
                theta: Some(0.5),
                ..MountOverride::default()
            },
            ..TopicChoice::default()
        };
        let recording = open(&choice).unwrap();
        assert_eq!(recording.lidars[0].geometry.mount.theta, 0.5);
        let log = recording.first_lidar(LOG.as_bytes()).unwrap();
        assert_eq!(log.scans[0].ranges_m, [Some(1.0), Some(2.0), Some(3.0)]);
        let choice = TopicChoice {
            lidars: vec!["/scan".into()],
            ..TopicChoice::default()
        };
        assert!(matches!(open(&choice), Err(RecordingError::NoTopics)));
    }
}
