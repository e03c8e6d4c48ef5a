//! H = Σ JᵀΩJ and g = Σ JᵀΩe of a problem, and their solution.

use pulp::Arch;

use super::block_matrix::BlockMatrix;
use super::cholesky::BlockCholesky;
use super::local_error::Frame;
use super::packs::{BlocksOfOne, LANES, Pack};
use super::problem::{Factor, Problem};
use super::secants::{Secants, dot};
use crate::geometry::{Information, Pose2, Vector3};

/// The coordinates of a pose.
pub(super) const POSE_SIZE: usize = 3;
/// No variable, no pair.
const NONE: u32 = u32::MAX;

/// The normal equations of the poses that are not held, for steps in the poses' own frames. The
/// structure (which poses, which pairs) is analysed once; the numbers may be filled in again and
/// again.
pub(super) struct NormalEquations {
    /// For each pose of the problem its variable.
    variable: Vec<u32>,
    /// For each factor of the problem.
    slots: Vec<Slot>,
    matrix: BlockMatrix<POSE_SIZE>,
    gradient: Vec<f64>,
    /// What is solved for, on its way from the gradient to the step.
    solution: Vec<f64>,
    cholesky: BlockCholesky<POSE_SIZE>,
    /// By a pose's name its variable, and by a factor's name its place among the known ones.
    variable_of_name: Vec<u32>,
    known_of_name: Vec<u32>,
    known: Vec<Slot>,
    /// For each known factor what was linearised, if the problem is to grow.
    numbers: Vec<Numbers>,
    grows: bool,
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

/// What a factor's part of H was made from, but for the poses.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Numbers {
    measurement: Pose2,
    information: Information,
    weight: f64,
}

/// How a problem compares with the one that the equations were made for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Fit {
    /// It is of another structure: the equations are of no use.
    Other,
    /// Its numbers are others.
    Structure,
    /// It is the same, or has more poses and factors, and H is factored at some poses.
    Factor,
}

impl NormalEquations {
    /// Orders and analyses a problem's structure; `None` if memory runs out. If it is to grow,
    /// its factorisation takes more memory.
    pub(super) fn new(problem: &Problem, grows: bool) -> Option<Self> {
        let mut equations = Self {
            variable: Vec::new(),
            slots: Vec::new(),
            gradient: Vec::new(),
            solution: Vec::new(),
            cholesky: BlockCholesky::empty(grows),
            matrix: BlockMatrix::default(),
            variable_of_name: Vec::new(),
            known_of_name: Vec::new(),
            known: Vec::new(),
            numbers: Vec::new(),
            grows,
            has_plain_factor: false,
        };
        let names = problem.pose_names.iter().max().map_or(0, |&name| name + 1);
        equations.variable_of_name.resize(names, NONE);
        for pose in problem.elimination_order()? {
            let name = problem.pose_names[pose];
            equations.variable_of_name[name] = equations.matrix.add_variable();
        }
        equations.take_in(problem);
        equations.cholesky = BlockCholesky::analyse(&equations.matrix, grows);
        Some(equations)
    }

    /// Adds what a problem has and the equations have not; the variables and factors that are
    /// new. Known factors must have the slots that they had.
    fn take_in(&mut self, problem: &Problem) -> (Vec<u32>, Vec<usize>) {
        let (mut new_variables, mut new_factors) = (Vec::new(), Vec::new());
        let free = problem.free();
        self.variable.clear();
        for (&name, &free) in problem.pose_names.iter().zip(&free) {
            if self.variable_of_name.len() <= name {
                self.variable_of_name.resize(name + 1, NONE);
            }
            let variable = &mut self.variable_of_name[name];
            if free && *variable == NONE {
                *variable = self.matrix.add_variable();
                new_variables.push(*variable);
            }
            self.variable.push(if free { *variable } else { NONE });
        }
        self.gradient
            .resize(self.matrix.variables() * POSE_SIZE, 0.0);
        self.slots.clear();
        for (k, (&name, factor)) in problem
            .factor_names
            .iter()
            .zip(&problem.factors)
            .enumerate()
        {
            if self.known_of_name.len() <= name {
                self.known_of_name.resize(name + 1, NONE);
            }
            let known = self.known_of_name[name];
            if known != NONE {
                self.slots.push(self.known[known as usize]);
                continue;
            }
            let (from, to) = (self.variable[factor.from], self.variable[factor.to]);
            let pair = if from != NONE && to != NONE {
                self.matrix.add_pair(from, to)
            } else {
                NONE
            };
            let slot = Slot { from, to, pair };
            self.known_of_name[name] = self.known.len() as u32;
            self.known.push(slot);
            if self.grows {
                self.numbers.push(Numbers::of(factor));
            }
            self.slots.push(slot);
            new_factors.push(k);
        }
        (new_variables, new_factors)
    }

    /// Makes the equations those of a problem, if it has the structure that they have, or that
    /// and more.
    pub(super) fn adapt(&mut self, problem: &Problem) -> Fit {
        let Some(numbers_are_same) = self.contains_known(problem) else {
            return Fit::Other;
        };
        let (new_variables, new_factors) = self.take_in(problem);
        if new_variables.is_empty() && new_factors.is_empty() {
            return if numbers_are_same && self.has_plain_factor {
                Fit::Factor
            } else {
                Fit::Structure
            };
        }
        let mut touched = new_variables;
        for &k in &new_factors {
            touched.extend([self.slots[k].from, self.slots[k].to]);
        }
        touched.retain(|&variable| variable != NONE);
        touched.sort_unstable();
        touched.dedup();
        let Some(fronts) = self.cholesky.extend(&self.matrix, &touched) else {
            return Fit::Other;
        };
        if !(numbers_are_same && self.has_plain_factor) {
            self.has_plain_factor = false;
            return Fit::Structure;
        }
        for &k in &new_factors {
            let factor = &problem.factors[k];
            let ends = [factor.from, factor.to].map(|pose| Frame::of(problem.poses[pose]));
            let alone = Factor {
                from: 0,
                to: 1,
                ..*factor
            };
            let blocks = Pack::of_one(&alone).blocks(&ends).of(0);
            self.add_blocks(self.slots[k], &blocks);
        }
        let damping = super::minimise::DAMPING_MIN;
        self.has_plain_factor = self
            .cholesky
            .factorise_fronts(&fronts, &self.matrix, damping);
        if self.has_plain_factor {
            Fit::Factor
        } else {
            Fit::Structure
        }
    }

    /// Whether all that is known is in the problem, with the same poses held, and then whether
    /// it has the same numbers.
    fn contains_known(&self, problem: &Problem) -> Option<bool> {
        let free = problem.free();
        let mut variables = 0;
        let variable = |pose: usize| {
            let name = problem.pose_names[pose];
            self.variable_of_name.get(name).copied().unwrap_or(NONE)
        };
        for (pose, &free) in free.iter().enumerate() {
            if variable(pose) != NONE {
                variables += 1;
                if !free {
                    return None;
                }
            }
        }
        let (mut factors, mut numbers_are_same) = (0, true);
        for (&name, factor) in problem.factor_names.iter().zip(&problem.factors) {
            let known = self.known_of_name.get(name).copied().unwrap_or(NONE);
            if known == NONE {
                continue;
            }
            let slot = self.known[known as usize];
            let known_or_held = |pose: usize| if free[pose] { variable(pose) } else { NONE };
            let ends = (known_or_held(factor.from), known_or_held(factor.to));
            if ends != (slot.from, slot.to)
                || (slot.from == NONE && free[factor.from])
                || (slot.to == NONE && free[factor.to])
            {
                return None;
            }
            factors += 1;
            let numbers = self.numbers.get(known as usize);
            numbers_are_same &= numbers.is_some_and(|known| *known == Numbers::of(factor));
        }
        let is_all = variables == self.matrix.variables() && factors == self.known.len();
        is_all.then_some(numbers_are_same)
    }

    /// The number of unknown scalars.
    pub(super) fn dimension(&self) -> usize {
        self.gradient.len()
    }

    /// Where a pose's first coordinate stands in a right-hand side; `None` if it is held.
    pub(super) fn offset(&self, pose: usize) -> Option<usize> {
        let variable = self.variable[pose];
        (variable != NONE).then_some(variable as usize * POSE_SIZE)
    }

    /// Fills in H at these poses; the packs hold the problem's factors.
    pub(super) fn linearise(&mut self, problem: &Problem, packs: &[Pack], frames: &[Frame]) {
        self.has_plain_factor = false;
        self.matrix.clear_diagonal();
        let slots = std::mem::take(&mut self.slots);
        Arch::new().dispatch(
            #[inline(always)]
            || {
                for (pack, slots) in packs.iter().zip(slots.chunks(LANES)) {
                    let blocks = pack.blocks(frames);
                    for (lane, &slot) in slots.iter().enumerate() {
                        self.add_blocks(slot, &blocks.of(lane));
                    }
                }
            },
        );
        self.slots = slots;
        if self.grows {
            for (&name, factor) in problem.factor_names.iter().zip(&problem.factors) {
                self.numbers[self.known_of_name[name] as usize] = Numbers::of(factor);
            }
        }
    }

    /// Adds a factor's parts to H.
    #[inline(always)]
    fn add_blocks(&mut self, slot: Slot, blocks: &BlocksOfOne) {
        let ends = [(slot.from, &blocks.from_from), (slot.to, &blocks.to_to)];
        for (variable, block) in ends {
            if variable != NONE {
                add_block(&mut self.matrix.diagonal[variable as usize].data.0, block);
            }
        }
        if slot.pair != NONE {
            self.matrix.blocks[slot.pair as usize].data.0 = blocks.from_to;
        }
    }

    /// Takes over a gradient that is given by poses.
    pub(super) fn set_gradient(&mut self, of_poses: &[[f64; POSE_SIZE]]) {
        let gradient = self.gradient.as_chunks_mut::<POSE_SIZE>().0;
        for (&variable, of_pose) in self.variable.iter().zip(of_poses) {
            if variable != NONE {
                gradient[variable as usize] = *of_pose;
            }
        }
    }

    /// g as it was given last.
    pub(super) fn gradient(&self) -> &[f64] {
        &self.gradient
    }

    /// Factors H + λD, where D is H's diagonal, raised where it is next to nothing; `false`
    /// if that is not positive definite. What [`Self::promise`] would do comes along.
    pub(super) fn factorise(&mut self, damping: f64) -> bool {
        self.solution.clear();
        self.solution.extend(self.gradient.iter().map(|g| -g));
        let is_done = self
            .cholesky
            .factorise(&self.matrix, damping, &mut self.solution);
        self.has_plain_factor = is_done && damping <= super::minimise::DAMPING_MIN;
        is_done
    }

    /// Whether the last factor is of H, not far from the poses that were asked for last.
    pub(super) fn has_plain_factor(&self) -> bool {
        self.has_plain_factor
    }

    /// The decrease of the cost that goes with the step after a factorisation.
    pub(super) fn fresh_promise(&self) -> f64 {
        dot(&self.solution, &self.solution)
    }

    /// Half of the way to the step by the last factor, corrected by what later steps have shown;
    /// enough to tell the decrease of the cost that goes with it.
    pub(super) fn promise(&mut self, secants: &mut Secants) -> f64 {
        self.solution.clear();
        self.solution.extend(self.gradient.iter().map(|g| -g));
        let of_secants = secants.before_solve(&mut self.solution);
        self.cholesky.solve_lower(&mut self.solution);
        of_secants + dot(&self.solution, &self.solution)
    }

    /// The other half: the step −(H + λD)⁻¹ g, three numbers for each pose.
    pub(super) fn step(&mut self, secants: &mut Secants, step: &mut Vec<[f64; POSE_SIZE]>) {
        self.cholesky.solve_upper(&mut self.solution);
        secants.after_solve(&mut self.solution);
        secants.take(&self.solution, &self.gradient);
        step.clear();
        let solution = self.solution.as_chunks::<POSE_SIZE>().0;
        let of_pose = |&variable: &u32| solution.get(variable as usize).copied();
        let steps = self.variable.iter().map(of_pose);
        step.extend(steps.map(Option::unwrap_or_default));
    }

    /// L⁻¹ times some columns, one after the other, by the last factor H = LLᵀ: each column has
    /// parts at two poses, of which those that are held are passed over. All have the same rows,
    /// those between the poses and the root; the rest of them are zero.
    pub(super) fn solve_lower(&mut self, columns: &[[(usize, Vector3<f64>); 2]]) -> Vec<f64> {
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
    pub(super) fn solve(&mut self, columns: &mut [f64]) {
        for column in columns.chunks_exact_mut(self.dimension().max(1)) {
            self.cholesky.solve(column);
        }
    }
}

impl Numbers {
    fn of(factor: &Factor) -> Self {
        Self {
            measurement: factor.measurement.pose,
            information: factor.information,
            weight: factor.weight,
        }
    }
}

#[inline(always)]
fn add_block(to: &mut [[f64; POSE_SIZE]; POSE_SIZE], block: &[[f64; POSE_SIZE]; POSE_SIZE]) {
    for (to, block) in to.iter_mut().zip(block) {
        for (to, block) in to.iter_mut().zip(block) {
            *to += block;
        }
    }
}
