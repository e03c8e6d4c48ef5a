//! The parts of H⁻¹ that belong to poses and factors.

use nalgebra::Matrix3;

use super::{NONE, NormalEquations, POSE_SIZE};
use crate::solver::linear::SelectedInverse;

/// Parts of H⁻¹, for steps in the poses' own frames. Poses that are held have none: zero.
pub(crate) struct Inverse<'a> {
    equations: &'a NormalEquations,
    blocks: SelectedInverse<POSE_SIZE>,
}

impl NormalEquations {
    /// H⁻¹ by the last factor, which must be of H as it is.
    pub(crate) fn inverse(&self) -> Inverse<'_> {
        Inverse {
            equations: self,
            blocks: self.cholesky.selected_inverse(&self.matrix),
        }
    }
}

impl Inverse<'_> {
    /// The covariance of a pose's step.
    pub(crate) fn of_pose(&self, pose: usize) -> Matrix3<f64> {
        match self.equations.variable[pose] {
            NONE => Matrix3::zeros(),
            variable => self.blocks.diagonal[variable as usize],
        }
    }

    /// The covariance of the steps of a factor's first pose (rows) and its second (columns).
    pub(crate) fn of_factor(&self, factor: usize) -> Matrix3<f64> {
        match self.equations.slots[factor].pair {
            NONE => Matrix3::zeros(),
            pair => self.blocks.pairs[pair as usize],
        }
    }
}
