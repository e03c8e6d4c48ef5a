//! H = Σ JᵀΩJ and g = Σ JᵀΩe of a problem, and their solution.

mod inverse;
mod relinearise;

use super::problem::Problem;
use crate::geometry::Vector3;
use crate::solver::factor::{Batch, BlocksOfOne, Factor, Frame, LANES, Motions, dispatch};
use crate::solver::linear::{BlockCholesky, BlockMatrix, QuasiNewton, dot};

/// The coordinates of a pose.
pub(crate) const POSE_SIZE: usize = 3;
/// Always added, relative to the diagonal: directions that no edge measures keep a pivot well
/// above rounding, and Gauss-Newton's convergence does not notice.
pub(crate) const DAMPING_MIN: f64 = 1e-11;
/// No variable, no pair.
const NONE: u32 = u32::MAX;

/// The normal equations of the poses that are not held, for steps in the poses' own frames. The
/// structure (which poses, which pairs) is analysed once; the numbers may be filled in again and
/// again.
pub(crate) struct NormalEquations {
    /// For each pose of the problem its variable.
    variable: Vec<u32>,
    /// For each factor of the problem.
    slots: Vec<Slot>,
    matrix: BlockMatrix<POSE_SIZE>,
    /// For each pair of the matrix its factor.
    factor_of_pair: Vec<u32>,
    gradient: Vec<f64>,
    /// The right-hand side while it is solved, from the gradient to the step.
    solution: Vec<f64>,
    cholesky: BlockCholesky<POSE_SIZE>,
    grows: bool,
    /// Where the factors were linearised, if the problem is to grow.
    linearised: Vec<Motions>,
    /// The variables that the last extension of the problem touched.
    touched: Vec<u32>,
    /// Whether there is a factor of H at some poses, without damping.
    has_plain_factor: bool,
}

/// Where a factor's parts of H are: its ends' variables, and their pair.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Slot {
    from: u32,
    to: u32,
    pair: u32,
}

impl NormalEquations {
    /// Orders and analyses a problem's structure; `None` if memory runs out. If it is to grow,
    /// its factorisation takes more memory.
    pub(crate) fn new(problem: &Problem, grows: bool) -> Option<Self> {
        Self::of_structure(problem, grows).map(Self::analysed)
    }

    /// The first half of [`Self::new`]: afterwards the problem is needed no more.
    pub(crate) fn of_structure(problem: &Problem, grows: bool) -> Option<Self> {
        let mut equations = Self {
            variable: vec![NONE; problem.poses.len()],
            slots: Vec::with_capacity(problem.factors.len()),
            matrix: BlockMatrix::default(),
            factor_of_pair: Vec::new(),
            gradient: Vec::new(),
            solution: Vec::new(),
            cholesky: BlockCholesky::empty(grows),
            grows,
            linearised: Vec::new(),
            touched: Vec::new(),
            has_plain_factor: false,
        };
        let order = problem.elimination_order()?;
        equations.matrix.reserve(order.len(), problem.factors.len());
        for pose in order {
            equations.variable[pose] = equations.matrix.add_variable();
        }
        equations.add_slots(&problem.factors);
        Some(equations)
    }

    /// The second half.
    pub(crate) fn analysed(mut self) -> Self {
        self.cholesky = BlockCholesky::analyse(&self.matrix, self.grows);
        self
    }

    fn add_slots(&mut self, factors: &[Factor]) {
        for factor in factors {
            let (from, to) = (self.variable[factor.from], self.variable[factor.to]);
            let mut pair = NONE;
            if from != NONE && to != NONE {
                pair = self.matrix.add_pair(from, to);
                self.factor_of_pair.push(self.slots.len() as u32);
            }
            self.slots.push(Slot { from, to, pair });
        }
        self.gradient
            .resize(self.matrix.variables() * POSE_SIZE, 0.0);
    }

    /// Whether a problem has the structure that these equations have.
    pub(crate) fn fit(&self, problem: &Problem) -> bool {
        let is_free = |&variable: &u32| variable != NONE;
        let fits = |(slot, factor): (&Slot, &Factor)| {
            let ends = (self.variable[factor.from], self.variable[factor.to]);
            (slot.from, slot.to) == ends
        };
        self.slots.len() == problem.factors.len()
            && self.variable.iter().map(is_free).eq(problem.free())
            && self.slots.iter().zip(&problem.factors).all(fits)
    }

    /// How many multiplications steps have taken since this was asked last.
    pub(crate) fn take_operations(&mut self) -> f64 {
        self.cholesky.take_operations()
    }

    /// The number of unknown scalars.
    pub(crate) fn dimension(&self) -> usize {
        self.gradient.len()
    }

    /// Where a pose's first coordinate stands in a right-hand side; `None` if it is held.
    pub(crate) fn offset(&self, pose: usize) -> Option<usize> {
        let variable = self.variable[pose];
        (variable != NONE).then_some(variable as usize * POSE_SIZE)
    }

    /// Fills in H at these poses; the batches hold the problem's factors.
    pub(crate) fn linearise(&mut self, batches: &[Batch], frames: &[Frame]) {
        self.has_plain_factor = false;
        self.matrix.clear_diagonal();
        self.linearised.clear();
        let slots = std::mem::take(&mut self.slots);
        dispatch(
            #[inline(always)]
            || {
                for (batch, slots) in batches.iter().zip(slots.chunks(LANES)) {
                    let motions = batch.motions(frames);
                    let blocks = batch.blocks(&motions);
                    for (lane, &slot) in slots.iter().enumerate() {
                        self.add_blocks(slot, &blocks.of(lane));
                    }
                    if self.grows {
                        self.linearised.push(motions);
                    }
                }
            },
        );
        self.slots = slots;
    }

    /// Adds a factor's parts to H.
    #[inline(always)]
    fn add_blocks(&mut self, slot: Slot, blocks: &BlocksOfOne) {
        self.add_to_diagonal(slot, blocks, 1.0);
        if slot.pair != NONE {
            self.matrix.blocks[slot.pair as usize].data.0 = blocks.from_to;
        }
    }

    /// Adds a multiple of a factor's parts to its ends' diagonal blocks.
    #[inline(always)]
    fn add_to_diagonal(&mut self, slot: Slot, blocks: &BlocksOfOne, times: f64) {
        let ends = [(slot.from, &blocks.from_from), (slot.to, &blocks.to_to)];
        for (variable, block) in ends {
            if variable != NONE {
                let to = &mut self.matrix.diagonal[variable as usize].data.0;
                for (to, block) in to.iter_mut().flatten().zip(block.iter().flatten()) {
                    *to += times * block;
                }
            }
        }
    }

    /// Takes over a gradient that is given by poses.
    pub(crate) fn set_gradient(&mut self, of_poses: &[[f64; POSE_SIZE]]) {
        let gradient = self.gradient.as_chunks_mut::<POSE_SIZE>().0;
        for (&variable, of_pose) in self.variable.iter().zip(of_poses) {
            if variable != NONE {
                gradient[variable as usize] = *of_pose;
            }
        }
    }

    /// g as it was given last.
    pub(crate) fn gradient(&self) -> &[f64] {
        &self.gradient
    }

    /// Factors H + λD, where D is H's diagonal, raised where it is next to nothing; `false`
    /// if that is not positive definite. What [`Self::predicted_decrease`] would do is done on the way.
    pub(crate) fn factorise(&mut self, damping: f64) -> bool {
        self.solution.clear();
        self.solution.extend(self.gradient.iter().map(|g| -g));
        let is_done = self
            .cholesky
            .factorise(&self.matrix, damping, &mut self.solution);
        self.has_plain_factor = is_done && damping <= DAMPING_MIN;
        is_done
    }

    /// Whether the last factor is of H, not far from the poses that were asked for last.
    pub(crate) fn has_plain_factor(&self) -> bool {
        self.has_plain_factor
    }

    /// Whether parts of the last factor may be brought up to date.
    pub(crate) fn can_be_refreshed(&self) -> bool {
        self.grows && self.has_plain_factor
    }

    /// The predicted decrease of the cost by the step after a factorisation.
    pub(crate) fn fresh_predicted_decrease(&self) -> f64 {
        dot(&self.solution, &self.solution)
    }

    /// The forward half of the solve for the step by the last factor, corrected by the quasi-Newton
    /// pairs; enough to predict the decrease of the cost.
    pub(crate) fn predicted_decrease(&mut self, pairs: &mut QuasiNewton) -> f64 {
        self.solution.clear();
        self.solution.extend(self.gradient.iter().map(|g| -g));
        let of_pairs = pairs.before_solve(&mut self.solution);
        self.cholesky.solve_lower(&mut self.solution);
        of_pairs + dot(&self.solution, &self.solution)
    }

    /// The backward half: the step −(H + λD)⁻¹ g, three numbers for each pose.
    pub(crate) fn step(&mut self, pairs: &mut QuasiNewton, step: &mut Vec<[f64; POSE_SIZE]>) {
        self.cholesky.solve_upper(&mut self.solution);
        pairs.after_solve(&mut self.solution);
        pairs.take(&self.solution, &self.gradient);
        step.clear();
        let solution = self.solution.as_chunks::<POSE_SIZE>().0;
        let of_pose = |&variable: &u32| solution.get(variable as usize).copied();
        let steps = self.variable.iter().map(of_pose);
        step.extend(steps.map(Option::unwrap_or_default));
    }

    /// L⁻¹ times some columns, one after the other, by the last factor H = LLᵀ: each column has
    /// parts at two poses, of which those that are held are passed over. All have the same rows,
    /// those between the poses and the root; the rest of them are zero.
    pub(crate) fn solve_lower(&mut self, columns: &[[(usize, Vector3<f64>); 2]]) -> Vec<f64> {
        let parts = || columns.iter().flatten();
        let variables = parts().map(|&(pose, _)| self.variable[pose]);
        let path = self.cholesky.path_of(variables.filter(|&v| v != NONE));
        let rows = self.cholesky.variables_of(&path);
        let rows: Vec<usize> = rows.map(|v| v as usize * POSE_SIZE).collect();
        let (mut x, mut solved) = (vec![0.0; self.dimension()], Vec::new());
        for column in columns {
            for (pose, part) in column {
                if let Some(at) = self.offset(*pose) {
                    x[at..at + POSE_SIZE].copy_from_slice(part.as_slice());
                }
            }
            self.cholesky.solve_lower_along(&path, &mut x);
            for &row in &rows {
                solved.extend_from_slice(&x[row..row + POSE_SIZE]);
                x[row..row + POSE_SIZE].fill(0.0);
            }
        }
        solved
    }

    /// H⁻¹ times some columns, one after the other, by the last factor.
    pub(crate) fn solve(&mut self, columns: &mut [f64]) {
        for column in columns.chunks_exact_mut(self.dimension().max(1)) {
            self.cholesky.solve(column);
        }
    }
}
