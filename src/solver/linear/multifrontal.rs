//! The numeric part of the factorisation, and the solution by it.

use pulp::{Simd, WithSimd};

use super::aligned::Aligned;
use super::assembly::{FromChild, fill_columns, fill_right_row, read_right_row};
use super::block_matrix::BlockMatrix;
use super::dense::{backward, factor_columns, forward, set_to_minus_square};
use super::front::Front;

/// Memory for one front's part of a right-hand side.
#[derive(Debug, Default)]
pub(super) struct Scratch {
    /// As long as a front's columns.
    y: Aligned,
    x: Vec<f64>,
}

/// Factors some fronts, children first. The damping is relative, and what a diagonal entry
/// counts for at least. A right-hand side is brought through the fronts while they are at hand.
pub(super) struct Factorise<'a, const B: usize> {
    pub(super) fronts: &'a [Front],
    /// Numbers of all fronts: the columns of L, and what they leave for their parents.
    pub(super) columns: &'a mut [f64],
    pub(super) updates: &'a mut [f64],
    /// The fronts to factor, by their places among all.
    pub(super) path: &'a [u32],
    pub(super) matrix: &'a BlockMatrix<B>,
    pub(super) damping: (f64, f64),
    /// Empty if there is none.
    pub(super) x: &'a mut [f64],
}

impl<const B: usize> WithSimd for Factorise<'_, B> {
    type Output = bool;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> bool {
        let (fronts, all_columns, updates) = (self.fronts, self.columns, self.updates);
        for &f in self.path {
            let front = &fronts[f as usize];
            let columns = &mut all_columns[front.columns::<B>()];
            fill_columns(front, columns, self.matrix, self.damping);
            if !self.x.is_empty() {
                fill_right_row::<B>(front, columns, self.x);
            }
            for &c in &front.children {
                let child = &fronts[c as usize];
                FromChild {
                    parent: front,
                    child,
                    update: &updates[child.update::<B>()],
                }
                .add_to_columns::<B>(columns);
            }
            let width = front.width * B;
            if !factor_columns::<S, B>(simd, columns, front.stride, width) {
                return false;
            }
            if front.rows.len() > front.width {
                set_to_minus_square::<S, B>(
                    simd,
                    &mut updates[front.update::<B>()],
                    front.update_stride(),
                    front.skipped,
                    columns,
                    front.stride,
                    width,
                );
            }
            for &c in &front.children {
                let child = &fronts[c as usize];
                let ranges = [front.update::<B>(), child.update::<B>()];
                let Ok([update, of_child]) = updates.get_disjoint_mut(ranges) else {
                    return false;
                };
                FromChild {
                    parent: front,
                    child,
                    update: of_child,
                }
                .add_to_update::<B>(update);
            }
            if !self.x.is_empty() {
                read_right_row::<B>(front, columns, self.x);
            }
        }
        true
    }
}

/// Solves L y = b in place, for a b that is zero but where these fronts eliminate; they are given
/// children first.
pub(super) struct SolveLower<'a, const B: usize> {
    pub(super) fronts: &'a [Front],
    pub(super) columns: &'a [f64],
    pub(super) path: &'a [u32],
    pub(super) scratch: &'a mut Scratch,
    pub(super) x: &'a mut [f64],
}

impl<const B: usize> WithSimd for SolveLower<'_, B> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Scratch { x: own, y } = self.scratch;
        for &f in self.path {
            let front = &self.fronts[f as usize];
            y.grow(front.stride);
            let y = &mut y.as_mut_slice()[..front.stride];
            y.fill(0.0);
            own.clear();
            own.resize(front.width * B, 0.0);
            gather::<B>(self.x, &front.rows[..front.width], y);
            let columns = &self.columns[front.columns::<B>()];
            forward::<S, B>(simd, columns, front.stride, y, own);
            scatter::<B>(own, &front.rows[..front.width], self.x);
            let below = &y[front.width * B..];
            for (part, &variable) in below.chunks_exact(B).zip(front.below()) {
                let at = variable as usize * B;
                for (x, part) in self.x[at..at + B].iter_mut().zip(part) {
                    *x += part;
                }
            }
        }
    }
}

/// Solves Lᵀ x = y in place.
pub(super) struct SolveUpper<'a, const B: usize> {
    pub(super) fronts: &'a [Front],
    pub(super) columns: &'a [f64],
    /// All fronts, children first.
    pub(super) bottom_up: &'a [u32],
    pub(super) scratch: &'a mut Scratch,
    pub(super) x: &'a mut [f64],
}

impl<const B: usize> WithSimd for SolveUpper<'_, B> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Scratch { x: own, y } = self.scratch;
        for &f in self.bottom_up.iter().rev() {
            let front = &self.fronts[f as usize];
            y.grow(front.stride);
            let y = &mut y.as_mut_slice()[..front.stride];
            y.fill(0.0);
            own.clear();
            own.resize(front.width * B, 0.0);
            gather::<B>(self.x, &front.rows[..front.width], own);
            gather::<B>(self.x, front.below(), &mut y[front.width * B..]);
            let columns = &self.columns[front.columns::<B>()];
            backward::<S, B>(simd, columns, front.stride, y, own);
            scatter::<B>(y, &front.rows[..front.width], self.x);
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
