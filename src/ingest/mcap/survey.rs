//! The first reading: which topics there are, the transforms, the odometry, and each lidar's geometry.

use std::collections::BTreeMap;
use std::io::Read;

use super::container::{Message, MessageReader, NAME_BYTES_MAX};
use super::decode;
use super::error::McapError;
use super::messages::{Content, ScanMessage, content_of};
use super::odometry::Track;
use super::transforms::Transforms;
use crate::scan::BEAMS_MAX;

/// Most poses of odometry that are kept, of all topics together: some hours of two at 100 Hz.
const POSES_MAX: usize = 2_000_000;
/// Most topics that are named to people.
const TOPICS_NAMED: usize = 40;

/// What was found in a recording.
#[derive(Debug, Default)]
pub struct Survey {
    topics: BTreeMap<String, Topic>,
    pub(super) scans: BTreeMap<String, FoundLidar>,
    pub(super) odometry: BTreeMap<String, FoundOdometry>,
    pub(super) transforms: Transforms,
    pub(super) cut_at: Option<u64>,
}

/// A topic, for people.
#[derive(Debug)]
struct Topic {
    schema: String,
    encoding: String,
    messages: usize,
    content: Option<Content>,
}

/// A lidar's topic.
#[derive(Debug)]
pub(super) struct FoundLidar {
    /// Its first scan, without ranges.
    pub first: ScanMessage,
    pub beams: usize,
    /// When its first scan was recorded.
    pub log_time_ns: i64,
    /// The longest range that is one, metres.
    pub longest_m: f64,
}

/// An odometry topic.
#[derive(Debug, Default)]
pub(super) struct FoundOdometry {
    /// The vehicle's frame, if it was named.
    pub base_frame: Option<String>,
    pub track: Track,
}

impl Survey {
    /// Reads a recording for the first time.
    ///
    /// # Errors
    /// [`McapError`] if it cannot be read to its end.
    pub fn of(reader: impl Read) -> Result<Self, McapError> {
        let mut messages = MessageReader::new(reader)?;
        let (mut survey, mut poses) = (Self::default(), 0);
        while let Some(message) = messages.next_message(|_| true)? {
            let channel = message.channel;
            let content = content_of(channel);
            match survey.topics.get_mut(&channel.topic) {
                Some(topic) => topic.messages += 1,
                None => {
                    let topic = Topic {
                        schema: channel.schema.clone(),
                        encoding: channel.encoding.clone(),
                        messages: 1,
                        content,
                    };
                    survey.topics.insert(channel.topic.clone(), topic);
                }
            }
            let at_ns = message.log_time_ns;
            match content {
                Some(Content::Scans) => {
                    if let Some(scan) = decode::scan(&message) {
                        survey.take_scan(&channel.topic, scan, at_ns);
                    }
                }
                Some(Content::Odometry) => {
                    poses += usize::from(survey.take_odometry(&channel.topic, &message));
                }
                Some(Content::Transforms) => {
                    for transform in decode::transforms(&message) {
                        poses += usize::from(survey.transforms.add(transform, at_ns));
                    }
                }
                None => {}
            }
            if poses > POSES_MAX {
                return Err(McapError::TooMuchOdometry(POSES_MAX));
            }
        }
        survey
            .odometry
            .values_mut()
            .for_each(|found| found.track.sort());
        survey.cut_at = messages.cut_at();
        Ok(survey)
    }

    fn take_scan(&mut self, topic: &str, mut scan: ScanMessage, log_time_ns: i64) {
        let ranges_m = std::mem::take(&mut scan.ranges_m);
        let beams = ranges_m.len();
        if !(1..=BEAMS_MAX).contains(&beams) || scan.frame_id.len() > NAME_BYTES_MAX {
            return;
        }
        let measured = ranges_m.into_iter().filter(|range_m| range_m.is_finite());
        let longest_m = measured.fold(0.0, f64::max);
        let found = self.scans.entry(topic.to_owned());
        let found = found.or_insert(FoundLidar {
            first: scan,
            beams,
            log_time_ns,
            longest_m,
        });
        found.longest_m = found.longest_m.max(longest_m);
    }

    /// Says whether it is one more pose.
    fn take_odometry(&mut self, topic: &str, message: &Message<'_>) -> bool {
        let Some(odometry) = decode::odometry(message) else {
            return false;
        };
        let named = odometry.base_frame;
        let named = named.filter(|frame| frame.len() <= NAME_BYTES_MAX);
        let found = self.odometry.entry(topic.to_owned()).or_default();
        found.base_frame = found.base_frame.take().or(named);
        let stamp_ns = match odometry.stamp_ns {
            0 => message.log_time_ns,
            stamp_ns => stamp_ns,
        };
        found.track.push(stamp_ns, odometry.odom_from_base);
        true
    }

    /// Whether a topic carries transforms.
    pub(super) fn has_transforms(&self, topic: &str) -> bool {
        let topic = self.topics.get(topic);
        topic.is_some_and(|topic| topic.content == Some(Content::Transforms))
    }

    /// The topics that there are, with types and counts.
    pub(super) fn topics_text(&self) -> String {
        if self.topics.is_empty() {
            return "the recording has no messages".into();
        }
        let topics = self.topics.iter().take(TOPICS_NAMED);
        let topics = topics.map(|(name, topic)| {
            let (schema, encoding) = (&topic.schema, &topic.encoding);
            format!("{name} ({schema}, {encoding}: {} messages)", topic.messages)
        });
        let topics: Vec<String> = topics.collect();
        let more = match self.topics.len() - topics.len() {
            0 => String::new(),
            more => format!(" and {more} more"),
        };
        format!("the recording has {}{more}", topics.join(", "))
    }

    /// That the choice of topics does not fit the recording.
    pub(super) fn refusal(&self, detail: String) -> McapError {
        let topics = self.topics_text();
        McapError::Topics { detail, topics }
    }
}
