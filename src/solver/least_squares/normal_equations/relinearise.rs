//! Equations of a problem that grows: only what is new, and what has moved, is linearised and
//! factored again, as in iSAM2's fluid relinearisation (Kaess et al. 2012).
//!
//! A factor's part of H depends on its ends' relative motion only. It is left as it is until that
//! motion has become another: steps by such an H lead to the same optimum, in a few more steps.

use super::super::problem::Problem;
use super::{DAMPING_MIN, NONE, NormalEquations, POSE_SIZE, Slot};
use crate::solver::factor::{Batch, Frame, LANES, Motions, dispatch};
use crate::solver::linear::dot;

/// What has moved by no more than this, as an angle, is left as it is. Where a large part of a map
/// turns, a limit ten times as high needs ten times as many steps.
const MOVED_RAD: f64 = 1e-4;

impl NormalEquations {
    /// Takes in the poses and factors that a problem has and the equations have not; the new ones
    /// come last, and every new pose has a factor. `false` if the equations should rather be made
    /// again.
    pub(crate) fn grow(&mut self, problem: &Problem, batches: &[Batch], frames: &[Frame]) -> bool {
        let (poses, factors) = (self.variable.len(), self.slots.len());
        self.touched.clear();
        for &held in &problem.held[poses..] {
            let variable = if held {
                NONE
            } else {
                self.matrix.add_variable()
            };
            self.variable.push(variable);
        }
        self.add_slots(&problem.factors[factors..]);
        let new = &self.slots[factors..];
        let ends = new.iter().flat_map(|slot| [slot.from, slot.to]);
        self.touched.extend(ends.filter(|&end| end != NONE));
        self.touched.sort_unstable();
        self.touched.dedup();
        let Some(fronts) = self.cholesky.extend(&self.matrix, &self.touched) else {
            return false;
        };
        if self.has_plain_factor {
            self.linearised.resize(batches.len(), Motions::none());
            for factor in factors..self.slots.len() {
                self.linearise_new(factor, batches, frames);
            }
            let pairs: Vec<usize> = self.cholesky.pairs_of(&fronts).collect();
            for pair in pairs {
                let factor = self.factor_of_pair[pair] as usize;
                if factor < factors && self.has_moved(factor, batches, frames) {
                    self.linearise_again(factor, batches, frames);
                }
            }
            self.has_plain_factor =
                self.cholesky
                    .factorise_fronts(&fronts, &self.matrix, DAMPING_MIN);
        }
        true
    }

    /// Linearises again what has moved, and factors again what that touches; `false` if H is not
    /// positive definite then.
    pub(crate) fn refresh(&mut self, batches: &[Batch], frames: &[Frame]) -> bool {
        let mut moved: Vec<usize> = Vec::new();
        dispatch(
            #[inline(always)]
            || {
                for (k, (batch, linearised)) in batches.iter().zip(&self.linearised).enumerate() {
                    let distances = batch.square_distances(&batch.motions(frames), linearised);
                    let is_moved = |&lane: &usize| distances[lane] > MOVED_RAD * MOVED_RAD;
                    let lanes = (0..LANES).filter(is_moved);
                    moved.extend(lanes.map(|lane| k * LANES + lane));
                }
            },
        );
        moved.retain(|&factor| factor < self.slots.len());
        let mut touched = Vec::with_capacity(2 * moved.len());
        for &factor in &moved {
            self.linearise_again(factor, batches, frames);
            let Slot { from, to, .. } = self.slots[factor];
            touched.extend([from, to]);
        }
        touched.retain(|&variable| variable != NONE);
        let fronts = self.cholesky.path_of(touched.into_iter());
        self.has_plain_factor = self
            .cholesky
            .factorise_fronts(&fronts, &self.matrix, DAMPING_MIN);
        self.has_plain_factor
    }

    fn has_moved(&self, factor: usize, batches: &[Batch], frames: &[Frame]) -> bool {
        let (batch, lane) = (&batches[factor / LANES], factor % LANES);
        let before = self.linearised[factor / LANES].lane(lane);
        let batch = batch.lane(lane);
        let [distance] = batch.square_distances(&batch.motions(frames), &before);
        distance > MOVED_RAD * MOVED_RAD
    }

    fn linearise_again(&mut self, factor: usize, batches: &[Batch], frames: &[Frame]) {
        let lane = factor % LANES;
        let before = self.linearised[factor / LANES].lane(lane);
        let blocks = batches[factor / LANES].lane(lane).blocks(&before).of(0);
        self.add_to_diagonal(self.slots[factor], &blocks, -1.0);
        self.linearise_new(factor, batches, frames);
    }

    fn linearise_new(&mut self, factor: usize, batches: &[Batch], frames: &[Frame]) {
        let lane = factor % LANES;
        let batch = batches[factor / LANES].lane(lane);
        let motion = batch.motions(frames);
        self.linearised[factor / LANES].set(lane, &motion);
        self.add_blocks(self.slots[factor], &batch.blocks(&motion).of(0));
    }

    /// As [`Self::predicted_decrease`] for a gradient that is zero except where the problem grew.
    pub(crate) fn predicted_decrease_of_extension(&mut self) -> f64 {
        self.solution.clear();
        self.solution.resize(self.gradient.len(), 0.0);
        for &variable in &self.touched {
            let at = variable as usize * POSE_SIZE;
            for k in at..at + POSE_SIZE {
                self.solution[k] = -self.gradient[k];
            }
        }
        let path = self.cholesky.path_of(self.touched.iter().copied());
        self.cholesky.solve_lower_along(&path, &mut self.solution);
        dot(&self.solution, &self.solution)
    }
}
