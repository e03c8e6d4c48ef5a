//! The partner policy in rooms where every share is known.

use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::geometry::Vector2;
use crate::ids::{NodeId, StampNs, TripId};
use crate::scan::{LaserScan, Lidar};
use crate::sim::{Shape, World};
use std::sync::Arc;

/// A room of 8 m × 6 m round the origin, and one beside it.
fn two_rooms() -> World {
    World::new([0.0, 20.0].map(|x| Shape::rectangle(&Pose2::new(x, 0.0, 0.0), 8.0, 6.0)))
}

fn keyframe(node: i64, pose: &Pose2, range_max_m: f64) -> Keyframe {
    let lidar = Arc::new(Lidar {
        angle_min_rad: -std::f64::consts::PI,
        angle_increment_rad: std::f64::consts::TAU / 360.0,
        range_min_m: 0.05,
        range_max_m,
        mount: Pose2::IDENTITY,
        range_sigma_m: 0.01,
        band: None,
    });
    let world = two_rooms();
    let ranges = (0..360).map(|beam| {
        let (sin, cos) = (pose.theta + lidar.beam_angle_rad(beam)).sin_cos();
        let hit = world.cast(&pose.translation(), &Vector2::new(cos, sin));
        hit.map(|hit| hit.range_m)
    });
    let ranges: Vec<_> = ranges.collect();
    let scan = LaserScan::new(lidar, ranges).unwrap();
    let trip = TripId::new("trip").unwrap();
    Keyframe::new(NodeId(node), trip, StampNs(node), Pose2::IDENTITY, scan)
}

/// The ids of the partners of a view from the origin among views (node, x, y, range).
fn chosen(candidates: &[(i64, f64, f64, f64)]) -> Vec<i64> {
    partners_by(candidates, choose)
}

fn partners_by(
    candidates: &[(i64, f64, f64, f64)],
    policy: for<'a> fn(&Placed<'a>, &[Placed<'a>]) -> Vec<Placed<'a>>,
) -> Vec<i64> {
    let keyframes: Vec<(Pose2, Keyframe)> = candidates
        .iter()
        .map(|&(node, x, y, range_max_m)| {
            let pose = Pose2::new(x, y, 0.1 * x);
            (pose, keyframe(node, &pose, range_max_m))
        })
        .collect();
    let placed: Vec<Placed<'_>> = keyframes
        .iter()
        .map(|(pose, keyframe)| Placed {
            pose: *pose,
            keyframe,
        })
        .collect();
    let new = keyframe(1_000, &Pose2::IDENTITY, 20.0);
    let new = Placed {
        pose: Pose2::IDENTITY,
        keyframe: &new,
    };
    let partners = policy(&new, &placed);
    partners.iter().map(|p| p.keyframe.node.0).collect()
}

#[test]
fn of_equal_views_the_oldest_come_first_and_three_are_enough() {
    let views = [
        (9, 0.0, 0.0, 20.0),
        (4, 1.0, 0.0, 20.0),
        (7, -1.0, 0.0, 20.0),
        (2, 0.0, 1.0, 20.0),
        (5, 0.0, -1.0, 20.0),
    ];
    assert_eq!(chosen(&views), [2, 4, 5]);
    let reversed: Vec<_> = views.into_iter().rev().collect();
    assert_eq!(chosen(&reversed), [2, 4, 5], "whatever the order");
    assert_eq!(chosen(&views[..2]), [4, 9]);
    assert!(chosen(&[]).is_empty());
}

#[test]
fn partners_are_a_distance_apart() {
    let views = [
        (1, 0.0, 0.0, 20.0),
        (2, 0.79, 0.0, 20.0),
        (3, 0.81, 0.0, 20.0),
        (4, 0.0, 0.5, 20.0),
    ];
    assert_eq!(chosen(&views), [1, 3]);
}

#[test]
fn a_wider_view_goes_before_an_older_one() {
    // 4.2 m reach the near parts of the walls alone: about 0.7 of what the new view shows.
    let views = [
        (1, 0.0, 0.0, 4.2),
        (5, 1.0, 0.0, 20.0),
        (6, -1.0, 0.0, 20.0),
    ];
    assert_eq!(chosen(&views), [5, 6, 1]);
}

#[test]
fn a_view_of_too_little_or_of_another_room_is_no_partner() {
    assert!(chosen(&[(1, 0.0, 0.0, 3.1)]).is_empty());
    assert!(chosen(&[(1, 20.0, 0.0, 20.0)]).is_empty());
    assert_eq!(chosen(&[(1, 20.0, 0.0, 20.0), (2, 0.5, 0.0, 20.0)]), [2]);
}

#[test]
fn shares_are_as_by_geometry() {
    let share = |range_max_m: f64| {
        let (new, old) = (
            keyframe(2, &Pose2::IDENTITY, 20.0),
            keyframe(1, &Pose2::IDENTITY, range_max_m),
        );
        let placed = |keyframe| Placed {
            pose: Pose2::IDENTITY,
            keyframe,
        };
        reach_share(&placed(&new), &placed(&old))
    };
    assert_eq!(share(20.0), 1.0);
    // Beams shorter than r: those steeper than asin(3/r), and those flatter than acos(4/r).
    let steep = 1.0 - (3.0_f64 / 4.2).asin() / std::f64::consts::FRAC_PI_2;
    let flat = (4.0_f64 / 4.2).acos() / std::f64::consts::FRAC_PI_2;
    assert!((share(4.2) - steep - flat).abs() < 0.05, "{}", share(4.2));
}

proptest! {
    #[test]
    fn what_is_covered_is_found_by_its_square(
        references in proptest::collection::vec(any_pose(), 0..30),
        pose in any_pose(),
    ) {
        let mut covering = Covering::default();
        references.iter().for_each(|reference| covering.insert(*reference));
        prop_assert_eq!(covering.covers(&pose), is_covered(&pose, references.into_iter()));
    }
}

fn any_pose() -> impl Strategy<Value = Pose2> {
    (-1.0..1.0_f64, -1.0..1.0_f64, -4.0..4.0_f64).prop_map(|(x, y, theta)| Pose2::new(x, y, theta))
}

#[test]
fn a_place_is_covered_by_a_near_reference_with_about_its_heading() {
    use std::f64::consts::PI;
    let reference = Pose2::new(1.0, 2.0, PI - 0.1);
    let covered = |pose: Pose2| is_covered(&pose, [Pose2::IDENTITY, reference].into_iter());
    assert!(covered(reference));
    assert!(covered(Pose2::new(1.29, 2.0, reference.theta)));
    assert!(!covered(Pose2::new(1.31, 2.0, reference.theta)));
    assert!(covered(Pose2::new(1.0, 2.0, -PI + 0.1)), "across the seam");
    assert!(!covered(Pose2::new(1.0, 2.0, -PI + 0.31)));
    assert!(!is_covered(&reference, std::iter::empty()));
}

#[test]
fn the_paper_s_partner_is_the_nearest_that_shows_the_view() {
    let nearest_of = |candidates: &[(i64, f64, f64, f64)]| {
        partners_by(candidates, |new, all| Vec::from_iter(nearest(new, all)))
    };
    let views = [
        (1, 1.0, 0.0, 20.0),
        (2, 0.4, 0.1, 20.0),
        (3, 0.6, 0.0, 20.0),
    ];
    assert_eq!(nearest_of(&views), [2]);
    // A short-sighted one is nearer and shows too little.
    assert_eq!(nearest_of(&[(1, 0.1, 0.0, 1.0), (2, 0.5, 0.0, 20.0)]), [2]);
    assert!(nearest_of(&[(1, 1.6, 0.0, 20.0)]).is_empty());
    assert!(nearest_of(&[]).is_empty());
}

/// Laps that stray for ever make no more references than there is room for, and most of them early.
#[test]
fn references_saturate() {
    const LENGTH_M: f64 = 8.0;
    const STRAY_M: f64 = 1.0;
    const TURN_RAD: f64 = 0.3;
    let mut random = ChaCha8Rng::seed_from_u64(3);
    let mut references: Vec<Pose2> = Vec::new();
    let mut counts = Vec::new();
    for _ in 0..3_000 {
        for k in 0..16 {
            let along_m = 0.5 * (f64::from(k) + random.random::<f64>());
            let aside_m = STRAY_M * (2.0 * random.random::<f64>() - 1.0);
            let turn_rad = TURN_RAD * (2.0 * random.random::<f64>() - 1.0);
            let pose = Pose2::new(along_m, aside_m, turn_rad);
            if !is_covered(&pose, references.iter().copied()) {
                references.push(pose);
            }
        }
        counts.push(references.len());
    }
    // Of references that point nearly the same way no two are within the distance: discs of half
    // of it round them are apart, and no discs lie denser than in a hexagonal pattern.
    let disc_m2 = std::f64::consts::PI * (0.5 * COVERED_DISTANCE_M).powi(2);
    let room_m2 = (LENGTH_M + COVERED_DISTANCE_M) * (2.0 * STRAY_M + COVERED_DISTANCE_M);
    let ways = (2.0 * TURN_RAD / COVERED_TURN_RAD).ceil();
    let most = ways * 0.9069 * room_m2 / disc_m2;
    assert!(
        (references.len() as f64) < most,
        "{} {most}",
        references.len()
    );
    let early = counts[299] as f64;
    assert!(
        early > 0.8 * references.len() as f64,
        "{early} {}",
        references.len()
    );
    assert!(counts[1_999] as f64 > 0.95 * references.len() as f64);
}
