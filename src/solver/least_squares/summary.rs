//! Options and outcome of a solve, as data.

/// When a solve stops.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SolveOptions {
    /// The most steps that are tried.
    pub iterations_max: usize,
    /// Converged once the predicted decrease of a step is below this part of the cost.
    pub cost_tolerance: f64,
    /// Converged once no coordinate (metres, radians) moves more than this in a step.
    pub step_tolerance: f64,
}

impl Default for SolveOptions {
    fn default() -> Self {
        Self {
            iterations_max: 100,
            cost_tolerance: 1e-10,
            step_tolerance: 1e-10,
        }
    }
}

/// Why a solve stopped.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Termination {
    /// The predicted decrease of the cost was next to nothing.
    ConvergedByCost,
    /// The last step moved next to nothing.
    ConvergedByStep,
    /// No free pose has an edge, or there is no pose at all.
    NothingToSolve,
    /// The budget of iterations was used up; the best poses so far are kept.
    IterationLimit,
    /// Nobody waits for it any more, or it has taken all the multiplications that it may; the best poses so
    /// far are kept.
    Interrupted,
    /// No step, however short, lowered the cost; the best poses so far are kept.
    NoProgress,
    /// The equations could not be factored, however damped, or memory ran out.
    Unsolvable,
    /// The cost at the start is not finite; nothing was moved.
    NotFinite,
}

impl Termination {
    /// Whether the poses are an optimum to within the tolerances.
    pub fn is_converged(self) -> bool {
        matches!(
            self,
            Self::ConvergedByCost | Self::ConvergedByStep | Self::NothingToSolve
        )
    }

    /// A word for reports: `converged_by_cost`, `iteration_limit`, …
    pub fn name(self) -> &'static str {
        match self {
            Self::ConvergedByCost => "converged_by_cost",
            Self::ConvergedByStep => "converged_by_step",
            Self::NothingToSolve => "nothing_to_solve",
            Self::IterationLimit => "iteration_limit",
            Self::Interrupted => "interrupted",
            Self::NoProgress => "no_progress",
            Self::Unsolvable => "unsolvable",
            Self::NotFinite => "not_finite",
        }
    }
}

/// What a solve did.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SolveSummary {
    /// F = Σ eᵀΩe before, over the active edges that took part.
    pub initial_cost: f64,
    /// F after; never above the cost before.
    pub final_cost: f64,
    /// Steps tried, refused ones included.
    pub iterations: usize,
    /// Why it stopped.
    pub termination: Termination,
    /// Whether any pose was changed.
    pub moved: bool,
}

impl SolveSummary {
    /// Of no problem at all.
    pub(crate) fn nothing() -> Self {
        Self {
            initial_cost: 0.0,
            final_cost: 0.0,
            iterations: 0,
            termination: Termination::NothingToSolve,
            moved: false,
        }
    }

    /// Adds up costs and iterations; the worse termination counts.
    pub(crate) fn add(&mut self, other: &Self) {
        self.initial_cost += other.initial_cost;
        self.final_cost += other.final_cost;
        self.iterations += other.iterations;
        self.moved |= other.moved;
        let nothing = self.termination == Termination::NothingToSolve;
        if nothing || !other.termination.is_converged() {
            self.termination = other.termination;
        }
    }
}
