//! The blocks of A⁻¹ that stand where A has numbers, by the factor A = LLᵀ.
//!
//! Top down over the fronts (Takahashi, Fagan and Chin 1973): what A⁻¹ is among the rows below a
//! front its parent knows, and with the front's columns of L that gives A⁻¹ among all its rows.

use nalgebra::{DMatrix, SMatrix};

use super::block_matrix::BlockMatrix;
use super::cholesky::BlockCholesky;
use super::front::Front;

/// Blocks of the inverse of a [`BlockMatrix`].
pub(super) struct SelectedInverse<const B: usize> {
    /// By variable.
    pub(super) diagonal: Vec<SMatrix<f64, B, B>>,
    /// By pair (a, b): a's rows, b's columns.
    pub(super) pairs: Vec<SMatrix<f64, B, B>>,
}

impl<const B: usize> BlockCholesky<B> {
    /// The blocks of A⁻¹ by the last factor, which must be of this matrix. Costs about twice as
    /// much as the factorisation, and as much memory as its largest fronts.
    pub(super) fn selected_inverse(&self, matrix: &BlockMatrix<B>) -> SelectedInverse<B> {
        let mut inverse = SelectedInverse {
            diagonal: vec![SMatrix::zeros(); matrix.diagonal.len()],
            pairs: vec![SMatrix::zeros(); matrix.blocks.len()],
        };
        let mut among_below = vec![DMatrix::zeros(0, 0); self.fronts.len()];
        for &f in self.bottom_up.iter().rev() {
            let front = &self.fronts[f as usize];
            let below = std::mem::replace(&mut among_below[f as usize], DMatrix::zeros(0, 0));
            let among_rows = self.inverse_among_rows(front, &below);
            inverse.read(front, &among_rows);
            for &c in &front.children {
                let rows = &self.fronts[c as usize].in_parent.rows;
                let rows = rows.iter().flat_map(|&row| row as usize..row as usize + B);
                let rows: Vec<usize> = rows.collect();
                among_below[c as usize] = DMatrix::from_fn(rows.len(), rows.len(), |i, j| {
                    among_rows[(rows[i], rows[j])]
                });
            }
        }
        inverse
    }

    /// A⁻¹ among a front's rows, given what it is among those below.
    fn inverse_among_rows(&self, front: &Front, below: &DMatrix<f64>) -> DMatrix<f64> {
        let (width, height) = (front.width * B, front.rows.len() * B);
        let columns = &self.columns.as_slice()[front.columns::<B>()];
        let l = |row: usize, column: usize| columns[column * front.stride + row];
        // L's diagonal is kept as its reciprocals: P⁻¹ column by column, by forward substitution.
        let mut inverse_of_top = DMatrix::zeros(width, width);
        for column in 0..width {
            inverse_of_top[(column, column)] = l(column, column);
            for row in column + 1..width {
                let known = (column..row).map(|k| l(row, k) * inverse_of_top[(k, column)]);
                let sum: f64 = known.sum();
                inverse_of_top[(row, column)] = -sum * l(row, row);
            }
        }
        let bottom = DMatrix::from_fn(height - width, width, |row, k| l(width + row, k));
        // A⁻¹ among all rows: [P⁻ᵀP⁻¹ + MᵀSM, −MᵀS; −SM, S] with M = Q P⁻¹ and S among those below.
        let m = bottom * &inverse_of_top;
        let across = below * &m;
        let own = inverse_of_top.tr_mul(&inverse_of_top) + m.tr_mul(&across);
        let mut among = DMatrix::zeros(height, height);
        among.view_mut((0, 0), (width, width)).copy_from(&own);
        among
            .view_mut((width, width), (height - width, height - width))
            .copy_from(below);
        for row in width..height {
            for column in 0..width {
                let value = -across[(row - width, column)];
                among[(row, column)] = value;
                among[(column, row)] = value;
            }
        }
        among
    }
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
