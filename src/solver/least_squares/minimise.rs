//! Gauss-Newton, with Levenberg-Marquardt damping where a plain step fails.

use super::normal_equations::{DAMPING_MIN, NormalEquations, POSE_SIZE};
use super::problem::{Known, Problem};
use super::summary::{SolveOptions, SolveSummary, Termination};
use crate::geometry::Pose2;
use crate::solver::factor::{
    Batch, Frame, append_to_batches, cost_and_gradient, dispatch, fill_batches, take_steps,
};
use crate::solver::interrupt::Interrupt;
use crate::solver::linear::QuasiNewton;

/// The first damping after a plain step has failed.
const DAMPING_FIRST: f64 = 1e-5;
/// Steps with more damping than this are negligible.
const DAMPING_MAX: f64 = 1e9;
/// This many plain steps in a row may end above the best cost: where residuals are large,
/// Gauss-Newton's path to the minimum crosses a ridge along which damped steps are slow.
const STEPS_ABOVE_BEST_MAX: usize = 4;
/// The factor is kept once a step's predicted decrease is below this part of the cost, …
const PREDICTED_SMALL: f64 = 1e-2;
/// … as long as that of every step by it is below this part of the one before, …
const PREDICTED_SHRINKS: f64 = 0.5;
/// … and the ratio of the decrease to the predicted one is between this and its inverse.
const GAIN_MIN: f64 = 0.25;
/// About how many multiplications' time a factor takes in a step: its error, its derivatives, its part
/// of the gradient and of the cost.
const OPERATIONS_OF_FACTOR: f64 = 100.0;
/// Damping below this is dropped, so that the final steps are plain Gauss-Newton.
const DAMPING_DROPPED: f64 = 1e-7;

/// The minimiser's memory, kept between solves; the symbolic factorisation is used again as
/// long as the structure does not change.
#[derive(Default)]
pub(crate) struct Minimiser {
    equations: Option<NormalEquations>,
    pairs: QuasiNewton,
    batches: Vec<Batch>,
    step: Vec<[f64; POSE_SIZE]>,
    here: Place,
    trial: Place,
    interrupt: Interrupt,
    /// How many multiplications all of its steps have taken.
    operations: f64,
    /// More than this it may not take; `None` if it may take any number.
    operations_max: Option<f64>,
}

/// Some poses with F and its derivatives there.
#[derive(Default)]
struct Place {
    frames: Vec<Frame>,
    cost: f64,
    gradient: Vec<[f64; POSE_SIZE]>,
}

/// The state of the descent.
struct Descent {
    damping: f64,
    damping_factor: f64,
    /// Plain steps since the best cost.
    steps_above_best: usize,
    /// The predicted decrease of the last step, if it was a plain one.
    last_predicted: Option<f64>,
    /// Whether the next step is taken by the factor as it is: cheaper by far, and as good while
    /// the quadratic model holds.
    keep_factor: bool,
    /// Whether the poses were at their optimum before the extension.
    is_extension: bool,
}

impl Minimiser {
    /// A minimiser that stops at the current poses once this is raised.
    pub(crate) fn heeding(interrupt: &Interrupt) -> Self {
        Self {
            interrupt: interrupt.clone(),
            ..Self::default()
        }
    }

    /// From now on it ends where it is once its steps have taken so many multiplications.
    pub(crate) fn allow(&mut self, operations_max: f64) {
        self.operations_max = Some(self.operations + operations_max);
    }

    /// How many multiplications all of its steps have taken.
    pub(crate) fn operations(&self) -> f64 {
        self.operations
    }

    /// Whether it has taken all the multiplications that it was allowed.
    pub(crate) fn is_exhausted(&self) -> bool {
        self.operations_max
            .is_some_and(|most| self.operations >= most)
    }

    /// Moves the poses that are not held to a minimum of the cost.
    pub(crate) fn minimise(
        &mut self,
        problem: &mut Problem,
        options: &SolveOptions,
    ) -> SolveSummary {
        fill_batches(&problem.factors, &mut self.batches);
        self.here.set(&problem.poses, &self.batches);
        if !self.equations.as_ref().is_some_and(|e| e.fit(problem)) {
            self.equations = NormalEquations::new(problem, false);
        }
        self.descend_from_here(Descent::plain(), problem, options)
    }

    /// The same for a problem that is minimised once: its factors are dropped on the way, to make
    /// room.
    pub(crate) fn minimise_once(problem: &mut Problem, options: &SolveOptions) -> SolveSummary {
        let mut minimiser = Self::default();
        fill_batches(&problem.factors, &mut minimiser.batches);
        minimiser.here.set(&problem.poses, &minimiser.batches);
        let equations = NormalEquations::of_structure(problem, false);
        problem.factors = Vec::new();
        minimiser.equations = equations.map(NormalEquations::analysed);
        minimiser.descend_from_here(Descent::plain(), problem, options)
    }

    /// The same for a problem that grows: it had `known` poses and factors when it was
    /// minimised last. That the optimum found before is close to the next is what makes this
    /// fast, not right.
    pub(crate) fn minimise_more(
        &mut self,
        problem: &mut Problem,
        known: Known,
        options: &SolveOptions,
    ) -> SolveSummary {
        let mut descent = Descent::plain();
        let in_batches = match self.equations {
            Some(_) => known.factors,
            None => 0,
        };
        if in_batches == 0 {
            self.batches.clear();
        }
        append_to_batches(
            &problem.factors[in_batches..],
            in_batches,
            &mut self.batches,
        );
        descent.is_extension = in_batches > 0 && self.here.is_at(&problem.poses[..known.poses]);
        if descent.is_extension {
            self.here.grow(problem, known);
        } else {
            self.here.set(&problem.poses, &self.batches);
        }
        let mut equations = self.equations.take().filter(|_| in_batches > 0);
        equations = equations.and_then(|mut e| {
            e.grow(problem, &self.batches, &self.here.frames)
                .then_some(e)
        });
        descent.keep_factor = equations
            .as_ref()
            .is_some_and(NormalEquations::has_plain_factor);
        self.equations = equations.or_else(|| NormalEquations::new(problem, true));
        self.descend_from_here(descent, problem, options)
    }

    fn descend_from_here(
        &mut self,
        descent: Descent,
        problem: &mut Problem,
        options: &SolveOptions,
    ) -> SolveSummary {
        let initial_cost = self.here.cost;
        let mut summary = SolveSummary {
            initial_cost,
            final_cost: initial_cost,
            iterations: 0,
            termination: Termination::NothingToSolve,
            moved: false,
        };
        if !initial_cost.is_finite() {
            summary.termination = Termination::NotFinite;
            self.equations = None;
            return summary;
        }
        match self.equations.take() {
            None => summary.termination = Termination::Unsolvable,
            Some(equations) if equations.dimension() == 0 => {}
            Some(mut equations) => {
                summary.termination =
                    self.descend(&mut equations, descent, problem, options, &mut summary);
                self.equations = Some(equations);
            }
        }
        summary
    }

    /// The equations of a problem that was minimised just now, factored near its poses without
    /// damping; `None` if that cannot be done.
    pub(crate) fn factored(&mut self, problem: &Problem) -> Option<&mut NormalEquations> {
        let equations = self.equations.as_mut()?;
        if !equations.has_plain_factor() {
            self.here.set(&problem.poses, &self.batches);
            equations.linearise(&self.batches, &self.here.frames);
            equations.factorise(DAMPING_MIN);
        }
        Some(equations).filter(|e| e.has_plain_factor())
    }

    /// `problem.poses` and `summary.final_cost` are always the best so far.
    fn descend(
        &mut self,
        equations: &mut NormalEquations,
        mut descent: Descent,
        problem: &mut Problem,
        options: &SolveOptions,
        summary: &mut SolveSummary,
    ) -> Termination {
        self.pairs.clear();
        while summary.iterations < options.iterations_max {
            if self.interrupt.is_raised() || self.is_exhausted() {
                return Termination::Interrupted;
            }
            let predicted =
                self.predicted_decrease(equations, &mut descent, options, summary.final_cost);
            self.operations += equations.take_operations();
            self.operations += OPERATIONS_OF_FACTOR * problem.factors.len() as f64;
            let is_best = self.here.cost <= summary.final_cost;
            if let Some(decrease) = predicted
                && descent.damping <= DAMPING_MIN
                && is_best
                && decrease <= options.cost_tolerance * summary.final_cost
            {
                return Termination::ConvergedByCost;
            }
            summary.iterations += 1;
            let predicted = predicted.inspect(|_| equations.step(&mut self.pairs, &mut self.step));
            if predicted.is_some() {
                self.trial.step(&self.here, &self.step, &self.batches);
            } else {
                self.trial.cost = f64::INFINITY;
            }
            let cost = self.trial.cost;
            let gain = predicted.map_or(0.0, |decrease| (self.here.cost - cost) / decrease);
            let better = cost < summary.final_cost;
            if better {
                problem.poses.clear();
                let frames = self.trial.frames.iter();
                problem.poses.extend(frames.map(|frame| frame.pose));
                summary.final_cost = cost;
                summary.moved = true;
            }
            if let Some(termination) =
                predicted.and_then(|d| self.converged(d, cost, &descent, summary, options))
            {
                if better {
                    std::mem::swap(&mut self.here, &mut self.trial);
                }
                return termination;
            }
            if descent.accepts(better, cost, gain, predicted) {
                std::mem::swap(&mut self.here, &mut self.trial);
            } else if descent.damping > DAMPING_MAX {
                return match predicted {
                    None => Termination::Unsolvable,
                    Some(_) => Termination::NoProgress,
                };
            } else {
                self.here.set(&problem.poses, &self.batches);
            }
        }
        Termination::IterationLimit
    }

    /// The predicted decrease of the step from here; `None` if the equations cannot be solved.
    fn predicted_decrease(
        &mut self,
        equations: &mut NormalEquations,
        descent: &mut Descent,
        options: &SolveOptions,
        cost: f64,
    ) -> Option<f64> {
        equations.set_gradient(&self.here.gradient);
        let is_extension = std::mem::take(&mut descent.is_extension);
        let mut predicted = f64::NAN;
        if descent.keep_factor {
            if is_extension {
                predicted = equations.predicted_decrease_of_extension();
            }
            // Only the whole gradient can tell that there is nothing to do.
            let is_enough = predicted > options.cost_tolerance * cost;
            if !is_enough {
                self.pairs.learn(equations.gradient());
                predicted = equations.predicted_decrease(&mut self.pairs);
            }
        } else {
            self.pairs.clear();
            if descent.damping <= DAMPING_MIN && equations.can_be_refreshed() {
                if equations.refresh(&self.batches, &self.here.frames) {
                    predicted = equations.predicted_decrease(&mut self.pairs);
                }
            } else {
                equations.linearise(&self.batches, &self.here.frames);
                if equations.factorise(descent.damping) {
                    predicted = equations.fresh_predicted_decrease();
                }
            }
        }
        predicted.is_finite().then_some(predicted)
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
        let is_short = |s: &f64| s.abs() <= options.step_tolerance;
        let all_are_short = self.step.iter().flatten().all(is_short);
        all_are_short.then_some(Termination::ConvergedByStep)
    }
}

impl Place {
    fn set(&mut self, poses: &[Pose2], batches: &[Batch]) {
        self.frames.clear();
        self.frames
            .extend(poses.iter().map(|&pose| Frame::of(pose)));
        self.evaluate(batches);
    }

    /// Moves to the poses after a step.
    fn step(&mut self, from: &Self, step: &[[f64; POSE_SIZE]], batches: &[Batch]) {
        take_steps(&from.frames, step, &mut self.frames);
        self.evaluate(batches);
    }

    fn evaluate(&mut self, batches: &[Batch]) {
        self.gradient.clear();
        self.cost = 0.0;
        self.add(batches);
    }

    /// Adds these factors' parts of the cost and the gradient.
    fn add(&mut self, batches: &[Batch]) {
        self.gradient.resize(self.frames.len(), [0.0; POSE_SIZE]);
        self.cost += dispatch(
            #[inline(always)]
            || cost_and_gradient(batches, &self.frames, &mut self.gradient),
        );
    }

    /// Whether the first poses are these, to the bit.
    fn is_at(&self, poses: &[Pose2]) -> bool {
        let here = self.frames.iter().map(|frame| frame.pose);
        self.frames.len() == poses.len() && here.eq(poses.iter().copied())
    }

    /// Takes in a problem's new poses and factors.
    fn grow(&mut self, problem: &Problem, known: Known) {
        let new = problem.poses[known.poses..].iter();
        self.frames.extend(new.map(|&pose| Frame::of(pose)));
        let mut batches = Vec::new();
        fill_batches(&problem.factors[known.factors..], &mut batches);
        self.add(&batches);
    }
}

impl Descent {
    fn plain() -> Self {
        Self {
            damping: DAMPING_MIN,
            damping_factor: 10.0,
            steps_above_best: 0,
            last_predicted: None,
            keep_factor: false,
            is_extension: false,
        }
    }

    /// Whether to continue from the trial poses, or from the best; sets the damping either way.
    fn accepts(&mut self, better: bool, cost: f64, gain: f64, predicted: Option<f64>) -> bool {
        let plain = self.damping <= DAMPING_MIN;
        if better {
            // Nielsen's rule: the better the quadratic model was, the less damping.
            let factor = (1.0 - (2.0 * gain - 1.0).powi(3)).clamp(0.1, 2.0);
            let relaxed = self.damping * factor;
            let decrease = predicted.unwrap_or(f64::INFINITY);
            let is_near = match self.last_predicted {
                Some(last) if self.keep_factor => decrease < PREDICTED_SHRINKS * last,
                None if self.keep_factor => true,
                _ => decrease < PREDICTED_SMALL * cost,
            };
            *self = Self {
                last_predicted: predicted.filter(|_| plain),
                keep_factor: plain && is_near && (GAIN_MIN..=1.0 / GAIN_MIN).contains(&gain),
                ..Self::plain()
            };
            if relaxed >= DAMPING_DROPPED {
                self.damping = relaxed;
            }
            return true;
        }
        self.last_predicted = None;
        if std::mem::take(&mut self.keep_factor) {
            return false;
        }
        if plain && cost.is_finite() && self.steps_above_best < STEPS_ABOVE_BEST_MAX {
            self.steps_above_best += 1;
            return true;
        }
        self.damping = (self.damping * self.damping_factor).max(DAMPING_FIRST);
        self.damping_factor *= 2.0;
        self.steps_above_best = 0;
        false
    }
}
