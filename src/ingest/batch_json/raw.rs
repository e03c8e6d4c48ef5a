//! The fields as they are sent, bounded while they are read.

use std::fmt;

use serde::Deserialize;
use serde::de::{Deserializer, IgnoredAny, SeqAccess, Visitor};

use super::uploaded::{BEAMS_TOTAL_MAX, LIDARS_MAX, SCANS_MAX};
use crate::ids::{LidarId, TripId, VehicleId};
use crate::ingest::extensions::Extensions;
use crate::ingest::json::Object;
use crate::ingest::stamp::SentStamp;
use crate::scan::BEAMS_MAX;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Batch {
    pub vehicle_id: VehicleId,
    pub trip_id: TripId,
    pub sequence: u32,
    pub lidar: Option<Object<Lidar>>,
    pub lidars: Option<Lidars>,
    pub initial_pose: Option<Object<InitialPose>>,
    pub extensions: Option<Extensions>,
    pub scans: Scans,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Lidar {
    pub id: Option<LidarId>,
    pub angle_min: f64,
    pub angle_max: Option<f64>,
    pub angle_increment: f64,
    pub range_min: f64,
    pub range_max: f64,
    pub mount: Option<Object<Pose>>,
    pub range_sigma: Option<f64>,
    pub time_increment: Option<f64>,
    pub scan_time: Option<f64>,
    pub band: Option<Object<Band>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Band {
    pub from: f64,
    pub to: f64,
    pub clear_from: Option<f64>,
    pub clear_to: Option<f64>,
}

#[derive(Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
pub(in crate::ingest) struct Pose {
    pub x: f64,
    pub y: f64,
    pub theta: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct InitialPose {
    pub x: f64,
    pub y: f64,
    pub theta: f64,
    pub sigma_xy: Option<f64>,
    pub sigma_theta: Option<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Scan {
    pub stamp: SentStamp,
    pub lidar: Option<LidarId>,
    pub odometry: Object<Pose>,
    pub ranges: Numbers,
    pub intensities: Option<Numbers>,
}

/// The lidars up to the limit of a batch, and how many there were.
pub(super) struct Lidars {
    pub kept: Vec<Lidar>,
    pub count: usize,
}

/// The scans up to the limits of a batch, and how many there were.
pub(super) struct Scans {
    pub kept: Vec<Scan>,
    pub count: usize,
    pub beams: usize,
}

/// A beam's numbers up to the limit of a scan (NaN for null), and how many there were.
pub(super) struct Numbers {
    pub kept: Vec<f64>,
    pub count: usize,
}

impl<'de> Deserialize<'de> for Lidars {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct LidarsVisitor;
        impl<'de> Visitor<'de> for LidarsVisitor {
            type Value = Lidars;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("an array of lidars")
            }
            fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Lidars, A::Error> {
                let mut kept = Vec::new();
                while kept.len() < LIDARS_MAX {
                    let Some(Object(lidar)) = seq.next_element::<Object<Lidar>>()? else {
                        let count = kept.len();
                        return Ok(Lidars { kept, count });
                    };
                    kept.push(lidar);
                }
                let mut count = kept.len();
                while seq.next_element::<IgnoredAny>()?.is_some() {
                    count += 1;
                }
                Ok(Lidars { kept, count })
            }
        }
        deserializer.deserialize_seq(LidarsVisitor)
    }
}

impl<'de> Deserialize<'de> for Scans {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct ScansVisitor;
        impl<'de> Visitor<'de> for ScansVisitor {
            type Value = Scans;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("an array of scans")
            }
            fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Scans, A::Error> {
                let mut scans = Scans {
                    kept: Vec::new(),
                    count: 0,
                    beams: 0,
                };
                while scans.count < SCANS_MAX && scans.beams <= BEAMS_TOTAL_MAX {
                    let Some(Object(scan)) = seq.next_element::<Object<Scan>>()? else {
                        return Ok(scans);
                    };
                    scans.beams += scan.ranges.count;
                    scans.count += 1;
                    scans.kept.push(scan);
                }
                while seq.next_element::<IgnoredAny>()?.is_some() {
                    scans.count += 1;
                }
                Ok(scans)
            }
        }
        deserializer.deserialize_seq(ScansVisitor)
    }
}

impl<'de> Deserialize<'de> for Numbers {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct NumbersVisitor;
        impl<'de> Visitor<'de> for NumbersVisitor {
            type Value = Numbers;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("an array of numbers and nulls")
            }
            fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Numbers, A::Error> {
                let mut kept = Vec::new();
                while kept.len() < BEAMS_MAX {
                    let Some(number) = seq.next_element::<Option<f64>>()? else {
                        let count = kept.len();
                        return Ok(Numbers { kept, count });
                    };
                    kept.push(number.unwrap_or(f64::NAN));
                }
                let mut count = kept.len();
                while seq.next_element::<IgnoredAny>()?.is_some() {
                    count += 1;
                }
                Ok(Numbers { kept, count })
            }
        }
        deserializer.deserialize_seq(NumbersVisitor)
    }
}
