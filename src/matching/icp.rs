//! Point-to-line ICP.

use super::estimate::{CORRELATED_POINTS, Observability, lever_arm_m};
use super::{Estimate, ReferenceCloud, Termination};
use crate::geometry::{Information, Matrix3, Pose2, Transform2, Vector2, Vector3};
use crate::scan::SurfacePoint;

/// How points are paired and weighed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct IcpParams {
    /// Farthest counterpart in the first iteration, metres.
    pub gate_start_m: f64,
    /// Farthest counterpart in the end, metres.
    pub gate_end_m: f64,
    /// What an iteration leaves of the gate.
    pub gate_factor: f64,
    /// Scale of the Cauchy weight 1 / (1 + (r/c)²), metres; `None` weighs all points alike.
    pub cauchy_scale_m: Option<f64>,
    /// Least cosine between two points' normals.
    pub normal_cosine_min: f64,
    /// How far a point may lie beside its counterpart, along the counterpart's line, metres; one
    /// farther off lies beyond the end of what the reference shows.
    pub beside_max_m: f64,
    /// The same for far points, as a share of their range: neighbouring beams lie far apart there.
    pub beside_max_range_share: f64,
    /// Largest number of iterations.
    pub iterations_max: usize,
    /// Distance to a counterpart within which a point counts as overlapping, metres.
    pub overlap_gate_m: f64,
    /// Distance to a line within which a point counts as agreeing, metres.
    pub inlier_gate_m: f64,
}

impl IcpParams {
    /// For the map: what disagrees is weighed down (method: "robust").
    pub const ROBUST: Self = Self {
        gate_start_m: 1.0,
        gate_end_m: 0.15,
        gate_factor: 0.75,
        cauchy_scale_m: Some(0.03),
        normal_cosine_min: 0.7,
        beside_max_m: 0.1,
        beside_max_range_share: 0.02,
        iterations_max: 40,
        overlap_gate_m: 0.5,
        inlier_gate_m: 0.08,
    };
    /// For the residual: every point takes part (paper, section 4), so a changed place pulls the
    /// estimate away from the robust one.
    pub const ALL_POINTS: Self = Self {
        gate_start_m: 3.0,
        gate_end_m: 3.0,
        gate_factor: 1.0,
        cauchy_scale_m: None,
        normal_cosine_min: -1.0,
        beside_max_m: f64::INFINITY,
        beside_max_range_share: 0.02,
        iterations_max: 30,
        overlap_gate_m: 0.5,
        inlier_gate_m: 0.08,
    };
}

/// What is known of the pose beforehand.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Prior {
    /// `reference_from_base`.
    pub pose: Pose2,
    /// Of the pose, for errors in the base frame.
    pub information: Information,
}

/// Root mean square distance of a typical match, metres: what a prior is weighed against.
const TYPICAL_RMSE_M: f64 = 0.02;

/// Fewest pairs that an alignment is based on.
const PAIRS_MIN: usize = 12;
const STEP_TOLERANCE_M: f64 = 1e-4;
const STEP_TOLERANCE_RAD: f64 = 2e-5;

#[derive(Default)]
struct NormalEquations {
    hessian: Matrix3<f64>,
    gradient: Vector3<f64>,
    weight_sum: f64,
    pairs: usize,
}

impl NormalEquations {
    /// Pulls towards a prior, in units of one point's variance.
    fn add_prior(&mut self, prior: &Prior, pose: &Pose2, range_sigma_m: f64) {
        let offset = prior.pose.between(pose);
        let turned = Pose2::new(0.0, 0.0, offset.theta).rotation();
        let mut jacobian = Matrix3::identity();
        jacobian.fixed_view_mut::<2, 2>(0, 0).copy_from(&turned);
        let variance = noise_variance_m2(range_sigma_m, TYPICAL_RMSE_M) * CORRELATED_POINTS;
        let weighted = jacobian.transpose() * prior.information.matrix() * variance;
        self.hessian += weighted * jacobian;
        self.gradient -= weighted * Vector3::new(offset.x, offset.y, offset.theta);
    }

    /// Keeps of the points only what they say of the directions that they fix.
    fn restrict_to(&mut self, observability: &Observability) {
        self.hessian = observability.hessian();
        self.gradient = observability.fixed_part(&self.gradient);
    }

    /// The step H⁻¹g; none if neither points nor prior fix all directions.
    fn solve(&self) -> Vector3<f64> {
        let factor = self.hessian.cholesky();
        factor.map_or(Vector3::zeros(), |factor| factor.solve(&self.gradient))
    }

    fn add(&mut self, jacobian: Vector3<f64>, residual_m: f64, weight: f64) {
        self.hessian += jacobian * jacobian.transpose() * weight;
        self.gradient -= jacobian * (residual_m * weight);
    }
}

/// Aligns a scan with a cloud, starting at `initial` = `reference_from_base`.
///
/// Directions that neither the points (along a corridor) nor the prior fix stay as in `initial`;
/// the information in the estimate is the points' alone. The estimate is
/// the starting pose with zero information if fewer than a dozen points find a counterpart.
pub fn align(
    reference: &ReferenceCloud,
    points: &[SurfacePoint],
    initial: &Pose2,
    range_sigma_m: f64,
    prior: Option<&Prior>,
    params: &IcpParams,
) -> Estimate {
    let mut pose = *initial;
    let mut gate_m = params.gate_start_m;
    let mut termination = Termination::IterationLimit;
    let lever_arm_m = lever_arm_m(points);
    for _ in 0..params.iterations_max {
        let mut equations = linearise(reference, points, &pose, gate_m, params);
        if equations.pairs < PAIRS_MIN {
            termination = Termination::TooFewPoints;
            pose = *initial;
            break;
        }
        let observability =
            Observability::new(&equations.hessian, equations.weight_sum, lever_arm_m);
        let step = match prior {
            None => observability.solve(&equations.gradient),
            Some(prior) => {
                equations.restrict_to(&observability);
                equations.add_prior(prior, &pose, range_sigma_m);
                equations.solve()
            }
        };
        pose = pose.compose(&Pose2::new(step.x, step.y, step.z));
        let settled = gate_m <= params.gate_end_m;
        gate_m = (gate_m * params.gate_factor).max(params.gate_end_m);
        let small = step.xy().norm() < STEP_TOLERANCE_M && step.z.abs() < STEP_TOLERANCE_RAD;
        if settled && small {
            termination = Termination::Converged;
            break;
        }
    }
    summarise(reference, points, &pose, range_sigma_m, params, termination)
}

/// Variance of a point's distance to its line, m²: both ends' range noise, or what is seen.
fn noise_variance_m2(range_sigma_m: f64, rmse_m: f64) -> f64 {
    (2.0 * range_sigma_m * range_sigma_m).max(rmse_m * rmse_m)
}

/// The counterpart of a point: the offset from it, and along which normal it is compared.
fn pair(
    reference: &ReferenceCloud,
    point: &SurfacePoint,
    to_reference: &Transform2,
    gate_m: f64,
    params: &IcpParams,
) -> Option<(Vector2<f64>, Option<Vector2<f64>>)> {
    let position = to_reference.apply(&point.position);
    let index = reference.nearest(&position, gate_m)?;
    let offset = position - reference.position(index);
    let reference_normal = reference.normal(index);
    if let Some(line_normal) = reference_normal {
        let beside_max_m = params
            .beside_max_m
            .max(params.beside_max_range_share * point.range_m);
        let normal = point.normal.map(|n| to_reference.turn(&n));
        let turned_away = normal.is_some_and(|n| n.dot(&line_normal) < params.normal_cosine_min);
        if turned_away || line_normal.perp(&offset).abs() > beside_max_m {
            return None;
        }
    }
    Some((offset, reference_normal))
}

fn linearise(
    reference: &ReferenceCloud,
    points: &[SurfacePoint],
    pose: &Pose2,
    gate_m: f64,
    params: &IcpParams,
) -> NormalEquations {
    let to_reference = pose.to_transform();
    let mut equations = NormalEquations::default();
    for point in points {
        let Some((offset, line_normal)) = pair(reference, point, &to_reference, gate_m, params)
        else {
            continue;
        };
        equations.pairs += 1;
        let distance_m = line_normal.map_or(offset.norm(), |n| n.dot(&offset).abs());
        let weight = params
            .cauchy_scale_m
            .map_or(1.0, |c| 1.0 / (1.0 + (distance_m / c).powi(2)));
        equations.weight_sum += weight;
        let turned = Vector2::new(-point.position.y, point.position.x);
        let mut add = |axis: Vector2<f64>| {
            let in_base = to_reference.turn_back(&axis);
            let jacobian = Vector3::new(in_base.x, in_base.y, in_base.dot(&turned));
            equations.add(jacobian, axis.dot(&offset), weight);
        };
        match line_normal {
            Some(n) => add(n),
            None => {
                add(Vector2::x());
                add(Vector2::y());
            }
        }
    }
    equations
}

fn summarise(
    reference: &ReferenceCloud,
    points: &[SurfacePoint],
    pose: &Pose2,
    range_sigma_m: f64,
    params: &IcpParams,
    termination: Termination,
) -> Estimate {
    let to_reference = pose.to_transform();
    let (mut overlapping, mut inliers, mut square_sum) = (0usize, 0usize, 0.0);
    for point in points {
        let gate_m = params.overlap_gate_m;
        if let Some((offset, line_normal)) = pair(reference, point, &to_reference, gate_m, params) {
            overlapping += 1;
            let distance_m = line_normal.map_or(offset.norm(), |n| n.dot(&offset).abs());
            if distance_m <= params.inlier_gate_m
                && offset.norm() <= 2.0 * params.inlier_gate_m.max(params.gate_end_m)
            {
                inliers += 1;
                square_sum += distance_m * distance_m;
            }
        }
    }
    let rmse_m = (square_sum / inliers.max(1) as f64).sqrt();
    let (information, observable_directions) = if termination == Termination::TooFewPoints {
        (Information::from_upper([0.0; 6]), 0)
    } else {
        let equations = linearise(reference, points, pose, params.gate_end_m, params);
        let lever_arm_m = lever_arm_m(points);
        let observability =
            Observability::new(&equations.hessian, equations.weight_sum, lever_arm_m);
        let variance_m2 = noise_variance_m2(range_sigma_m, rmse_m);
        (
            observability.information(variance_m2),
            observability.count(),
        )
    };
    Estimate {
        pose: *pose,
        information,
        observable_directions,
        overlap: overlapping as f64 / points.len().max(1) as f64,
        inlier_share: inliers as f64 / overlapping.max(1) as f64,
        rmse_m,
        termination,
    }
}

#[cfg(test)]
mod tests;
