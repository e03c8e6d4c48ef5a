//! The second reading: the scans in the order of time, each with the odometry at its stamp.

use std::collections::BTreeMap;
use std::fmt;
use std::io::Read;

use super::container::MessageReader;
use super::decode;
use super::error::McapError;
use super::messages::ScanMessage;
use super::plan::{Plan, PlannedTopic};
use crate::ids::StampNs;
use crate::ingest::recorded::{RecordedLidar, RecordedScan};

/// A scan waits so long for one that was taken before it and recorded after it, nanoseconds.
const WAIT_NS: i64 = 1_000_000_000;
/// Most beams of scans that wait; with more the first of them is given at once.
const WAITING_BEAMS_MAX: usize = 2_000_000;
/// The times that a scan may have: 1970 to 2100, nanoseconds since the Unix epoch.
const STAMPS_NS: std::ops::Range<i64> = 0..4_102_444_800_000_000_000;

/// Why a scan of a recording was not taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum McapSkip {
    /// The message is damaged.
    Unreadable,
    /// It has no beam where its lidar's first scan has some.
    OtherGeometry,
    /// Its time is none.
    NoTime,
    /// The odometry does not say where it was taken.
    NoOdometry,
    /// Its time is not later than that of the scan before.
    NotLater,
}

impl fmt::Display for McapSkip {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Unreadable => "the message cannot be decoded",
            Self::OtherGeometry => "no beam at the angles of the lidar's first scan",
            Self::NoTime => "a stamp that is not between 1970 and 2100",
            Self::NoOdometry => {
                "outside of the odometry's time, or in a gap of it of more than 1 s"
            }
            Self::NotLater => "the time is not later than the scan before",
        })
    }
}

/// Reads the scans of a recording: each with the place of its lidar.
pub struct ScanReader<'a, R> {
    plan: &'a Plan,
    messages: MessageReader<R>,
    /// Scans that wait for earlier ones.
    waiting: BTreeMap<(StampNs, usize), RecordedScan>,
    /// The beams that they have together.
    waiting_beams: usize,
    /// The newest stamp so far.
    newest: StampNs,
    /// The stamp of the scan that was given last.
    given: StampNs,
    is_done: bool,
    skipped: BTreeMap<McapSkip, usize>,
    resampled: usize,
}

/// A scan that is taken.
struct Taken {
    scan: RecordedScan,
    /// Whether it stated other angles than its lidar's first scan.
    is_resampled: bool,
}

impl<'a, R: Read> ScanReader<'a, R> {
    /// A reader of the scans that a plan takes, in a second reading of the same file.
    ///
    /// # Errors
    /// [`McapError`] if it does not begin as an MCAP recording does.
    pub fn new(plan: &'a Plan, reader: R) -> Result<Self, McapError> {
        Ok(Self {
            plan,
            messages: MessageReader::new(reader)?,
            waiting: BTreeMap::new(),
            waiting_beams: 0,
            newest: StampNs(i64::MIN),
            given: StampNs(i64::MIN),
            is_done: false,
            skipped: BTreeMap::new(),
            resampled: 0,
        })
    }

    /// The scans that were not taken so far.
    pub fn skipped(&self) -> &BTreeMap<McapSkip, usize> {
        &self.skipped
    }

    /// How many of the scans so far were put at the angles of their lidar's first one.
    pub fn resampled(&self) -> usize {
        self.resampled
    }

    /// Reads one more scan; says whether there was one.
    fn read_one(&mut self) -> Result<bool, McapError> {
        let topics = &self.plan.topics;
        let place_of = |name: &str| topics.iter().position(|topic| topic.name == name);
        let message = self
            .messages
            .next_message(|channel| place_of(&channel.topic).is_some())?;
        let Some(message) = message else {
            return Ok(false);
        };
        let place = place_of(&message.channel.topic).unwrap_or_default();
        let scan = decode::scan(&message).ok_or(McapSkip::Unreadable);
        let log_time_ns = message.log_time_ns;
        let taken = scan.and_then(|scan| self.plan.take(place, scan, log_time_ns));
        match taken {
            Ok(Taken { scan, is_resampled })
                if scan.stamp > self.given && !self.waiting.contains_key(&(scan.stamp, place)) =>
            {
                self.newest = self.newest.max(scan.stamp);
                self.waiting_beams += scan.ranges_m.len();
                self.resampled += usize::from(is_resampled);
                self.waiting.insert((scan.stamp, place), scan);
            }
            Ok(_) => *self.skipped.entry(McapSkip::NotLater).or_default() += 1,
            Err(reason) => *self.skipped.entry(reason).or_default() += 1,
        }
        Ok(true)
    }
}

impl<R: Read> Iterator for ScanReader<'_, R> {
    type Item = Result<(usize, RecordedScan), McapError>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            let no_more = self.is_done || self.waiting_beams > WAITING_BEAMS_MAX;
            let is_due = |(stamp, _): &(StampNs, usize)| stamp.0 < self.newest.0 - WAIT_NS;
            let first = self.waiting.first_key_value();
            if first.is_some_and(|(key, _)| no_more || is_due(key)) {
                let ((stamp, place), scan) = self.waiting.pop_first()?;
                self.waiting_beams -= scan.ranges_m.len();
                self.given = stamp;
                return Some(Ok((place, scan)));
            }
            if self.is_done {
                return None;
            }
            match self.read_one() {
                Ok(there_was) => self.is_done = !there_was,
                Err(error) => {
                    self.is_done = true;
                    self.waiting.clear();
                    return Some(Err(error));
                }
            }
        }
    }
}

impl Plan {
    /// A scan of the lidar at a place.
    fn take(&self, place: usize, scan: ScanMessage, log_time_ns: i64) -> Result<Taken, McapSkip> {
        let (lidar, topic) = (&self.lidars[place], &self.topics[place]);
        let stamp_ns = match scan.stamp_ns {
            0 => log_time_ns,
            stamp_ns => stamp_ns,
        };
        let stamp = StampNs(stamp_ns);
        if !STAMPS_NS.contains(&stamp.0) {
            return Err(McapSkip::NoTime);
        }
        let odom_from_base = self.track.at(stamp_ns).ok_or(McapSkip::NoOdometry)?;
        let is_resampled = !topic.is_alike(lidar.beams, &scan);
        let stated_m = match is_resampled {
            true => topic.resampled(lidar.beams, &scan)?,
            false => scan.ranges_m,
        };
        let readings = stated_m.iter().map(|range_m| reading(*range_m, lidar));
        let mut ranges_m: Vec<Option<f64>> = readings.collect();
        if topic.is_reversed {
            ranges_m.reverse();
        }
        let scan = RecordedScan {
            stamp,
            odom_from_base,
            ranges_m,
        };
        Ok(Taken { scan, is_resampled })
    }
}

impl PlannedTopic {
    /// The angle of a beam as the first scan states it.
    fn angle_rad(&self, beam: usize) -> f64 {
        self.angle_min_rad + beam as f64 * self.angle_increment_rad
    }

    /// Whether each beam of a scan is nearest to the same beam of the first one.
    fn is_alike(&self, beams: usize, scan: &ScanMessage) -> bool {
        let half_beam_rad = 0.5 * self.angle_increment_rad.abs();
        let last = beams.saturating_sub(1);
        let last_rad = scan.angle_min_rad + last as f64 * scan.angle_increment_rad;
        scan.ranges_m.len() == beams
            && (scan.angle_min_rad - self.angle_min_rad).abs() < half_beam_rad
            && (last_rad - self.angle_rad(last)).abs() < half_beam_rad
    }

    /// What a scan of other angles says at those of the first one: the nearest beam, not a number where
    /// there is none. Some lidars turn unsteadily, and have a beam more or less in every scan.
    ///
    /// # Errors
    /// [`McapSkip::OtherGeometry`] if there is none anywhere.
    fn resampled(&self, beams: usize, scan: &ScanMessage) -> Result<Vec<f64>, McapSkip> {
        let nearest = |beam: usize| {
            let off_rad = self.angle_rad(beam) - scan.angle_min_rad;
            let place = (off_rad / scan.angle_increment_rad).round();
            let is_there = (0.0..scan.ranges_m.len() as f64).contains(&place);
            is_there.then(|| scan.ranges_m[place as usize])
        };
        let found: Vec<Option<f64>> = (0..beams).map(nearest).collect();
        match found.iter().any(Option::is_some) {
            true => Ok(found.into_iter().map(|m| m.unwrap_or(f64::NAN)).collect()),
            false => Err(McapSkip::OtherGeometry),
        }
    }
}

/// A reading as it is sent: beyond the largest range and infinity are no return, `None`; below the least
/// range, negative ones and what is not a number are invalid, 0 (REP-117). Rounded to 0.1 mm.
fn reading(range_m: f64, lidar: &RecordedLidar) -> Option<f64> {
    let geometry = &lidar.geometry;
    if range_m > geometry.range_max_m {
        return None;
    }
    let is_measured = range_m >= geometry.range_min_m;
    Some(if is_measured {
        (range_m * 1e4).round() / 1e4
    } else {
        0.0
    })
}
