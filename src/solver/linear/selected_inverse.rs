//! The blocks of A⁻¹ that stand where A has numbers, by the factor A = LLᵀ.
//!
//! Top down over the fronts (Takahashi, Fagan and Chin 1973): what A⁻¹ is among the rows below a
//! front its parent knows, and with the front's columns of L that gives A⁻¹ among all its rows.

use nalgebra::{DMatrix, DMatrixView, SMatrix};

use super::block_matrix::BlockMatrix;
use super::cholesky::BlockCholesky;
use super::front::Front;

/// Blocks of the inverse of a [`BlockMatrix`].
pub(crate) struct SelectedInverse<const B: usize> {
    /// By variable.
    pub(crate) diagonal: Vec<SMatrix<f64, B, B>>,
    /// By pair (a, b): a's rows, b's columns.
    pub(crate) pairs: Vec<SMatrix<f64, B, B>>,
}

impl<const B: usize> BlockCholesky<B> {
    /// The blocks of A⁻¹ by the last factor, which must be of this matrix. Memory: A⁻¹ among the
    /// rows of the fronts whose parents are done.
    pub(crate) fn selected_inverse(&self, matrix: &BlockMatrix<B>) -> SelectedInverse<B> {
        let mut inverse = SelectedInverse {
            diagonal: vec![SMatrix::zeros(); matrix.diagonal.len()],
            pairs: vec![SMatrix::zeros(); matrix.blocks.len()],
        };
        // Among a front's rows; what it is among those below its parent has filled in.
        let mut among_rows = vec![DMatrix::default(); self.fronts.len()];
        for &f in self.bottom_up.iter().rev() {
            let front = &self.fronts[f as usize];
            let mut among = std::mem::take(&mut among_rows[f as usize]);
            if front.below().is_empty() {
                among = DMatrix::zeros(front.width * B, front.width * B);
            }
            self.fill_in_own(front, &mut among);
            inverse.read(front, &among);
            for &c in &front.children {
                among_rows[c as usize] = among_below::<B>(&self.fronts[c as usize], &among);
            }
        }
        inverse
    }

    /// Completes A⁻¹ among a front's rows, given what it is among those below: it is
    /// [P⁻ᵀP⁻¹ + MᵀSM, −MᵀS; −SM, S] with S among those below, the front's columns [P; Q] of L, and
    /// M = Q P⁻¹.
    fn fill_in_own(&self, front: &Front, among: &mut DMatrix<f64>) {
        let (width, height) = (front.width * B, front.rows.len() * B);
        let columns = &self.columns.as_slice()[front.columns::<B>()];
        let inverse_of_top = inverse_of_top(columns, front.stride, width);
        let mut own = inverse_of_top.tr_mul(&inverse_of_top);
        if height > width {
            let shape = (height - width, width);
            let (rows, stride) = (&columns[width..], front.stride);
            let q = DMatrixView::from_slice_with_strides(rows, shape.0, shape.1, 1, stride);
            let m = q * &inverse_of_top;
            let below = among.view((width, width), (shape.0, shape.0));
            let across = -(below * &m);
            own -= m.tr_mul(&across);
            among.view_mut((width, 0), shape).copy_from(&across);
            if !front.children.is_empty() {
                let mut turned = among.view_mut((0, width), (shape.1, shape.0));
                turned.tr_copy_from(&across);
            }
        }
        among.view_mut((0, 0), (width, width)).copy_from(&own);
    }
}

/// P⁻¹, given P below the diagonal and the reciprocals of its diagonal.
fn inverse_of_top(columns: &[f64], stride: usize, width: usize) -> DMatrix<f64> {
    let mut inverse = DMatrix::zeros(width, width);
    for (first, mut own) in inverse.column_iter_mut().enumerate() {
        own[first] = 1.0;
        let own = own.as_mut_slice();
        for k in first..width {
            let column = &columns[k * stride..][..width];
            own[k] *= column[k];
            let (done, rest) = own.split_at_mut(k + 1);
            for (x, l) in rest.iter_mut().zip(&column[k + 1..]) {
                *x -= l * done[k];
            }
        }
    }
    inverse
}

/// A⁻¹ among the rows of a front, filled in among those below, given what it is among its
/// parent's.
fn among_below<const B: usize>(front: &Front, of_parent: &DMatrix<f64>) -> DMatrix<f64> {
    let (width, height) = (front.width * B, front.rows.len() * B);
    let mut among = DMatrix::zeros(height, height);
    let rows = &front.in_parent.rows;
    let columns = rows.iter().flat_map(|&row| row as usize..row as usize + B);
    for (column, to) in columns.zip(among.as_mut_slice().chunks_exact_mut(height).skip(width)) {
        let from = of_parent.column(column);
        let from = from.as_slice();
        for (to, &row) in to[width..].chunks_exact_mut(B).zip(rows) {
            to.copy_from_slice(&from[row as usize..row as usize + B]);
        }
    }
    among
}

impl<const B: usize> SelectedInverse<B> {
    /// Takes the blocks of a front's own variables.
    fn read(&mut self, front: &Front, among_rows: &DMatrix<f64>) {
        let block = |row, column| among_rows.fixed_view::<B, B>(row, column).into_owned();
        for (k, &variable) in front.rows[..front.width].iter().enumerate() {
            self.diagonal[variable as usize] = block(k * B, k * B);
        }
        for coupling in &front.couplings {
            let at = coupling.at as usize;
            let block = block(at % front.stride, at / front.stride);
            let turned = block.transpose();
            self.pairs[coupling.pair as usize] = if coupling.is_turned { turned } else { block };
        }
    }
}
