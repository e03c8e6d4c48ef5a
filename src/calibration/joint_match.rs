//! A match of two scans with one unknown more than the pose.

use super::shared_value::Measured;
use crate::geometry::{Matrix3, Pose2, Vector2, Vector3};
use crate::matching::ReferenceCloud;
use crate::scan::SurfacePoint;

/// Farthest counterpart, metres.
const GATE_M: f64 = 0.2;
/// Farther beside its counterpart a point lies on another piece of its line, metres.
const BESIDE_MAX_M: f64 = 0.1;
/// Scale of the Cauchy weight of a distance, metres.
const CAUCHY_SCALE_M: f64 = 0.03;
/// Least cosine between two points' normals.
const NORMAL_COSINE_MIN: f64 = 0.8;
/// Fewest pairs of points.
const PAIRS_MIN: usize = 40;
/// Neighbouring points share the noise of their line; so many count as one.
const CORRELATED_POINTS: f64 = 4.0;

/// What is known of the pose beforehand: standard deviations.
#[derive(Debug, Clone, Copy)]
pub(super) struct PoseSigmas {
    pub xy_m: f64,
    pub theta_rad: f64,
}

/// How one match moves with the unknown. Points and vectors are in the frames of their own bases.
pub(super) struct Moving<F, G> {
    /// How a point of the scan moves, metres per unit of the unknown.
    pub point: F,
    /// The same for a place of the reference.
    pub place: G,
}

/// The step of the unknown that a match asks for, the pose eliminated; `pose` is
/// `reference_from_base`, where the match has ended. `None` if too few points have a counterpart.
pub(super) fn step_of_unknown(
    reference: &ReferenceCloud,
    points: &[SurfacePoint],
    pose: &Pose2,
    expected: &Pose2,
    sigmas: &PoseSigmas,
    range_sigma_m: f64,
    moving: &Moving<impl Fn(&SurfacePoint) -> Vector2<f64>, impl Fn(&Vector2<f64>) -> Vector2<f64>>,
) -> Option<Measured> {
    let to_reference = pose.to_transform();
    let (mut of_pose, mut of_both, mut of_unknown) = (Matrix3::zeros(), Vector3::zeros(), 0.0);
    let (mut pose_gradient, mut gradient) = (Vector3::zeros(), 0.0);
    let (mut count, mut squares_m2, mut weights) = (0, 0.0, 0.0);
    for point in points {
        let position = to_reference.apply(&point.position);
        let Some(found) = reference.nearest(&position, GATE_M) else {
            continue;
        };
        let (Some(line), Some(own)) = (reference.normal(found.index), point.normal) else {
            continue;
        };
        if line.dot(&to_reference.turn(&own)) < NORMAL_COSINE_MIN {
            continue;
        }
        let place = reference.position(found.index);
        if line.perp(&(position - place)).abs() > BESIDE_MAX_M {
            continue;
        }
        let residual_m = line.dot(&(position - place));
        let weight = 1.0 / (1.0 + (residual_m / CAUCHY_SCALE_M).powi(2));
        let axis = to_reference.turn_back(&line);
        let by_pose = Vector3::new(axis.x, axis.y, point.position.perp(&axis));
        let by_unknown = axis.dot(&(moving.point)(point)) - line.dot(&(moving.place)(&place));
        of_pose += by_pose * by_pose.transpose() * weight;
        of_both += by_pose * (weight * by_unknown);
        of_unknown += weight * by_unknown * by_unknown;
        pose_gradient += by_pose * (weight * residual_m);
        gradient += weight * by_unknown * residual_m;
        squares_m2 += weight * residual_m * residual_m;
        weights += weight;
        count += 1;
    }
    if count < PAIRS_MIN {
        return None;
    }
    let variance_m2 = (2.0 * range_sigma_m * range_sigma_m).max(squares_m2 / weights);
    let of_point_m2 = variance_m2 * CORRELATED_POINTS;
    let off = expected.between(pose);
    let (xy, theta) = (
        of_point_m2 / sigmas.xy_m.powi(2),
        of_point_m2 / sigmas.theta_rad.powi(2),
    );
    let prior = Vector3::new(xy, xy, theta);
    // The prior's error turns with the pose by little: its derivatives are taken as 1.
    let shift = Pose2::new(0.0, 0.0, -off.theta).rotation() * Vector2::new(off.x, off.y);
    pose_gradient += prior.component_mul(&Vector3::new(shift.x, shift.y, off.theta));
    let factor = (of_pose + Matrix3::from_diagonal(&prior)).cholesky()?;
    let information = of_unknown - of_both.dot(&factor.solve(&of_both));
    let asked = of_both.dot(&factor.solve(&pose_gradient)) - gradient;
    (information > 1e-9 * of_unknown).then_some(Measured {
        value: asked / information,
        information: information / of_point_m2,
    })
}
