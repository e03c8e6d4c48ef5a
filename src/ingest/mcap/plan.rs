//! What is taken of a recording: which lidars, with which odometry, and where each is mounted.

use super::error::McapError;
use super::messages::from_above;
use super::odometry::Track;
use super::survey::{FoundLidar, Survey};
use crate::geometry::Pose2;
use crate::ids::LidarId;
use crate::ingest::batch_json::LIDARS_MAX;
use crate::ingest::recorded::{RELATIVE_TIMES_NOTE, RecordedLidar};
use crate::scan::{LaserScan, Lidar, NO_RETURN_TICK, RANGE_SIGMA_DEFAULT_M};

/// Times before 1973 are no times of day but seconds of a simulation, nanoseconds.
const RELATIVE_TIME_MAX_NS: i64 = 100_000_000_000_000_000;
/// A reading of 0 is none, also of a lidar that states no least range, metres.
const RANGE_MIN_LEAST_M: f64 = 0.001;
/// A lidar whose axis is farther from the vertical than this cosine says has no scans of a plane.
const UPRIGHT_COSINE_MIN: f64 = 0.5;
/// A sweep takes no longer than this, seconds …
const SWEEP_MAX_S: f64 = 2.0;
/// … and no longer than the stated time between scans, with this for rounding.
const SWEEP_SLACK: f64 = 1.05;

/// What somebody wants of a recording with several topics, or without transforms.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct TopicChoice {
    /// Topics of the lidars, the one that takes keyframes first; all if there are none.
    pub lidars: Vec<String>,
    /// Topic of the odometry; may be one of transforms.
    pub odometry: Option<String>,
    /// Where the lidar is mounted, in place of what the recording says.
    pub mount: MountOverride,
}

/// What is known better than the recording of `base_from_lidar`.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct MountOverride {
    /// Metres.
    pub x: Option<f64>,
    /// Metres.
    pub y: Option<f64>,
    /// Radians.
    pub theta: Option<f64>,
}

/// What is taken of a recording.
#[derive(Debug)]
pub struct Plan {
    /// The lidars; the first takes keyframes.
    pub lidars: Vec<RecordedLidar>,
    /// What was decided and assumed, for people.
    pub notes: Vec<String>,
    /// Of each lidar its topic and its direction.
    pub(super) topics: Vec<PlannedTopic>,
    pub(super) track: Track,
}

/// How the scans of a topic are read.
#[derive(Debug)]
pub(super) struct PlannedTopic {
    pub name: String,
    /// The geometry that its first scan states.
    pub angle_min_rad: f64,
    pub angle_increment_rad: f64,
    /// Whether the last beam is the first one counter-clockwise.
    pub is_reversed: bool,
}

/// An odometry and the frame of the vehicle that it names.
struct ChosenOdometry {
    what: String,
    base_frame: Option<String>,
    track: Track,
}

impl Plan {
    /// Decides what is taken of a recording.
    ///
    /// # Errors
    /// [`McapError`] with the topics that there are, or with what is missing.
    pub fn of(survey: &Survey, choice: &TopicChoice) -> Result<Self, McapError> {
        let lidars = chosen_lidars(survey, choice)?;
        let (_, first) = lidars[0];
        let odometry = chosen_odometry(survey, choice, &first.first.frame_id)?;
        if choice.mount != MountOverride::default() && lidars.len() > 1 {
            let detail =
                "a mount is stated, but there are several lidars: choose one of them as the topic";
            return Err(survey.refusal(detail.into()));
        }
        let stamp_ns = match first.first.stamp_ns {
            0 => first.log_time_ns,
            stamp_ns => stamp_ns,
        };
        let mut plan = Self {
            lidars: Vec::new(),
            notes: vec![format!("odometry from {}", odometry.what)],
            topics: Vec::new(),
            track: odometry.track,
        };
        if stamp_ns < RELATIVE_TIME_MAX_NS {
            plan.notes.push(RELATIVE_TIMES_NOTE.into());
        }
        if let Some(offset) = survey.cut_at {
            plan.notes.push(format!(
                "it ends within the record at byte {offset}, as after a loss of power: read as far as it goes"
            ));
        }
        for (topic, found) in &lidars {
            let name = (lidars.len() > 1).then(|| lidar_name(topic)).transpose()?;
            plan.add(
                survey,
                topic,
                found,
                name,
                odometry.base_frame.as_deref(),
                &choice.mount,
            )?;
        }
        plan.check_names(survey)?;
        Ok(plan)
    }

    fn add(
        &mut self,
        survey: &Survey,
        topic: &str,
        found: &FoundLidar,
        name: Option<LidarId>,
        named_base: Option<&str>,
        mount: &MountOverride,
    ) -> Result<(), McapError> {
        let placed = Placed::of(survey, topic, found, named_base, mount)?;
        self.notes.extend(placed.note);
        let scan = &found.first;
        let (start_rad, increment_rad) = match placed.is_upside_down {
            true => (-scan.angle_min_rad, -scan.angle_increment_rad),
            false => (scan.angle_min_rad, scan.angle_increment_rad),
        };
        let is_reversed = increment_rad < 0.0;
        let range_max_m = scan.range_max_m.unwrap_or_else(|| {
            self.notes.push(format!(
                "{topic} states no largest range: taken as the longest measured"
            ));
            (found.longest_m * 10.0).ceil() / 10.0 + 0.1
        });
        let geometry = Lidar {
            angle_min_rad: start_rad,
            angle_increment_rad: increment_rad.abs(),
            range_min_m: scan.range_min_m.max(RANGE_MIN_LEAST_M),
            range_max_m,
            mount: placed.mount,
            range_sigma_m: RANGE_SIGMA_DEFAULT_M,
            band: None,
        };
        let geometry = match is_reversed {
            true => geometry.counter_clockwise(found.beams),
            false => geometry,
        };
        let geometry = geometry.validated().map_err(|source| McapError::Lidar {
            topic: topic.to_owned(),
            source,
        })?;
        let no_returns = vec![NO_RETURN_TICK; found.beams];
        LaserScan::from_ticks(geometry.clone().into(), no_returns).map_err(|source| {
            McapError::Scan {
                topic: topic.to_owned(),
                source,
            }
        })?;
        let has_times = has_times(found) && !is_reversed;
        if is_reversed {
            self.notes.push(format!(
                "the beams of {topic} run clockwise: they are put in order, and the vehicle's motion during a scan is not taken out"
            ));
        }
        self.lidars.push(RecordedLidar {
            name,
            geometry,
            beams: found.beams,
            time_increment_s: if has_times {
                scan.time_increment_s
            } else {
                0.0
            },
            scan_time_s: if has_times { scan.scan_time_s } else { 0.0 },
        });
        self.topics.push(PlannedTopic {
            name: topic.to_owned(),
            angle_min_rad: scan.angle_min_rad,
            angle_increment_rad: scan.angle_increment_rad,
            is_reversed,
        });
        Ok(())
    }

    fn check_names(&self, survey: &Survey) -> Result<(), McapError> {
        let mut names: Vec<_> = self
            .lidars
            .iter()
            .filter_map(|lidar| lidar.name.as_ref())
            .collect();
        names.sort();
        match names.windows(2).find(|pair| pair[0] == pair[1]) {
            None => Ok(()),
            Some(pair) => {
                let detail = format!(
                    "two of the lidars' topics give the name {}: choose others",
                    pair[0]
                );
                Err(survey.refusal(detail))
            }
        }
    }
}

/// Where a lidar is mounted.
struct Placed {
    mount: Pose2,
    is_upside_down: bool,
    note: Option<String>,
}

impl Placed {
    fn of(
        survey: &Survey,
        topic: &str,
        found: &FoundLidar,
        named_base: Option<&str>,
        stated: &MountOverride,
    ) -> Result<Self, McapError> {
        let frame = &found.first.frame_id;
        let on_vehicle = survey.transforms.on_vehicle(frame, named_base);
        let mount_error = |detail: String| McapError::Mount {
            topic: topic.to_owned(),
            detail,
        };
        if on_vehicle.is_none() && *stated == MountOverride::default() {
            let base = named_base.unwrap_or("base_link");
            return Err(mount_error(format!(
                "no transforms lead from its frame {frame} to {base}; record /tf_static too, or state where it is mounted with mount_x, mount_y and mount_theta"
            )));
        }
        let (base, transform) = match on_vehicle {
            Some(on) => (on.base, on.base_from_frame * found.first.frame_from_origin),
            None => ("the vehicle".into(), nalgebra::Isometry3::identity()),
        };
        let up = (transform.rotation * nalgebra::Vector3::z()).z;
        if up.abs() < UPRIGHT_COSINE_MIN {
            return Err(mount_error(format!(
                "by the transforms from {base} to {frame} it does not scan level"
            )));
        }
        let seen = from_above(&transform);
        // A quaternion's noise is no part of a mount.
        let rounded = |value: f64| (value * 1e6).round() / 1e6;
        let mount = Pose2::new(
            stated.x.unwrap_or(rounded(seen.x)),
            stated.y.unwrap_or(rounded(seen.y)),
            stated.theta.unwrap_or(rounded(seen.theta)),
        );
        let is_upside_down = up < 0.0;
        let note = is_upside_down
            .then(|| format!("the lidar of {topic} hangs upside down: its scans are mirrored"));
        Ok(Self {
            mount,
            is_upside_down,
            note,
        })
    }
}

fn chosen_lidars<'a>(
    survey: &'a Survey,
    choice: &'a TopicChoice,
) -> Result<Vec<(&'a str, &'a FoundLidar)>, McapError> {
    let mut lidars: Vec<(&str, &FoundLidar)> = Vec::new();
    for topic in &choice.lidars {
        let Some(found) = survey.scans.get(topic) else {
            return Err(survey.refusal(format!("no scans can be read from the topic {topic}")));
        };
        if !lidars.iter().any(|(name, _)| name == topic) {
            lidars.push((topic, found));
        }
    }
    if lidars.is_empty() {
        lidars = survey
            .scans
            .iter()
            .map(|(name, found)| (name.as_str(), found))
            .collect();
    }
    match lidars.len() {
        0 => Err(survey.refusal(
            "no topic has scans of a 2D lidar (sensor_msgs/msg/LaserScan, foxglove.LaserScan)"
                .into(),
        )),
        1..=LIDARS_MAX => Ok(lidars),
        count => Err(survey.refusal(format!(
            "a vehicle has at most {LIDARS_MAX} lidars, this one {count}: choose topics"
        ))),
    }
}

fn chosen_odometry(
    survey: &Survey,
    choice: &TopicChoice,
    frame: &str,
) -> Result<ChosenOdometry, McapError> {
    let of_topic = |topic: &String| {
        let found = survey
            .odometry
            .get(topic)
            .filter(|found| !found.track.is_empty())?;
        Some(ChosenOdometry {
            what: topic.clone(),
            base_frame: found.base_frame.clone(),
            track: found.track.clone(),
        })
    };
    let of_transforms = || {
        let (base, mut track) = survey.transforms.odometry_of(frame)?;
        track.sort();
        Some(ChosenOdometry {
            what: format!("the transforms from odom to {base}"),
            base_frame: Some(base),
            track,
        })
    };
    let topics: Vec<&String> = survey.odometry.keys().collect();
    let found = match (&choice.odometry, topics.as_slice()) {
        (Some(topic), _) if survey.has_transforms(topic) => of_transforms(),
        (Some(topic), _) => of_topic(topic),
        (None, [topic]) => of_topic(topic).or_else(of_transforms),
        (None, []) => of_transforms(),
        (None, _) => {
            let detail = "several topics have odometry: choose one of them as the odometry topic";
            return Err(survey.refusal(detail.into()));
        }
    };
    found.ok_or_else(|| {
        survey.refusal(match &choice.odometry {
            Some(topic) => format!("no odometry can be read from the topic {topic}"),
            None => "there is no odometry: neither nav_msgs/msg/Odometry nor transforms from odom to the vehicle".into(),
        })
    })
}

/// Whether the times of beams that a lidar states can be right.
fn has_times(found: &FoundLidar) -> bool {
    let scan = &found.first;
    let sweep_s = scan.time_increment_s * found.beams.saturating_sub(1) as f64;
    let longest_s = match scan.scan_time_s > 0.0 {
        true => SWEEP_SLACK * scan.scan_time_s,
        false => SWEEP_MAX_S,
    };
    let is_scan_time = (0.0..=SWEEP_MAX_S).contains(&scan.scan_time_s);
    is_scan_time && scan.time_increment_s > 0.0 && sweep_s <= longest_s
}

/// A lidar's name: its topic without the `scan` at its end.
fn lidar_name(topic: &str) -> Result<LidarId, McapError> {
    let parts = topic.split('/').filter(|part| !part.is_empty());
    let mut parts: Vec<&str> = parts.collect();
    if parts.len() > 1 && parts.last().is_some_and(|last| *last == "scan") {
        parts.pop();
    }
    LidarId::new(parts.join("-")).map_err(|error| McapError::Topics {
        detail: format!("the topic {topic} gives no name for its lidar"),
        topics: error.to_string(),
    })
}
