//! Known objects, drawn into real scans.

use std::collections::BTreeMap;
use std::f64::consts::TAU;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::placed::{PlacedScan, placed_scans};
use super::places::{Places, entry_m};
use super::recording::Recording;
use crate::change::ChangeKind;
use crate::geometry::{Pose2, Vector2};
use crate::ids::StampNs;
use crate::sim::{Shape, normal};

/// Extent of an object, metres.
const EXTENT_M: std::ops::Range<f64> = 0.3..0.7;
/// Objects are this far apart from each other, metres.
const APART_M: f64 = 1.0;
/// Within one recording an object's moment lies between these shares of its duration.
const MOMENT_SHARE: std::ops::Range<f64> = 0.25..0.75;
/// An object is at least this far from the lidar that chose its place, metres.
const NEAREST_M: f64 = 0.6;
/// Places that are tried for an object before there are said to be no more.
const TRIES_PER_OBJECT: usize = 4_000;

/// A convex object that appears or disappears at a moment of its own.
#[derive(Debug, Clone, PartialEq)]
pub struct DrawnObject {
    /// Where it stands, map frame of the untouched run, metres.
    pub shape: Shape,
    /// [`ChangeKind::Appeared`] or [`ChangeKind::Disappeared`].
    pub kind: ChangeKind,
    /// The first moment of the new state.
    pub moment: StampNs,
}

impl DrawnObject {
    /// Its middle, map frame, metres.
    pub fn centre(&self) -> Vector2<f64> {
        self.shape.bounding_circle().0
    }

    /// Its corners; of a disc, enough of its circle.
    pub fn outline(&self) -> Vec<Vector2<f64>> {
        match &self.shape {
            Shape::Outline(corners) => corners.clone(),
            Shape::Round { centre, radius_m } => {
                let at = |k: u32| {
                    let (sin, cos) = (TAU * f64::from(k) / 24.0).sin_cos();
                    centre + Vector2::new(cos, sin) * *radius_m
                };
                (0..24).map(at).collect()
            }
        }
    }

    fn stands_at(&self, stamp: StampNs) -> bool {
        (stamp >= self.moment) == (self.kind == ChangeKind::Appeared)
    }
}

/// Chooses up to `count` objects, the same for the same seed.
///
/// `poses` are `map_from_base` of the untouched recordings' scans.
pub(super) fn choose_objects(
    recordings: &[Recording],
    poses: &BTreeMap<StampNs, Pose2>,
    count: usize,
    seed: u64,
) -> Vec<DrawnObject> {
    let scans = placed_scans(recordings, poses);
    if scans.is_empty() {
        return Vec::new();
    }
    let places = Places::of(&scans);
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut objects: Vec<DrawnObject> = Vec::new();
    for _ in 0..TRIES_PER_OBJECT * count {
        if objects.len() == count {
            break;
        }
        let (Some(centre), Some(moment)) =
            (candidate(&scans, &mut rng), moment_of(recordings, &mut rng))
        else {
            continue;
        };
        let shape = random_shape(&centre, &mut rng);
        let (middle, radius_m) = shape.bounding_circle();
        let is_apart = objects.iter().all(|other| {
            let (other_middle, other_radius_m) = other.shape.bounding_circle();
            (middle - other_middle).norm() >= APART_M + radius_m + other_radius_m
        });
        if is_apart && places.is_free(&shape) && places.is_seen(&shape, moment) {
            let kind = match objects.len() % 2 {
                0 => ChangeKind::Appeared,
                _ => ChangeKind::Disappeared,
            };
            objects.push(DrawnObject {
                shape,
                kind,
                moment,
            });
        }
    }
    objects
}

/// A point that a scan looks through.
fn candidate(scans: &[PlacedScan<'_>], rng: &mut ChaCha8Rng) -> Option<Vector2<f64>> {
    let placed = &scans[rng.random_range(0..scans.len())];
    let beam = rng.random_range(0..placed.scan.ranges_m.len());
    let farthest_m = placed.scan.ranges_m[beam]?;
    let share: f64 = rng.random();
    if farthest_m <= NEAREST_M {
        return None;
    }
    let range_m = NEAREST_M + share * (farthest_m - NEAREST_M);
    let angle_rad = placed.lidar.beam_angle_rad(beam);
    let seen = Vector2::new(angle_rad.cos(), angle_rad.sin()) * range_m;
    Some(placed.map_from_lidar.transform(&seen))
}

/// The start of a later recording, or a time within the only one.
fn moment_of(recordings: &[Recording], rng: &mut ChaCha8Rng) -> Option<StampNs> {
    if recordings.len() > 1 {
        let later = rng.random_range(1..recordings.len());
        return recordings[later].scans.first().map(|scan| scan.stamp);
    }
    let scans = &recordings.first()?.scans;
    let (first, last) = (scans.first()?.stamp.0, scans.last()?.stamp.0);
    let share = rng.random_range(MOMENT_SHARE);
    Some(StampNs(first + (share * (last - first) as f64) as i64))
}

fn random_shape(centre: &Vector2<f64>, rng: &mut ChaCha8Rng) -> Shape {
    let extent_m = rng.random_range(EXTENT_M);
    let turn_rad = rng.random_range(0.0..TAU);
    match rng.random_range(0..3) {
        0 => Shape::Round {
            centre: *centre,
            radius_m: 0.5 * extent_m,
        },
        1 => {
            let width_m = rng.random_range(EXTENT_M.start..=extent_m);
            let pose = Pose2::new(centre.x, centre.y, turn_rad);
            Shape::rectangle(&pose, extent_m, width_m)
        }
        _ => {
            let corners = rng.random_range(3..=6);
            let step_rad = TAU / f64::from(corners);
            let corner = |k: i32| {
                let angle_rad = turn_rad + step_rad * (f64::from(k) + rng.random_range(-0.2..0.2));
                centre + Vector2::new(angle_rad.cos(), angle_rad.sin()) * (0.5 * extent_m)
            };
            Shape::Outline((0..corners).map(corner).collect())
        }
    }
}

/// The recordings as they would be with the objects: beams that would pass through one end on it,
/// with the lidar's noise, if that is nearer than what they measured. Scans without a place stay.
pub fn altered(
    recordings: &[Recording],
    poses: &BTreeMap<StampNs, Pose2>,
    objects: &[DrawnObject],
    seed: u64,
) -> Vec<Recording> {
    let mut altered = recordings.to_vec();
    for (recording, copy) in recordings.iter().zip(&mut altered) {
        let scans = placed_scans(std::slice::from_ref(recording), poses);
        let mut scans = scans.iter().peekable();
        for scan in &mut copy.scans {
            if let Some(placed) = scans.next_if(|placed| placed.scan.stamp == scan.stamp) {
                draw_into(&mut scan.ranges_m, placed, objects, seed);
            }
        }
    }
    altered
}

fn draw_into(
    ranges_m: &mut [Option<f64>],
    placed: &PlacedScan<'_>,
    objects: &[DrawnObject],
    seed: u64,
) {
    let stamp = placed.scan.stamp;
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    // Stream 0 chose the objects.
    rng.set_stream(stamp.0.unsigned_abs() | 1);
    for object in objects.iter().filter(|object| object.stands_at(stamp)) {
        let (middle, radius_m) = object.shape.bounding_circle();
        for beam in placed.beams_towards(&middle, radius_m) {
            let Some(entry_m) = entry_m(placed, beam, &object.shape) else {
                continue;
            };
            let range_m = entry_m + normal(&mut rng, placed.lidar.range_sigma_m);
            if ranges_m[beam].is_none_or(|measured_m| range_m < measured_m) {
                ranges_m[beam] = Some(range_m);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::baselines::testing::{posed, room};
    use super::super::places::{CLEAR_M, OUTLINE_CLEAR_M, SEEN_MIN, distance_m};
    use super::*;

    #[test]
    fn objects_shorten_the_beams_through_them_and_no_others() {
        let recordings = room(40, None);
        let poses = posed(&recordings);
        let object = DrawnObject {
            shape: Shape::Round {
                centre: Vector2::new(2.5, 1.5),
                radius_m: 0.25,
            },
            kind: ChangeKind::Appeared,
            moment: recordings[0].scans[20].stamp,
        };
        let drawn = altered(&recordings, &poses, std::slice::from_ref(&object), 7);
        let scans = placed_scans(&recordings, &poses);
        let mut shortened = 0;
        for (k, (placed, now)) in scans.iter().zip(&drawn[0].scans).enumerate() {
            let eye = placed.map_from_lidar.translation();
            for (beam, direction) in placed.directions().enumerate() {
                let (was_m, is_m) = (placed.scan.ranges_m[beam], now.ranges_m[beam]);
                let entry_m = object.shape.distance_along(&eye, &direction);
                match entry_m.filter(|_| k >= 20) {
                    None => assert_eq!(was_m, is_m),
                    Some(entry_m) => {
                        assert!((is_m.unwrap() - entry_m).abs() < 0.06);
                        shortened += 1;
                    }
                }
            }
        }
        assert!(shortened > 100);
        assert_eq!(
            drawn[0].scans,
            altered(&recordings, &poses, &[object], 7)[0].scans
        );
    }

    #[test]
    fn places_are_free_seen_apart_and_the_seed_s() {
        let recordings = room(60, None);
        let poses = posed(&recordings);
        let objects = choose_objects(&recordings, &poses, 4, 3);
        assert_eq!(objects.len(), 4);
        let scans = placed_scans(&recordings, &poses);
        for (k, object) in objects.iter().enumerate() {
            for placed in &scans {
                let is_clear = |hit: Vector2<f64>| {
                    (hit - object.centre()).norm() > CLEAR_M
                        && distance_m(&object.shape, &hit) > OUTLINE_CLEAR_M
                };
                assert!(placed.hits().all(is_clear));
                let base = placed.map_from_base.translation();
                assert!(distance_m(&object.shape, &base) >= 0.35);
            }
            let seen = |since: bool| {
                let of_state =
                    |placed: &&PlacedScan<'_>| (placed.scan.stamp >= object.moment) == since;
                let through = |placed: &&PlacedScan<'_>| {
                    let eye = placed.map_from_lidar.translation();
                    let beams = placed.directions().zip(&placed.scan.ranges_m);
                    let through = beams.filter(|(direction, range_m)| {
                        let entry_m = object.shape.distance_along(&eye, direction);
                        entry_m.is_some_and(|e| range_m.is_some_and(|r| e < r))
                    });
                    through.count() >= 3
                };
                scans.iter().filter(of_state).filter(through).count()
            };
            assert!(seen(false) >= SEEN_MIN && seen(true) >= SEEN_MIN);
            for other in &objects[..k] {
                assert!((object.centre() - other.centre()).norm() >= 1.0);
            }
        }
        let appeared = objects.iter().filter(|o| o.kind == ChangeKind::Appeared);
        assert_eq!(appeared.count(), 2);
        assert_eq!(objects, choose_objects(&recordings, &poses, 4, 3));
        assert_ne!(objects, choose_objects(&recordings, &poses, 4, 4));
    }
}
