//! The numeric part of the factorisation, and the solution by it.

use pulp::{Simd, WithSimd};

use super::assembly::Assembly;
use super::block_matrix::BlockMatrix;
use super::cholesky::{BlockCholesky, Memory};
use super::dense::{backward, factor_columns, forward, subtract_square};
use super::front::Front;

/// Factors some fronts, children first. The damping is relative, and what a diagonal entry
/// counts for at least.
pub(super) struct Factorise<'a, const B: usize> {
    pub(super) cholesky: &'a mut BlockCholesky<B>,
    pub(super) fronts: &'a [u32],
    pub(super) matrix: &'a BlockMatrix<B>,
    pub(super) damping: (f64, f64),
}

impl<const B: usize> WithSimd for Factorise<'_, B> {
    type Output = bool;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> bool {
        let cholesky = self.cholesky;
        let Memory {
            place,
            child_places,
            ..
        } = &mut cholesky.memory;
        for &f in self.fronts {
            let front = &cholesky.fronts[f as usize];
            let columns = &mut cholesky.columns[front.columns::<B>()];
            columns.fill(0.0);
            for (k, &variable) in front.rows.iter().enumerate() {
                place[variable as usize] = k as u32;
            }
            let mut assembly = Assembly::<B>::new(front, columns, place);
            assembly.add_matrix(self.matrix, self.damping);
            cholesky.updates[front.update::<B>()].fill(0.0);
            for &c in &front.children {
                let child = &cholesky.fronts[c as usize];
                let ranges = [front.update::<B>(), child.update::<B>()];
                let Ok([update, of_child]) = cholesky.updates.get_disjoint_mut(ranges) else {
                    return false;
                };
                assembly.add_child(child, of_child, update, child_places);
            }
            let width = front.width * B;
            if !factor_columns::<S, B>(simd, columns, front.stride, width) {
                return false;
            }
            subtract_square::<S, B>(
                simd,
                &mut cholesky.updates[front.update::<B>()],
                front.update_stride(),
                front.skipped,
                columns,
                front.stride,
                width,
            );
        }
        true
    }
}

/// Solves for a right-hand side in place.
pub(super) struct Solve<'a, const B: usize> {
    pub(super) cholesky: &'a mut BlockCholesky<B>,
    pub(super) x: &'a mut [f64],
}

impl<const B: usize> WithSimd for Solve<'_, B> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let cholesky = self.cholesky;
        let Memory { x: own, y, .. } = &mut cholesky.memory;
        for &f in &cholesky.bottom_up {
            let front = &cholesky.fronts[f as usize];
            let columns = &cholesky.columns[front.columns::<B>()];
            eliminate_front::<S, B>(simd, front, columns, self.x, y, own);
            scatter::<B>(own, &front.rows[..front.width], self.x);
        }
        for &f in cholesky.bottom_up.iter().rev() {
            let front = &cholesky.fronts[f as usize];
            y.clear();
            y.resize(front.stride, 0.0);
            own.clear();
            own.resize(front.width * B, 0.0);
            gather::<B>(self.x, &front.rows[..front.width], own);
            gather::<B>(self.x, front.below(), &mut y[front.width * B..]);
            let columns = &cholesky.columns[front.columns::<B>()];
            backward::<S, B>(simd, columns, front.stride, y, own);
            scatter::<B>(y, &front.rows[..front.width], self.x);
        }
    }
}

/// The first half of [`Solve`], along a path to the root.
pub(super) struct SolveForward<'a, const B: usize> {
    pub(super) cholesky: &'a mut BlockCholesky<B>,
    pub(super) path: &'a [u32],
    pub(super) b: &'a mut [f64],
    pub(super) solved: &'a mut Vec<f64>,
}

impl<const B: usize> WithSimd for SolveForward<'_, B> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let cholesky = self.cholesky;
        let Memory { x: own, y, .. } = &mut cholesky.memory;
        for &f in self.path {
            let front = &cholesky.fronts[f as usize];
            let columns = &cholesky.columns[front.columns::<B>()];
            eliminate_front::<S, B>(simd, front, columns, self.b, y, own);
            self.solved.extend_from_slice(own);
            own.fill(0.0);
            scatter::<B>(own, &front.rows[..front.width], self.b);
        }
    }
}

/// Leaves a front's own part of L⁻¹ b in `own`, and subtracts what that does to the rows below.
#[inline(always)]
fn eliminate_front<S: Simd, const B: usize>(
    simd: S,
    front: &Front,
    columns: &[f64],
    b: &mut [f64],
    y: &mut Vec<f64>,
    own: &mut Vec<f64>,
) {
    y.clear();
    y.resize(front.stride, 0.0);
    own.clear();
    own.resize(front.width * B, 0.0);
    gather::<B>(b, &front.rows[..front.width], y);
    forward::<S, B>(simd, columns, front.stride, y, own);
    let below = &y[front.width * B..];
    for (part, &variable) in below.chunks_exact(B).zip(front.below()) {
        let at = variable as usize * B;
        for (value, part) in b[at..at + B].iter_mut().zip(part) {
            *value += part;
        }
    }
}

#[inline(always)]
fn gather<const B: usize>(x: &[f64], variables: &[u32], to: &mut [f64]) {
    for (to, &variable) in to.chunks_exact_mut(B).zip(variables) {
        let at = variable as usize * B;
        to.copy_from_slice(&x[at..at + B]);
    }
}

#[inline(always)]
fn scatter<const B: usize>(from: &[f64], variables: &[u32], x: &mut [f64]) {
    for (from, &variable) in from.chunks_exact(B).zip(variables) {
        let at = variable as usize * B;
        x[at..at + B].copy_from_slice(from);
    }
}
