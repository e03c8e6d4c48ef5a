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
/// So many plain steps in a row may end above the best cost: where residuals are large,
/// Gauss-Newton's way to the minimum leads over a ridge that damped steps creep along.
const STEPS_ABOVE_BEST_MAX: usize = 4;
/// Damping below this is dropped, so that the end game is plain Gauss-Newton.
const DAMPING_DROPPED: f64 = 1e-7;

/// The minimiser's memory, kept between solves; the symbolic factorisation is used again as
/// long as the structure stands.
#[derive(Default)]
pub(super) struct Minimiser {
    equations: Option<NormalEquations>,
    step: Vec<f64>,
    poses: Vec<Pose2>,
    trial: Vec<Pose2>,
}

/// Where the descent is: the damping, and how far it has strayed from the best poses.
struct Descent {
    damping: f64,
    growth: f64,
    steps_above_best: usize,
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
                summary.termination = self.descend(&mut equations, problem, options, &mut summary);
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

    /// `problem.poses` and `summary.final_cost` are always the best so far.
    fn descend(
        &mut self,
        equations: &mut NormalEquations,
        problem: &mut Problem,
        options: &SolveOptions,
        summary: &mut SolveSummary,
    ) -> Termination {
        let mut descent = Descent::plain();
        self.poses.clone_from(&problem.poses);
        let mut cost_here = summary.final_cost;
        equations.linearise(&problem.factors, &self.poses);
        while summary.iterations < options.iterations_max {
            summary.iterations += 1;
            let promised = if equations.factorise(descent.damping) {
                equations.step(&mut self.step)
            } else {
                None
            };
            let (cost, gain) = match promised {
                None => (f64::INFINITY, 0.0),
                Some(decrease) => {
                    equations.apply(&self.poses, &self.step, &mut self.trial);
                    let cost = problem.cost_at(&self.trial);
                    (cost, (cost_here - cost) / decrease)
                }
            };
            let better = cost < summary.final_cost;
            if better {
                problem.poses.clone_from(&self.trial);
                summary.final_cost = cost;
                summary.moved = true;
            }
            if let Some(termination) =
                promised.and_then(|d| self.converged(d, cost, &descent, summary, options))
            {
                return termination;
            }
            if descent.accepts(better, cost, gain) {
                std::mem::swap(&mut self.poses, &mut self.trial);
                cost_here = cost;
                equations.linearise(&problem.factors, &self.poses);
            } else {
                if descent.damping > DAMPING_MAX {
                    return match promised {
                        None => Termination::Unsolvable,
                        Some(_) => Termination::NoProgress,
                    };
                }
                if cost_here > summary.final_cost {
                    self.poses.clone_from(&problem.poses);
                    cost_here = summary.final_cost;
                    equations.linearise(&problem.factors, &self.poses);
                }
            }
        }
        Termination::IterationLimit
    }

    /// Only a plain step that ends at the best cost can tell: a damped one is short for another
    /// reason.
    fn converged(
        &self,
        decrease: f64,
        cost: f64,
        descent: &Descent,
        summary: &SolveSummary,
        options: &SolveOptions,
    ) -> Option<Termination> {
        let rounding = 1e-12 * summary.final_cost;
        if descent.damping > DAMPING_MIN || cost > summary.final_cost + rounding.max(decrease) {
            return None;
        }
        if decrease <= options.cost_tolerance * summary.final_cost {
            return Some(Termination::ConvergedByCost);
        }
        let longest = self.step.iter().fold(0.0_f64, |max, s| max.max(s.abs()));
        (longest <= options.step_tolerance).then_some(Termination::ConvergedByStep)
    }
}

impl Descent {
    fn plain() -> Self {
        Self {
            damping: DAMPING_MIN,
            growth: 10.0,
            steps_above_best: 0,
        }
    }

    /// Whether to go on from the trial poses; sets the next damping either way.
    fn accepts(&mut self, better: bool, cost: f64, gain: f64) -> bool {
        if better {
            // Nielsen's rule: the better the quadratic model was, the less damping.
            let factor = (1.0 - (2.0 * gain - 1.0).powi(3)).clamp(0.1, 2.0);
            let relaxed = self.damping * factor;
            *self = Self::plain();
            if relaxed >= DAMPING_DROPPED {
                self.damping = relaxed;
            }
            return true;
        }
        let plain = self.damping <= DAMPING_MIN;
        if plain && cost.is_finite() && self.steps_above_best < STEPS_ABOVE_BEST_MAX {
            self.steps_above_best += 1;
            return true;
        }
        self.damping = (self.damping * self.growth).max(DAMPING_FIRST);
        self.growth *= 2.0;
        self.steps_above_best = 0;
        false
    }
}
