//! The observations in the screen, by the position of the lidar.

use std::collections::BTreeMap;

use super::counted_cell::PassKey;
use crate::change::pass::Standpoint;
use crate::geometry::{Pose2, Vector2};
use crate::ids::{NodeId, StampNs, TripId};
use crate::observation::Observation;
use crate::scan::LaserScan;

/// Observations of a trip within this time are counted together, nanoseconds: much less than a pass may last,
/// so that a change during a pass shows.
const SPAN_NS: i64 = 30_000_000_000;
/// Observations are found by tiles of this width, metres.
const TILE_M: f64 = 4.0;
/// Poses are rounded to multiples of these, metres and radians, so that a solve that moves them slightly
/// changes nothing.
const POSE_STEP_M: f64 = 0.03;
const POSE_STEP_RAD: f64 = 0.005;

/// A keyframe's own scan (0), or its first, second … intermediate scan.
pub type ObservationKey = (NodeId, u32);

/// An observation to be screened.
pub struct Screened<'a> {
    /// Its key.
    pub key: ObservationKey,
    /// Its trip.
    pub trip: &'a TripId,
    /// Time of the scan.
    pub stamp: StampNs,
    /// Pose of the base, map frame.
    pub map_from_base: Pose2,
    /// The ranges.
    pub scan: &'a LaserScan,
}

/// An observation in the screen.
pub struct Recorded {
    /// Its key.
    pub key: ObservationKey,
    /// Its pass.
    pub pass: PassKey,
    /// Time of the scan.
    pub stamp: StampNs,
    /// The scan at its rounded pose.
    pub observation: Observation,
}

impl Recorded {
    /// Rounds the pose of an observation.
    pub fn of(screened: &Screened<'_>) -> Self {
        let pose = pose_of(&steps_of(&screened.map_from_base));
        Self {
            key: screened.key,
            pass: PassKey {
                span: screened.stamp.0.div_euclid(SPAN_NS),
                trip: hash_of(screened.trip),
            },
            stamp: screened.stamp,
            observation: Observation::new(screened.scan, &pose),
        }
    }

    /// When, by which trip and from where.
    pub fn standpoint(&self) -> Standpoint {
        Standpoint {
            trip: self.pass.trip as usize,
            stamp: self.stamp,
            eye: self.observation.eye(),
        }
    }
}

/// A pose in whole steps.
type PoseSteps = [i64; 3];
type TileKey = (i32, i32);

struct Place {
    pose: PoseSteps,
    tile: TileKey,
}

/// All observations in the screen.
#[derive(Default)]
pub struct RecordedObservations {
    places: BTreeMap<ObservationKey, Place>,
    /// In no order.
    tiles: BTreeMap<TileKey, Vec<Recorded>>,
}

impl RecordedObservations {
    /// Whether it contains an observation at its present pose.
    pub fn holds(&self, screened: &Screened<'_>) -> bool {
        let place = self.places.get(&screened.key);
        place.is_some_and(|place| place.pose == steps_of(&screened.map_from_base))
    }

    /// Its key.
    pub fn keys(&self) -> impl Iterator<Item = ObservationKey> {
        self.places.keys().copied()
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.places.len()
    }

    /// Adds one.
    pub fn insert(&mut self, map_from_base: &Pose2, recorded: Recorded) {
        let tile = tile_of(&recorded.observation.eye());
        let pose = steps_of(map_from_base);
        self.places.insert(recorded.key, Place { pose, tile });
        self.tiles.entry(tile).or_default().push(recorded);
    }

    /// Removes one.
    pub fn take(&mut self, key: &ObservationKey) -> Option<Recorded> {
        let tile = self.places.remove(key)?.tile;
        let there = self.tiles.get_mut(&tile)?;
        let at = there.iter().position(|recorded| recorded.key == *key)?;
        let recorded = there.swap_remove(at);
        if there.is_empty() {
            self.tiles.remove(&tile);
        }
        Some(recorded)
    }

    /// One of them.
    pub fn get(&self, key: &ObservationKey) -> Option<&Recorded> {
        let there = self.tiles.get(&self.places.get(key)?.tile)?;
        there.iter().find(|recorded| recorded.key == *key)
    }

    /// Those whose lidar was in a box or near it, ascending by tiles; corners in the map frame,
    /// metres.
    pub fn between(
        &self,
        low: &Vector2<f64>,
        high: &Vector2<f64>,
    ) -> impl Iterator<Item = &Recorded> + use<'_> {
        let (low, high) = (tile_of(low), tile_of(high));
        let columns = low.0..=high.0;
        let tiles = columns.flat_map(move |x| self.tiles.range((x, low.1)..=(x, high.1)));
        tiles.flat_map(|(_, there)| there)
    }
}

fn tile_of(eye: &Vector2<f64>) -> TileKey {
    let tile = |v: f64| (v / TILE_M).floor() as i32;
    (tile(eye.x), tile(eye.y))
}

fn steps_of(pose: &Pose2) -> PoseSteps {
    let steps = |v: f64, step: f64| (v / step).round() as i64;
    [
        steps(pose.x, POSE_STEP_M),
        steps(pose.y, POSE_STEP_M),
        steps(pose.theta, POSE_STEP_RAD),
    ]
}

fn pose_of(steps: &PoseSteps) -> Pose2 {
    let [x, y, theta] = steps.map(|steps| steps as f64);
    Pose2::new(x * POSE_STEP_M, y * POSE_STEP_M, theta * POSE_STEP_RAD)
}

/// FNV-1a: the same in every run, for any order of trips.
fn hash_of(trip: &TripId) -> u32 {
    let mix = |sum: u32, byte: u8| (sum ^ u32::from(byte)).wrapping_mul(0x0100_0193);
    trip.as_str().bytes().fold(0x811c_9dc5, mix)
}
