//! CARMEN logs: one text line per message.

use std::collections::BTreeMap;
use std::io::{self, BufRead, Read};

use super::carmen_line::{Line, Message, SkipReason, parse_line};
use super::recorded::{LidarLog, RecordedScan};
use crate::geometry::{Pose2, angle_difference_rad};
use crate::ids::StampNs;
use crate::scan::{LaserScan, Lidar, LidarError, ScanError};

/// Longest line that can be a scan, bytes.
const LINE_MAX: u64 = 1 << 20;
/// How far the mount may wander over a log: logs round poses, metres and radians.
const MOUNT_TOLERANCE: f64 = 0.01;
/// Times before 1973 are no times of day but seconds since the recording began.
const RELATIVE_TIME_MAX_S: f64 = 1e8;

/// A recording of one lidar.
#[derive(Debug, Clone, PartialEq)]
pub struct CarmenLog {
    /// The lidar of every scan; `mount` is the laser pose as seen from the robot pose.
    pub lidar: Lidar,
    /// In order of time, strictly increasing.
    pub scans: Vec<RecordedScan>,
    /// Lines that gave no scan, comments and blank lines left out.
    pub skipped: BTreeMap<SkipReason, usize>,
    /// Where the times come from.
    pub clock: CarmenClock,
}

/// What a log's time stamps count from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CarmenClock {
    /// Unix time.
    Unix,
    /// An unknown start, or the index of the scan: kept as if it were 1970, as the times of simulations.
    Relative,
}

impl CarmenClock {
    /// What a time counts from.
    fn of(time_s: f64) -> Self {
        match time_s < RELATIVE_TIME_MAX_S {
            true => Self::Relative,
            false => Self::Unix,
        }
    }
}

/// Why a log could not be used at all.
#[derive(Debug, thiserror::Error)]
pub enum CarmenError {
    /// It could not be read.
    #[error("the log could not be read")]
    Io(#[from] io::Error),
    /// No line was a usable scan.
    #[error(
        "no ROBOTLASER1 or FLASER line could be used{}: is this a CARMEN log?",
        skipped_text(.0)
    )]
    NoScans(BTreeMap<SkipReason, usize>),
    /// The first scan states an impossible lidar.
    #[error("the log's lidar cannot be right")]
    Lidar(#[from] LidarError),
    /// The first scan does not fit its lidar.
    #[error("the log's first scan cannot be right")]
    Scan(#[from] ScanError),
}

fn skipped_text(skipped: &BTreeMap<SkipReason, usize>) -> String {
    let counts: Vec<_> = skipped.iter().map(|(r, n)| format!("{n} × {r}")).collect();
    if counts.is_empty() {
        String::new()
    } else {
        format!(" ({})", counts.join("; "))
    }
}

impl CarmenLog {
    /// Reads a log line by line.
    ///
    /// The first usable scan decides the lidar, where it is mounted (rounded to 0.1 mm and
    /// 0.1 mrad), which of the two messages is read, and whether times are Unix time. Lines
    /// that do not fit it are skipped and counted.
    ///
    /// # Errors
    /// [`CarmenError`] if nothing in it can be used.
    pub fn read(mut reader: impl BufRead) -> Result<Self, CarmenError> {
        let mut builder = Builder::default();
        let mut bytes = Vec::new();
        loop {
            bytes.clear();
            let read = (&mut reader).take(LINE_MAX).read_until(b'\n', &mut bytes)?;
            if read == 0 {
                return builder.finish();
            }
            if read as u64 == LINE_MAX && bytes.last() != Some(&b'\n') {
                skip_to_line_end(&mut reader)?;
                builder.skip(SkipReason::TooLong);
                continue;
            }
            match parse_line(&String::from_utf8_lossy(&bytes)) {
                None => {}
                Some(Ok(line)) => builder.take(line)?,
                Some(Err(reason)) => builder.skip(reason),
            }
        }
    }
}

impl From<CarmenLog> for LidarLog {
    fn from(log: CarmenLog) -> Self {
        Self {
            lidar: log.lidar,
            scans: log.scans,
        }
    }
}

fn skip_to_line_end(reader: &mut impl BufRead) -> io::Result<()> {
    loop {
        let buffer = reader.fill_buf()?;
        let (used, done) = match buffer.iter().position(|&b| b == b'\n') {
            Some(end) => (end + 1, true),
            None => (buffer.len(), buffer.is_empty()),
        };
        reader.consume(used);
        if done {
            return Ok(());
        }
    }
}

#[derive(Default)]
struct Builder {
    first: Option<First>,
    scans: Vec<RecordedScan>,
    skipped: BTreeMap<SkipReason, usize>,
}

/// What the first scan decided.
struct First {
    message: Message,
    lidar: Lidar,
    beams: usize,
    clock: CarmenClock,
}

impl Builder {
    fn skip(&mut self, reason: SkipReason) {
        *self.skipped.entry(reason).or_default() += 1;
    }

    fn take(&mut self, line: Line) -> Result<(), CarmenError> {
        let first = match self.first.take() {
            Some(first) => first,
            None => First::of(&line)?,
        };
        let first = self.first.insert(first);
        match first.stamp_of(&line) {
            Err(reason) => self.skip(reason),
            Ok(stamp) if self.scans.last().is_some_and(|s| s.stamp >= stamp) => {
                self.skip(SkipReason::NotLater);
            }
            Ok(stamp) => self.scans.push(RecordedScan {
                stamp,
                odom_from_base: line.odom_from_base,
                ranges_m: line.ranges_m,
            }),
        }
        Ok(())
    }

    fn finish(self) -> Result<CarmenLog, CarmenError> {
        let Some(first) = self.first else {
            return Err(CarmenError::NoScans(self.skipped));
        };
        Ok(CarmenLog {
            lidar: first.lidar,
            scans: self.scans,
            skipped: self.skipped,
            clock: first.clock,
        })
    }
}

impl First {
    fn of(line: &Line) -> Result<Self, CarmenError> {
        let round = |value: f64| (value * 1e4).round() / 1e4;
        let mount = &line.lidar.mount;
        let lidar = Lidar {
            mount: Pose2::new(round(mount.x), round(mount.y), round(mount.theta)),
            ..line.lidar.clone()
        }
        .validated()?;
        LaserScan::new(lidar.clone().into(), line.ranges_m.iter().copied())?;
        Ok(Self {
            message: line.message,
            lidar,
            beams: line.ranges_m.len(),
            clock: CarmenClock::of(line.time_s),
        })
    }

    fn stamp_of(&self, line: &Line) -> Result<StampNs, SkipReason> {
        if line.message != self.message {
            return Err(SkipReason::OtherMessage);
        }
        if line.ranges_m.len() != self.beams {
            return Err(SkipReason::BeamCount);
        }
        if !same_lidar(&self.lidar, &line.lidar) {
            return Err(SkipReason::OtherLidar);
        }
        if CarmenClock::of(line.time_s) != self.clock {
            return Err(SkipReason::NotANumber);
        }
        let microseconds = (line.time_s * 1e6).round() as i64;
        Ok(StampNs(microseconds * 1_000))
    }
}

fn same_lidar(a: &Lidar, b: &Lidar) -> bool {
    let close = |x: f64, y: f64| (x - y).abs() <= 1e-6;
    close(a.angle_min_rad, b.angle_min_rad)
        && close(a.angle_increment_rad, b.angle_increment_rad)
        && close(a.range_max_m, b.range_max_m)
        && (a.mount.translation() - b.mount.translation()).norm() <= MOUNT_TOLERANCE
        && angle_difference_rad(a.mount.theta, b.mount.theta) <= MOUNT_TOLERANCE
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::BufReader;

    fn line(time: &str, laser_x: f64) -> String {
        format!(
            "ROBOTLASER1 0 -0.1 0.2 0.1 5 0 0 3 1 2 3 0 {laser_x} 0 0 1 0 0 0 0 0 0 0 {time} h {time}\n"
        )
    }

    fn read(text: &str) -> Result<CarmenLog, CarmenError> {
        CarmenLog::read(text.as_bytes())
    }

    #[test]
    fn a_log_with_everything_that_goes_wrong() {
        let text = [
            "# a comment\n\nODOM 1 2 3 0 0 0 1 h 1\n",
            &line("100.25", 1.145),
            &line("100.25", 1.145),
            &line("99", 1.145),
            &line("101", 1.146),
            &line("102", 1.3),
            &line("103", 1.145).replace(" 3 1 2 3", " 2 1 2"),
            &line("104", 1.145).replace(" 5 0 0", " 6 0 0"),
            &line("976052857", 1.145),
            "FLASER 180\n",
            "ROBOTLASER1 0 -0.1 \u{fffd}\n",
            &line("105", 1.145),
        ]
        .concat();
        let log = read(&text).unwrap();
        assert_eq!(log.clock, CarmenClock::Relative);
        assert_eq!(log.lidar.mount, Pose2::new(0.145, 0.0, 0.0));
        let stamps: Vec<i64> = log.scans.iter().map(|s| s.stamp.0).collect();
        assert_eq!(stamps, [100_250_000_000, 101_000_000_000, 105_000_000_000]);
        assert!(log.scans.iter().all(|scan| scan.stamp.is_simulated()));
        let skipped: Vec<_> = log.skipped.into_iter().collect();
        assert_eq!(
            skipped,
            [
                (SkipReason::OtherMessage, 1),
                (SkipReason::Truncated, 1),
                (SkipReason::NotANumber, 2),
                (SkipReason::BeamCount, 1),
                (SkipReason::OtherLidar, 2),
                (SkipReason::NotLater, 2),
            ]
        );
    }

    #[test]
    fn unix_times_keep_their_microseconds() {
        let log = read(&line("976052890.244111", 1.0)).unwrap();
        assert_eq!(log.clock, CarmenClock::Unix);
        assert_eq!(log.scans[0].stamp, StampNs(976_052_890_244_111_000));
    }

    #[test]
    fn what_is_no_log_says_so() {
        let error = read("P5\n10 10\n255\n").unwrap_err().to_string();
        assert!(error.contains("3 × another message"), "{error}");
        assert!(read("").unwrap_err().to_string().contains("CARMEN"));
        let degrees = line("1", 1.0).replace(" 0.1 5 ", " 1.0 5 ");
        assert!(matches!(read(&degrees), Err(CarmenError::Lidar(_))));
    }

    #[test]
    fn endless_lines_are_skipped_in_bounded_memory() {
        let mut text = "x".repeat(3 << 20);
        text.push('\n');
        text.push_str(&line("1", 1.0));
        text.push_str(&"1 ".repeat(1 << 20));
        let log = CarmenLog::read(BufReader::new(text.as_bytes())).unwrap();
        assert_eq!(log.scans.len(), 1);
        assert_eq!(log.skipped[&SkipReason::TooLong], 2);
    }

    #[test]
    fn public_logs_are_read_whole() {
        let Ok(data) = std::env::var("MAPSHIFT_DATA") else {
            eprintln!("skipped: MAPSHIFT_DATA is not set");
            return;
        };
        let half_turn = std::f64::consts::FRAC_PI_4;
        let expected = [
            ("intel", 910, 180, Pose2::IDENTITY),
            ("mines1", 756, 682, Pose2::new(0.145, 0.0, 0.0)),
            ("mines2", 641, 682, Pose2::new(0.145, 0.0, 0.0)),
            ("mines3", 525, 682, Pose2::new(0.145, 0.0, 0.0)),
            ("niao20", 608, 224, Pose2::new(0.0933, 0.0933, half_turn)),
            ("niao21", 830, 224, Pose2::new(0.0933, 0.0933, half_turn)),
            ("niao22", 880, 224, Pose2::new(0.0933, 0.0933, half_turn)),
            ("lab15_all_closed", 43, 726, Pose2::IDENTITY),
            ("lab15_all_opened", 93, 726, Pose2::IDENTITY),
            ("lab15_main_opened", 77, 726, Pose2::IDENTITY),
        ];
        for (name, scans, beams, mount) in expected {
            let file = std::fs::File::open(format!("{data}/logs/{name}.log.gz")).unwrap();
            let log = CarmenLog::read(BufReader::new(flate2::read::GzDecoder::new(file))).unwrap();
            eprintln!(
                "{name}: {} scans, {:?}, {:?}, skipped {:?}",
                log.scans.len(),
                log.clock,
                log.lidar,
                log.skipped
            );
            assert_eq!(log.scans.len(), scans, "{name}");
            assert!(log.skipped.is_empty(), "{name}: {:?}", log.skipped);
            assert!(log.scans.iter().all(|s| s.ranges_m.len() == beams));
            let off = mount.between(&log.lidar.mount);
            assert!(
                off.translation().norm() < 0.005 && off.theta.abs() < 1e-3,
                "{name}: {off:?}"
            );
        }
    }
}
