//! Gauss-Newton, with Levenberg-Marquardt damping where a plain step fails.

use super::normal_equations::NormalEquations;
use super::problem::Problem;
use super::summary::{SolveOptions, SolveSummary, Termination};
use crate::geometry::Pose2;

/// Always added, relative to the diagonal: directions that no edge measures keep a pivot well
/// above rounding, and Gauss-Newton's convergence does not notice.
pub(super) const DAMPING_MIN: f64 = 1e-11;
/// The first damping after a plain step has failed.
const DAMPING_FIRST: f64 = 1e-5;
/// Steps with more damping than this are too short to matter.
const DAMPING_MAX: f64 = 1e9;
/// Damping below this is dropped, so that the end game is plain Gauss-Newton.
const DAMPING_DROPPED: f64 = 1e-7;

/// The minimiser's memory, kept between solves; the symbolic factorisation is used again as
/// long as the structure stands.
#[derive(Default)]
pub(super) struct Minimiser {
    equations: Option<NormalEquations>,
    step: Vec<f64>,
    trial: Vec<Pose2>,
}

impl Minimiser {
    /// Moves the poses that are not held to a minimum of the cost.
    pub(super) fn minimise(
        &mut self,
        problem: &mut Problem,
        options: &SolveOptions,
    ) -> SolveSummary {
        let initial_cost = problem.cost_at(&problem.poses);
        let mut summary = SolveSummary {
            initial_cost,
            final_cost: initial_cost,
            iterations: 0,
            termination: Termination::NothingToSolve,
            moved: false,
        };
        if !initial_cost.is_finite() {
            summary.termination = Termination::NotFinite;
            return summary;
        }
        match self.prepare(problem) {
            None => summary.termination = Termination::Unsolvable,
            Some(equations) if equations.dimension() == 0 => {}
            Some(mut equations) => {
                self.iterate(&mut equations, problem, options, &mut summary);
                self.equations = Some(equations);
            }
        }
        summary
    }

    fn prepare(&mut self, problem: &Problem) -> Option<NormalEquations> {
        match self.equations.take() {
            Some(equations) if equations.fits(problem) => Some(equations),
            _ => NormalEquations::new(problem),
        }
    }

    fn iterate(
        &mut self,
        equations: &mut NormalEquations,
        problem: &mut Problem,
        options: &SolveOptions,
        summary: &mut SolveSummary,
    ) {
        let mut damping = DAMPING_MIN;
        let mut growth = 10.0;
        equations.linearise(&problem.factors, &problem.poses);
        loop {
            if summary.iterations >= options.iterations_max {
                summary.termination = Termination::IterationLimit;
                return;
            }
            summary.iterations += 1;
            let decrease = if equations.factorise(damping) {
                equations.step(&mut self.step)
            } else {
                None
            };
            let Some(decrease) = decrease else {
                damping = raised(damping, growth);
                growth *= 2.0;
                if damping > DAMPING_MAX {
                    summary.termination = Termination::Unsolvable;
                    return;
                }
                continue;
            };
            equations.apply(&problem.poses, &self.step, &mut self.trial);
            let cost = problem.cost_at(&self.trial);
            let better = cost < summary.final_cost;
            let gain = (summary.final_cost - cost) / decrease;
            if better {
                std::mem::swap(&mut problem.poses, &mut self.trial);
                summary.moved = true;
            }
            if let Some(termination) = self.converged(decrease, damping, summary, options) {
                summary.final_cost = summary.final_cost.min(cost);
                summary.termination = termination;
                return;
            }
            if better {
                summary.final_cost = cost;
                damping = relaxed(damping, gain);
                growth = 10.0;
                equations.linearise(&problem.factors, &problem.poses);
            } else {
                damping = raised(damping, growth);
                growth *= 2.0;
                if damping > DAMPING_MAX {
                    summary.termination = Termination::NoProgress;
                    return;
                }
            }
        }
    }

    /// Only an undamped step can tell: a damped one is short for another reason.
    fn converged(
        &self,
        decrease: f64,
        damping: f64,
        summary: &SolveSummary,
        options: &SolveOptions,
    ) -> Option<Termination> {
        if damping > DAMPING_MIN {
            return None;
        }
        if decrease <= options.cost_tolerance * summary.final_cost {
            return Some(Termination::ConvergedByCost);
        }
        let longest = self.step.iter().fold(0.0_f64, |max, s| max.max(s.abs()));
        (longest <= options.step_tolerance).then_some(Termination::ConvergedByStep)
    }
}

fn raised(damping: f64, growth: f64) -> f64 {
    (damping * growth).max(DAMPING_FIRST)
}

/// Nielsen's rule: the better the quadratic model was, the less damping.
fn relaxed(damping: f64, gain: f64) -> f64 {
    let factor = (1.0 - (2.0 * gain - 1.0).powi(3)).clamp(0.1, 2.0);
    let relaxed = damping * factor;
    if relaxed < DAMPING_DROPPED {
        DAMPING_MIN
    } else {
        relaxed
    }
}
