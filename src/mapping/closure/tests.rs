//! What refuses a closure, and what does not.

use std::sync::Arc;

use super::super::keyframe::Keyframe;
use super::*;
use crate::geometry::Vector2;
use crate::ids::{NodeId, StampNs, TripId};
use crate::scan::{LaserScan, Lidar};
use crate::sim::Shape;

/// What is seen at a pose among shapes.
fn keyframe_among(node: i64, pose: &Pose2, shapes: &[Shape]) -> Keyframe {
    let lidar = Lidar {
        angle_min_rad: -3.1,
        angle_increment_rad: 0.02,
        range_min_m: 0.05,
        range_max_m: 12.0,
        mount: Pose2::IDENTITY,
        range_sigma_m: 0.01,
        band: None,
    };
    let to_map = pose.to_transform();
    let range_m = |direction: Vector2<f64>| {
        let direction = to_map.turn(&direction);
        let hits = (shapes.iter())
            .filter_map(|shape| shape.distance_along(&pose.translation(), &direction));
        let nearest_m = hits.min_by(f64::total_cmp);
        nearest_m.filter(|range_m| *range_m < lidar.range_max_m)
    };
    let ranges_m: Vec<Option<f64>> = lidar.beam_directions(311).map(range_m).collect();
    let scan = LaserScan::new(Arc::new(lidar), ranges_m).unwrap();
    let trip = TripId::new("room").unwrap();
    Keyframe::new(NodeId(node), trip, StampNs(node), *pose, scan)
}

/// What is seen at a pose in a room of 8 m x 5 m with other things in it.
fn keyframe(node: i64, pose: &Pose2, things: &[Shape]) -> Keyframe {
    let walls = Shape::rectangle(&Pose2::new(4.0, 0.5, 0.0), 8.0, 5.0);
    keyframe_among(node, pose, &[&[walls], things].concat())
}

/// What is seen between two walls 60 m long.
fn in_a_corridor(node: i64, x_m: f64, things: &[Shape]) -> Keyframe {
    let wall = |y_m: f64| Shape::rectangle(&Pose2::new(0.0, y_m, 0.0), 60.0, 0.2);
    let walls = [wall(-1.2), wall(1.2)];
    keyframe_among(node, &Pose2::new(x_m, 0.0, 0.0), &[&walls, things].concat())
}

/// A cupboard before (2, 0): seen from there, it hides more than a fifth of the room.
fn cupboard() -> [Shape; 1] {
    [Shape::rectangle(&Pose2::new(3.5, 0.0, 0.0), 0.4, 2.4)]
}

const SLACK: Slack = Slack {
    distance_m: 0.45,
    turn_rad: 0.16,
    well_known: false,
    contradiction_share_max: CONTRADICTION_SHARE_MAX,
};

fn with_score(score_min: f64) -> ClosureRule {
    ClosureRule {
        overlap_min: score_min,
        inlier_share_min: 1.0,
    }
}

#[test]
fn the_score_keeps_what_the_comparison_with_free_space_refuses() {
    let pose = Pose2::new(2.0, 0.0, 0.0);
    let (before, after) = (keyframe(1, &pose, &[]), keyframe(2, &pose, &cupboard()));
    let [old, new] = [&before, &after].map(|keyframe| Placed { pose, keyframe });
    let here = Pose2::IDENTITY;
    // No threshold at all, so that only the other gates are left. Section 5.1 says it of one that is
    // too high: it drops the closures of changes itself.
    let rule = ClosureRule {
        overlap_min: 0.0,
        inlier_share_min: 0.0,
    };
    assert_eq!(measure(&old, &new, &here, &SLACK, &rule), None);
    // It is that comparison, and nothing else, that refuses it.
    let trusting = Slack {
        well_known: true,
        ..SLACK
    };
    assert!(measure(&old, &new, &here, &trusting, &rule).is_some());
    let kept = measure_by_score(&old, &new, &here, &rule).unwrap();
    // The change pulls at the estimate from all points, and at that alone.
    let off_m = |estimate: &Estimate| estimate.pose.translation().norm();
    assert!(off_m(&kept.all_points) > 3.0 * off_m(&kept.robust));
    assert!(off_m(&kept.all_points) > 0.01);
}

#[test]
fn the_score_of_the_all_points_match_is_the_only_gate() {
    let pose = Pose2::new(2.0, 0.0, 0.0);
    let (before, after) = (keyframe(1, &pose, &[]), keyframe(2, &pose, &cupboard()));
    let [old, new] = [&before, &after].map(|keyframe| Placed { pose, keyframe });
    let measured =
        |score_min: f64| measure_by_score(&old, &new, &Pose2::IDENTITY, &with_score(score_min));
    let all_points = measured(0.0).unwrap().all_points;
    let score = all_points.explained_share();
    assert!(score > 0.05 && score < 0.95, "{score}");
    assert_eq!(measured(score - 1e-9).unwrap().all_points, all_points);
    assert_eq!(measured(score + 1e-9), None);

    // Where the robust rule refuses a match that ends 0.7 m from where it was expected, this one
    // is asked nothing.
    let here = Pose2::new(2.7, 0.0, 0.0);
    let moved = keyframe(3, &here, &[]);
    let new = Placed {
        pose,
        keyframe: &moved,
    };
    let rule = ClosureRule::default();
    assert_eq!(measure(&old, &new, &Pose2::IDENTITY, &SLACK, &rule), None);
    let found = measure_by_score(&old, &new, &Pose2::IDENTITY, &rule).unwrap();
    assert!(
        (found.all_points.pose.x - 0.7).abs() < 0.1,
        "{:?}",
        found.all_points.pose
    );
}

#[test]
fn one_number_stands_for_the_rule_s_two() {
    assert!((ClosureRule::default().score_min() - 0.24).abs() < 1e-12);
}

#[test]
fn along_a_bare_corridor_a_closure_says_nothing() {
    let pillar = |x_m: f64| Shape::rectangle(&Pose2::new(x_m, 1.0, 0.0), 0.4, 0.4);
    let measured = |things: &[Shape]| {
        let (before, after) = (in_a_corridor(1, 0.0, things), in_a_corridor(2, 0.5, things));
        let placed = |keyframe| Placed {
            pose: Pose2::IDENTITY,
            keyframe,
        };
        // Said to be 0.1 m from where it is.
        let expected = Pose2::new(0.4, 0.0, 0.0);
        let rule = ClosureRule::default();
        measure(&placed(&before), &placed(&after), &expected, &SLACK, &rule).unwrap()
    };
    let along = |found: &ClosureMeasurement| {
        let direction = crate::geometry::Vector3::new(1.0, 0.0, 0.0);
        found.robust.information.squared_norm(&direction)
    };
    let bare = measured(&[]);
    assert_eq!(bare.fixed_share, 0.0);
    assert!(along(&bare) < 1e-6, "{}", along(&bare));
    let furnished = measured(&[-3.0, 1.5, 4.3].map(pillar));
    assert_eq!(furnished.fixed_share, 1.0);
    assert!(
        along(&furnished) > 1.0 / (0.05 * 0.05),
        "{}",
        along(&furnished)
    );
    assert!((furnished.robust.pose.x - 0.5).abs() < 0.01);
}
