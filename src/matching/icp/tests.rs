//! The alignment's derivatives against differences of an independent cost.

use super::*;
use crate::geometry::{Matrix3, Vector2};
use crate::matching::estimate::CORRELATED_POINTS;
use crate::matching::normal_equations::TYPICAL_RMSE_M;
use crate::matching::testing::look;
use crate::sim::Hall;

fn views() -> (Vec<SurfacePoint>, Vec<SurfacePoint>, Pose2) {
    let hall = Hall::generate(17).unwrap();
    let at = hall.route.pose_at(40.0);
    let moved = Pose2::new(0.15, -0.1, 0.06);
    (
        look(&hall.world, &at, 0),
        look(&hall.world, &at.compose(&moved), 0),
        moved.compose(&Pose2::new(0.02, 0.01, -0.01)),
    )
}

/// The point in the base frame, its counterpart, and the counterpart's normal.
type BrutePair = (Vector2<f64>, Vector2<f64>, Option<Vector2<f64>>);

fn pairs_by_brute_force(
    old: &[SurfacePoint],
    new: &[SurfacePoint],
    pose: &Pose2,
    gate_m: f64,
    params: &IcpParams,
) -> Vec<BrutePair> {
    let mut pairs = Vec::new();
    for point in new {
        let position = pose.transform(&point.position);
        let distance = |o: &SurfacePoint| (o.position - position).norm();
        let nearest = old
            .iter()
            .min_by(|a, b| distance(a).total_cmp(&distance(b)))
            .unwrap();
        let alike = match (point.normal, nearest.normal) {
            (Some(a), Some(b)) => (pose.rotation() * a).dot(&b) >= params.normal_cosine_min,
            _ => true,
        };
        let within = nearest.normal.is_none_or(|n| {
            let along = Vector2::new(-n.y, n.x).dot(&(position - nearest.position));
            let far_m = params.beside_max_range_share * point.range_m;
            along.abs() <= params.beside_max_m || along.abs() <= far_m
        });
        if distance(nearest) <= gate_m && alike && within {
            pairs.push((point.position, nearest.position, nearest.normal));
        }
    }
    pairs
}

/// The equations of all points at a pose, and how many have a counterpart.
fn linearise(
    cloud: &ReferenceCloud,
    points: &[SurfacePoint],
    pose: &Pose2,
    gate_m: f64,
    params: &IcpParams,
) -> (NormalEquations, usize) {
    let mut pairing = Pairing::new(cloud, points);
    pairing.look_up(pose, gate_m, params, 1);
    let pairs = pairing.pairs();
    let equations = NormalEquations::of(pairs, pose, params.cauchy_scale_m);
    (equations, pairs.len())
}

fn distance_m(pair: &BrutePair, pose: &Pose2) -> f64 {
    let offset = pose.transform(&pair.0) - pair.1;
    pair.2.map_or(offset.norm(), |n| n.dot(&offset).abs())
}

/// ½ Σ c² ln(1 + (r/c)²), or ½ Σ r²: what the weights descend.
fn cost(pairs: &[BrutePair], pose: &Pose2, cauchy_scale_m: Option<f64>) -> f64 {
    let of_one = |r: f64| match cauchy_scale_m {
        Some(c) => 0.5 * c * c * (r / c).powi(2).ln_1p(),
        None => 0.5 * r * r,
    };
    pairs.iter().map(|p| of_one(distance_m(p, pose))).sum()
}

fn stepped(pose: &Pose2, axis: usize, by: f64) -> Pose2 {
    let mut step = Vector3::zeros();
    step[axis] = by;
    pose.compose(&Pose2::new(step.x, step.y, step.z))
}

#[test]
fn the_gradient_is_that_of_the_cost() {
    let (old, new, pose) = views();
    let cloud = ReferenceCloud::new([(Pose2::IDENTITY, old.as_slice())]).unwrap();
    for params in [IcpParams::ROBUST, IcpParams::ALL_POINTS] {
        for gate_m in [0.15, 1.0, 3.0] {
            let (equations, count) = linearise(&cloud, &new, &pose, gate_m, &params);
            let pairs = pairs_by_brute_force(&old, &new, &pose, gate_m, &params);
            assert_eq!(count, pairs.len());
            assert!(pairs.len() > 150, "{}", pairs.len());
            assert!(pairs.iter().any(|p| p.2.is_none()), "corners take part");
            let h = 1e-6;
            for axis in 0..3 {
                let at = |by: f64| cost(&pairs, &stepped(&pose, axis, by), params.cauchy_scale_m);
                let slope = (at(h) - at(-h)) / (2.0 * h);
                let told = -equations.gradient[axis];
                let scale = equations.gradient.norm().max(1e-3);
                assert!(
                    (slope - told).abs() < 1e-5 * scale,
                    "{axis}: {slope} {told}"
                );
            }
        }
    }
}

#[test]
fn the_hessian_is_gauss_newtons() {
    let (old, new, pose) = views();
    let cloud = ReferenceCloud::new([(Pose2::IDENTITY, old.as_slice())]).unwrap();
    for params in [IcpParams::ROBUST, IcpParams::ALL_POINTS] {
        let (equations, _) = linearise(&cloud, &new, &pose, 0.5, &params);
        let mut expected = Matrix3::zeros();
        let h = 1e-6;
        for pair in pairs_by_brute_force(&old, &new, &pose, 0.5, &params) {
            let r = distance_m(&pair, &pose);
            let weight = params
                .cauchy_scale_m
                .map_or(1.0, |c| 1.0 / (1.0 + (r / c).powi(2)));
            let axes = pair.2.map_or(vec![Vector2::x(), Vector2::y()], |n| vec![n]);
            for axis in axes {
                let along = |k, by| axis.dot(&stepped(&pose, k, by).transform(&pair.0));
                let slope = |k| (along(k, h) - along(k, -h)) / (2.0 * h);
                let jacobian = Vector3::new(slope(0), slope(1), slope(2));
                expected += jacobian * jacobian.transpose() * weight;
            }
        }
        let difference = (equations.hessian - expected).norm();
        assert!(difference < 1e-6 * expected.norm(), "{difference}");
    }
}

#[test]
fn a_prior_pulls_down_its_own_cost() {
    let prior = Prior {
        pose: Pose2::new(0.4, -0.2, 3.1),
        information: Information::from_upper([900.0, 100.0, -20.0, 400.0, 30.0, 2500.0]),
    };
    // Across the seam of the angles too.
    let pose = prior.pose.compose(&Pose2::new(0.05, 0.1, 0.12));
    let mut equations = NormalEquations::default();
    equations.add_prior(&prior, &pose, 0.01);
    let unit = noise_variance_m2(0.01, TYPICAL_RMSE_M) * CORRELATED_POINTS;
    let cost = |pose: &Pose2| {
        let offset = prior.pose.between(pose);
        let offset = Vector3::new(offset.x, offset.y, offset.theta);
        0.5 * unit * prior.information.squared_norm(&offset)
    };
    let h = 1e-5;
    for axis in 0..3 {
        let slope = (cost(&stepped(&pose, axis, h)) - cost(&stepped(&pose, axis, -h))) / (2.0 * h);
        let told = -equations.gradient[axis];
        let scale = equations.gradient.norm();
        assert!((slope - told).abs() < 1e-6 * scale, "{slope} {told}");
    }
    let step = equations.solve();
    let after = pose.compose(&Pose2::new(step.x, step.y, step.z));
    assert!(cost(&after) < 1e-3 * cost(&pose));
}

#[test]
fn the_end_is_a_minimum_of_the_cost() {
    let (old, new, start) = views();
    let cloud = ReferenceCloud::new([(Pose2::IDENTITY, old.as_slice())]).unwrap();
    // What a smooth end is the minimum of is not a sum over pairs.
    let robust = IcpParams {
        ends_smoothly: false,
        ..IcpParams::ROBUST
    };
    for params in [robust, IcpParams::ALL_POINTS] {
        let found = align(&cloud, &new, &start, 0.01, None, &params);
        let pairs = pairs_by_brute_force(&old, &new, &found.pose, params.gate_end_m, &params);
        let least = cost(&pairs, &found.pose, params.cauchy_scale_m);
        for (axis, by) in [(0, 2e-3), (1, 2e-3), (2, 1e-3)] {
            for by in [by, -by] {
                let beside = stepped(&found.pose, axis, by);
                assert!(cost(&pairs, &beside, params.cauchy_scale_m) > least);
            }
        }
    }
}

#[test]
fn what_is_free_is_left_out_and_what_is_fixed_is_kept() {
    // Two walls along x fix y and θ, a little noise of their normals next to nothing of x.
    let mut hessian = Matrix3::zeros();
    for k in 0..100 {
        let x = 0.1 * f64::from(k) - 5.0;
        let jacobian = Vector3::new(0.03 * f64::from(k % 3 - 1), 1.0, x);
        hessian += jacobian * jacobian.transpose();
    }
    let observability = Observability::new(&hessian, 100.0, 3.0);
    assert_eq!(observability.count(), 2);
    let gradient = Vector3::new(0.3, -2.0, 5.0);
    let step = observability.solve(&gradient);
    assert!(step.x.abs() < 0.02 * step.norm(), "{step}");
    let within = observability.fixed_part(&gradient);
    let again = observability.fixed_part(&within);
    assert!((again - within).norm() < 1e-12, "a projection");
    assert!((observability.solve(&within) - step).norm() < 1e-12);
    let back = observability.hessian() * step;
    assert!((back - within).norm() < 1e-9 * within.norm());
}

/// A straight wall 1 m ahead between two values of y, a point every centimetre.
fn wall(from_cm: i32, to_cm: i32) -> Vec<SurfacePoint> {
    let point = |cm: i32| SurfacePoint {
        position: Vector2::new(1.0, 0.01 * f64::from(cm)),
        normal: Some(Vector2::new(-1.0, 0.0)),
        beam: 0,
        range_m: 1.0,
    };
    (from_cm..to_cm).map(point).collect()
}

#[test]
fn points_beyond_the_end_of_a_wall_have_no_counterpart() {
    let cloud = ReferenceCloud::new([(Pose2::IDENTITY, wall(-50, 1).as_slice())]).unwrap();
    let longer = wall(-50, 51);
    let pairs = |params: &IcpParams| {
        let gate_m = params.gate_start_m;
        linearise(&cloud, &longer, &Pose2::IDENTITY, gate_m, params).1
    };
    assert_eq!(pairs(&IcpParams::ROBUST), 51 + 10);
    assert_eq!(pairs(&IcpParams::ALL_POINTS), 51 + 50);
}

#[test]
fn a_short_sighted_lidar_measures_turns() {
    // The same corner, seen from 1 m and from 10 m: as well fixed, though its points turn less.
    for size in [1.0, 10.0] {
        let mut corner = wall(-50, 50);
        corner.extend(wall(-50, 50).iter().map(|p| SurfacePoint {
            position: Vector2::new(p.position.y, p.position.x),
            normal: Some(Vector2::new(0.0, -1.0)),
            ..*p
        }));
        for point in &mut corner {
            point.position *= size;
            point.range_m = point.position.norm();
        }
        let cloud = ReferenceCloud::new([(Pose2::IDENTITY, corner.as_slice())]).unwrap();
        let start = Pose2::new(0.0, 0.0, 0.05);
        let found = align(&cloud, &corner, &start, 0.01, None, &IcpParams::ROBUST);
        assert_eq!(found.observable_directions, 3, "{size} m");
        assert!(
            found.pose.theta.abs() < 1e-3,
            "{size} m: {}",
            found.pose.theta
        );
    }
}
