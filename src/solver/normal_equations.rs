//! H = Σ JᵀΩJ and g = Σ JᵀΩe of a problem, and their solution.

use nalgebra::Vector3;

use super::block_matrix::{BlockMatrix, Slot};
use super::cholesky::SparseCholesky;
use super::problem::{Factor, Problem};
use crate::geometry::Pose2;

/// The coordinates of a pose.
pub(super) const POSE_SIZE: usize = 3;

/// The normal equations of the poses that are not held. The structure (which poses, which
/// pairs) is analysed once; the numbers may be filled in again and again.
pub(super) struct NormalEquations {
    /// For each pose its variable; `None` if it is held or stands alone.
    variable: Vec<Option<usize>>,
    /// For each factor the slot of its pair; `None` if an end is held.
    pair_slots: Vec<Option<Slot>>,
    hessian: BlockMatrix<POSE_SIZE>,
    diagonal: Vec<usize>,
    damped: Vec<f64>,
    gradient: Vec<f64>,
    cholesky: SparseCholesky,
    held: Vec<bool>,
    ends: Vec<(usize, usize)>,
}

impl NormalEquations {
    /// Orders and analyses a problem's structure; `None` if memory runs out.
    pub(super) fn new(problem: &Problem) -> Option<Self> {
        let (variable, variables) = problem.variables();
        let pair = |factor: &Factor| Some((variable[factor.from]?, variable[factor.to]?));
        let pairs: Vec<(usize, usize)> = problem.factors.iter().filter_map(pair).collect();
        let (hessian, slots, pattern) = BlockMatrix::new(variables, &pairs)?;
        let mut slots = slots.into_iter();
        let pair_slots = problem
            .factors
            .iter()
            .map(|factor| pair(factor).and_then(|_| slots.next()))
            .collect();
        Some(Self {
            pair_slots,
            diagonal: hessian.diagonal_places(),
            damped: vec![0.0; hessian.values.len()],
            gradient: vec![0.0; hessian.dimension()],
            cholesky: SparseCholesky::analyse(pattern)?,
            hessian,
            held: problem.held.clone(),
            ends: problem.factors.iter().map(|f| (f.from, f.to)).collect(),
            variable,
        })
    }

    /// Whether the structure is this problem's.
    pub(super) fn fits(&self, problem: &Problem) -> bool {
        self.held == problem.held
            && self.ends.len() == problem.factors.len()
            && self
                .ends
                .iter()
                .zip(&problem.factors)
                .all(|(&ends, factor)| ends == (factor.from, factor.to))
    }

    /// The number of unknown scalars.
    pub(super) fn dimension(&self) -> usize {
        self.gradient.len()
    }

    /// Where a pose's first coordinate stands in a right-hand side; `None` if it is held.
    pub(super) fn offset(&self, pose: usize) -> Option<usize> {
        Some(self.hessian.offset(self.variable[pose]?))
    }

    /// Fills in H and g at these poses.
    pub(super) fn linearise(&mut self, factors: &[Factor], poses: &[Pose2]) {
        self.hessian.values.fill(0.0);
        self.gradient.fill(0.0);
        for (factor, &slot) in factors.iter().zip(&self.pair_slots) {
            let (from, to) = (&poses[factor.from], &poses[factor.to]);
            let at = Pose2::edge_error_with_jacobians(from, to, &factor.measurement);
            let information = factor.information.matrix() * factor.weight;
            let weighted_error = information * at.error;
            let weighted_to = information * at.jacobian_to;
            if let Some(variable) = self.variable[factor.from] {
                let block = at.jacobian_from.tr_mul(&(information * at.jacobian_from));
                self.hessian.add_diagonal(variable, &block);
                add_to(
                    &mut self.gradient,
                    self.hessian.offset(variable),
                    &at.jacobian_from.tr_mul(&weighted_error),
                );
            }
            if let Some(variable) = self.variable[factor.to] {
                let block = at.jacobian_to.tr_mul(&weighted_to);
                self.hessian.add_diagonal(variable, &block);
                add_to(
                    &mut self.gradient,
                    self.hessian.offset(variable),
                    &at.jacobian_to.tr_mul(&weighted_error),
                );
            }
            if let Some(slot) = slot {
                let block = at.jacobian_from.tr_mul(&weighted_to);
                self.hessian.add_pair(slot, &block);
            }
        }
    }

    /// Fills in g alone at these poses.
    pub(super) fn linearise_gradient(&mut self, factors: &[Factor], poses: &[Pose2]) {
        self.gradient.fill(0.0);
        for factor in factors {
            let (from, to) = (&poses[factor.from], &poses[factor.to]);
            let at = Pose2::edge_error_with_jacobians(from, to, &factor.measurement);
            let weighted = factor.information.matrix() * at.error * factor.weight;
            let parts = [
                (factor.from, at.jacobian_from.tr_mul(&weighted)),
                (factor.to, at.jacobian_to.tr_mul(&weighted)),
            ];
            for (pose, part) in parts {
                if let Some(offset) = self.offset(pose) {
                    add_to(&mut self.gradient, offset, &part);
                }
            }
        }
    }

    /// Factors H + λ D, where D is H's diagonal, raised where it is next to nothing; `false`
    /// if that is not positive definite.
    pub(super) fn factorise(&mut self, damping: f64) -> bool {
        self.damped.copy_from_slice(&self.hessian.values);
        let values = &self.hessian.values;
        let mean = self.diagonal.iter().map(|&k| values[k].abs()).sum::<f64>()
            / self.diagonal.len().max(1) as f64;
        for &k in &self.diagonal {
            // A coordinate that no edge measures has a zero here and must still get a pivot.
            self.damped[k] += damping * values[k].abs().max(1e-6 * mean).max(f64::MIN_POSITIVE);
        }
        self.cholesky.factorise(&self.damped)
    }

    /// The step −(H + λD)⁻¹ g by the last factor, and the decrease gᵀ(H + λD)⁻¹g of the cost
    /// that goes with it; `None` if it is not finite.
    pub(super) fn step(&mut self, step: &mut Vec<f64>) -> Option<f64> {
        step.clear();
        step.extend(self.gradient.iter().map(|g| -g));
        if !self.cholesky.solve(step, 1) {
            return None;
        }
        let decrease: f64 = -step
            .iter()
            .zip(&self.gradient)
            .map(|(s, g)| s * g)
            .sum::<f64>();
        (decrease.is_finite() && step.iter().all(|s| s.is_finite())).then_some(decrease)
    }

    /// H⁻¹ times some columns, one after the other, by the last factor; `false` if memory runs
    /// out.
    pub(super) fn solve(&mut self, columns: &mut [f64]) -> bool {
        let count = columns.len() / self.dimension().max(1);
        self.cholesky.solve(columns, count)
    }

    /// The poses after a step.
    pub(super) fn apply(&self, poses: &[Pose2], step: &[f64], moved: &mut Vec<Pose2>) {
        moved.clear();
        moved.extend(poses.iter().enumerate().map(|(k, pose)| {
            self.offset(k).map_or(*pose, |at| {
                pose.plus(&Vector3::new(step[at], step[at + 1], step[at + 2]))
            })
        }));
    }
}

fn add_to(gradient: &mut [f64], offset: usize, part: &Vector3<f64>) {
    for k in 0..POSE_SIZE {
        gradient[offset + k] += part[k];
    }
}
