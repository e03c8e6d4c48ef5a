//! Point-to-line ICP.

use super::estimate::{Observability, lever_arm_m};
use super::icp_params::IcpParams;
use super::normal_equations::{NormalEquations, noise_variance_m2};
use super::pairing::Pairing;
use super::prior::Prior;
use super::smooth::{Surroundings, WEIGHT_SUM_MIN};
use super::{Estimate, ReferenceCloud, Termination};
use crate::geometry::{Information, Pose2, Vector3};
use crate::scan::SurfacePoint;

/// While the gate is wide, so many points lead as well as all (at least so many, and fewer than
/// twice as many, take part).
const COARSE_POINTS: usize = 180;
/// The gate need not be wider than so many times the way that the last step led.
const GATE_MOTIONS: f64 = 20.0;
/// Fewest pairs that an alignment is based on.
const PAIRS_MIN: usize = 12;
const STEP_TOLERANCE_M: f64 = 1e-4;
const STEP_TOLERANCE_RAD: f64 = 2e-5;
/// Where smooth steps follow, those before need not be so fine by this factor.
const COARSER: f64 = 10.0;
/// Most smooth steps, and the longest one, metres.
const SMOOTH_STEPS_MAX: usize = 6;
const SMOOTH_STEP_MAX_M: f64 = 0.05;
/// Aligns a scan with a cloud once: [`Alignment::align_from`].
pub fn align(
    reference: &ReferenceCloud,
    points: &[SurfacePoint],
    initial: &Pose2,
    range_sigma_m: f64,
    prior: Option<&Prior>,
    params: &IcpParams,
) -> Estimate {
    Alignment::new(reference, points).align_from(initial, range_sigma_m, prior, params)
}

/// A scan and a cloud that are aligned, from one start or from several: what is known of a point's
/// neighbours after one alignment helps the next.
pub struct Alignment<'a> {
    pub(super) pairing: Pairing<'a>,
    lever_arm_m: f64,
}

impl<'a> Alignment<'a> {
    /// Of a scan's points with a cloud.
    pub fn new(reference: &'a ReferenceCloud, points: &'a [SurfacePoint]) -> Self {
        Self {
            pairing: Pairing::new(reference, points),
            lever_arm_m: lever_arm_m(points),
        }
    }

    /// Aligns them, starting at `initial` = `reference_from_base`.
    ///
    /// Directions that neither the points (along a corridor) nor the prior fix stay as in
    /// `initial`; the information in the estimate is the points' alone. The estimate is
    /// the starting pose with zero information if fewer than a dozen points find a counterpart.
    pub fn align_from(
        &mut self,
        initial: &Pose2,
        range_sigma_m: f64,
        prior: Option<&Prior>,
        params: &IcpParams,
    ) -> Estimate {
        let pairing = &mut self.pairing;
        let stepper = Stepper {
            lever_arm_m: self.lever_arm_m,
            range_sigma_m,
            prior,
            params,
        };
        let mut coarse_stride = (pairing.points().len() / COARSE_POINTS).max(1);
        let mut pose = *initial;
        let mut gate_m = params.gate_start_m;
        let mut termination = Termination::IterationLimit;
        for _ in 0..params.iterations_max {
            let is_coarse = gate_m > params.gate_end_m && coarse_stride > 1;
            let stride = if is_coarse { coarse_stride } else { 1 };
            pairing.look_up(&pose, gate_m, params, stride);
            if pairing.pairs().len() < PAIRS_MIN {
                if is_coarse {
                    coarse_stride = 1;
                    continue;
                }
                termination = Termination::TooFewPoints;
                pose = *initial;
                break;
            }
            let mut equations = NormalEquations::of(pairing.pairs(), &pose, params.cauchy_scale_m);
            equations.stand_for(stride);
            let step = stepper.step(equations, &pose);
            pose = pose.compose(&Pose2::new(step.x, step.y, step.z));
            let small = is_small(&step, if params.ends_smoothly { COARSER } else { 1.0 });
            if gate_m <= params.gate_end_m && small {
                termination = Termination::Converged;
                break;
            }
            let motion_m = step.xy().norm() + step.z.abs() * stepper.lever_arm_m;
            gate_m = (gate_m * params.gate_factor)
                .min(GATE_MOTIONS * motion_m)
                .max(params.gate_end_m);
        }
        if params.ends_smoothly && termination != Termination::TooFewPoints {
            pose = stepper.settle(pairing, &pose);
            pairing.look_up(&pose, params.gate_end_m, params, 1);
        } else if termination != Termination::Converged {
            pairing.look_up(&pose, params.gate_end_m, params, 1);
        }
        stepper.summarise(pairing, &pose, termination)
    }
}

/// Whether a step is below the tolerance, or so many times it.
fn is_small(step: &Vector3<f64>, times: f64) -> bool {
    step.xy().norm() < times * STEP_TOLERANCE_M && step.z.abs() < times * STEP_TOLERANCE_RAD
}

/// What all steps of an alignment share.
struct Stepper<'a> {
    lever_arm_m: f64,
    range_sigma_m: f64,
    prior: Option<&'a Prior>,
    params: &'a IcpParams,
}

impl Stepper<'_> {
    /// The last steps, each point compared with all that is around it.
    fn settle(&self, pairing: &Pairing<'_>, start: &Pose2) -> Pose2 {
        let surroundings_at =
            |pose: &Pose2| Surroundings::at(pose, pairing.reference(), pairing.points());
        let mut surroundings = surroundings_at(start);
        let (mut pose, mut moved_m) = (*start, 0.0);
        for _ in 0..SMOOTH_STEPS_MAX {
            let equations = surroundings.equations(&pose, self.params.cauchy_scale_m);
            if equations.weight_sum < WEIGHT_SUM_MIN {
                return *start;
            }
            let step = self.step(equations, &pose);
            let step = step * (SMOOTH_STEP_MAX_M / step.xy().norm()).min(1.0);
            pose = pose.compose(&Pose2::new(step.x, step.y, step.z));
            if is_small(&step, 1.0) {
                break;
            }
            moved_m += step.xy().norm() + step.z.abs() * self.lever_arm_m;
            if !surroundings.cover(moved_m) {
                surroundings = surroundings_at(&pose);
                moved_m = 0.0;
            }
        }
        pose
    }

    fn step(&self, mut equations: NormalEquations, pose: &Pose2) -> Vector3<f64> {
        let observability = self.observability(&equations);
        match self.prior {
            None => observability.solve(&equations.gradient),
            Some(prior) => {
                equations.restrict_to(&observability);
                equations.add_prior(prior, pose, self.range_sigma_m);
                equations.solve()
            }
        }
    }

    fn observability(&self, equations: &NormalEquations) -> Observability {
        let NormalEquations {
            hessian,
            weight_sum,
            ..
        } = equations;
        Observability::new(hessian, *weight_sum, self.lever_arm_m)
    }

    /// What the pairs say, which were found within a tolerance of the pose.
    fn summarise(&self, pairing: &Pairing<'_>, pose: &Pose2, termination: Termination) -> Estimate {
        let params = self.params;
        let support = Support::of(pairing, pose, params);
        let (information, observable_directions) = if termination == Termination::TooFewPoints {
            (Information::from_upper([0.0; 6]), 0)
        } else {
            let equations = NormalEquations::of(pairing.pairs(), pose, params.cauchy_scale_m);
            let observability = self.observability(&equations);
            let variance_m2 = noise_variance_m2(self.range_sigma_m, support.rmse_m);
            (
                observability.information(variance_m2),
                observability.count(),
            )
        };
        Estimate {
            pose: *pose,
            information,
            observable_directions,
            overlap: support.overlapping as f64 / pairing.points().len().max(1) as f64,
            inlier_share: support.inliers as f64 / support.overlapping.max(1) as f64,
            rmse_m: support.rmse_m,
            termination,
        }
    }
}

/// How well the points agree with their counterparts.
struct Support {
    overlapping: usize,
    inliers: usize,
    rmse_m: f64,
}

impl Support {
    fn of(pairing: &Pairing<'_>, pose: &Pose2, params: &IcpParams) -> Self {
        let to_reference = pose.to_transform();
        let overlap_m2 = params.overlap_gate_m * params.overlap_gate_m;
        let inlier_offset_m = 2.0 * params.inlier_gate_m.max(params.gate_end_m);
        let (mut overlapping, mut inliers, mut square_sum_m2) = (0usize, 0usize, 0.0);
        for pair in pairing.pairs().iter().chain(pairing.beyond_gate()) {
            let offset = to_reference.apply(&pair.point) - pair.counterpart;
            let offset_m2 = offset.norm_squared();
            if offset_m2 > overlap_m2 {
                continue;
            }
            overlapping += 1;
            let distance_m2 = pair.normal.map_or(offset_m2, |n| n.dot(&offset).powi(2));
            if distance_m2 <= params.inlier_gate_m * params.inlier_gate_m
                && offset_m2 <= inlier_offset_m * inlier_offset_m
            {
                inliers += 1;
                square_sum_m2 += distance_m2;
            }
        }
        Self {
            overlapping,
            inliers,
            rmse_m: (square_sum_m2 / inliers.max(1) as f64).sqrt(),
        }
    }
}

#[cfg(test)]
mod tests;
