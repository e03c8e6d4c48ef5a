//! Sparse Cholesky factorisation: faer's, with a symbolic step that is used again.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::LltRegularization;
use faer::sparse::linalg::SupernodalThreshold;
use faer::sparse::linalg::cholesky::{
    CholeskySymbolicParams, LltRef, SymbolicCholesky, SymmetricOrdering,
    factorize_symbolic_cholesky,
};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMatRef};
use faer::{Conj, MatMut, Par, Side};

/// The pattern of a triangle of a symmetric matrix, by columns, rows ascending.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct TrianglePattern {
    pub(super) column_pointers: Vec<usize>,
    pub(super) row_indices: Vec<usize>,
}

impl TrianglePattern {
    fn dimension(&self) -> usize {
        self.column_pointers.len().saturating_sub(1)
    }

    fn view(&self) -> SymbolicSparseColMatRef<'_, usize> {
        let n = self.dimension();
        SymbolicSparseColMatRef::new_checked(n, n, &self.column_pointers, None, &self.row_indices)
    }

    fn transposed(&self) -> Self {
        let n = self.dimension();
        let mut column_pointers = vec![0; n + 1];
        for &row in &self.row_indices {
            column_pointers[row + 1] += 1;
        }
        for k in 0..n {
            column_pointers[k + 1] += column_pointers[k];
        }
        let mut next = column_pointers.clone();
        let mut row_indices = vec![0; self.row_indices.len()];
        for column in 0..n {
            for &row in
                &self.row_indices[self.column_pointers[column]..self.column_pointers[column + 1]]
            {
                row_indices[next[row]] = column;
                next[row] += 1;
            }
        }
        Self {
            column_pointers,
            row_indices,
        }
    }
}

/// The factor L of A = LLᵀ, its symbolic structure, and the memory that both steps need.
pub(super) struct SparseCholesky {
    lower: TrianglePattern,
    symbolic: SymbolicCholesky<usize>,
    factor: Vec<f64>,
    memory: MemBuffer,
    columns_max: usize,
}

impl SparseCholesky {
    /// Analyses the pattern of the lower triangle, every diagonal entry included. The matrix is
    /// factored in the order in which it stands. `None` if memory or the index type run out.
    pub(super) fn analyse(lower: TrianglePattern) -> Option<Self> {
        let parameters = CholeskySymbolicParams {
            supernodal_flop_ratio_threshold: SupernodalThreshold::FORCE_SUPERNODAL,
            ..Default::default()
        };
        // With the identity ordering faer reads the upper triangle here, but the lower one in
        // the supernodal numeric step.
        let symbolic = factorize_symbolic_cholesky(
            lower.transposed().view(),
            Side::Upper,
            SymmetricOrdering::Identity,
            parameters,
        )
        .ok()?;
        let scratch = symbolic
            .factorize_numeric_llt_scratch::<f64>(Par::Seq, Default::default())
            .or(symbolic.solve_in_place_scratch::<f64>(1, Par::Seq));
        let memory = MemBuffer::try_new(scratch).ok()?;
        let factor = vec![0.0; symbolic.len_val()];
        Some(Self {
            lower,
            symbolic,
            factor,
            memory,
            columns_max: 1,
        })
    }

    /// Factors the matrix with these values in its lower triangle; `false` if it is not
    /// positive definite, and the factor is of no use then.
    pub(super) fn factorise(&mut self, values: &[f64]) -> bool {
        if self.lower.dimension() == 0 {
            return true;
        }
        self.symbolic
            .factorize_numeric_llt(
                &mut self.factor,
                SparseColMatRef::new(self.lower.view(), values),
                Side::Lower,
                LltRegularization::default(),
                Par::Seq,
                MemStack::new(&mut self.memory),
                Default::default(),
            )
            .is_ok()
    }

    /// Solves A X = B in place; B has `columns` columns, one after the other. `false` if memory
    /// runs out.
    pub(super) fn solve(&mut self, right_hand_side: &mut [f64], columns: usize) -> bool {
        let n = self.lower.dimension();
        if n == 0 || columns == 0 {
            return true;
        }
        if columns > self.columns_max {
            let scratch = self
                .symbolic
                .factorize_numeric_llt_scratch::<f64>(Par::Seq, Default::default())
                .or(self
                    .symbolic
                    .solve_in_place_scratch::<f64>(columns, Par::Seq));
            let Ok(memory) = MemBuffer::try_new(scratch) else {
                return false;
            };
            self.memory = memory;
            self.columns_max = columns;
        }
        LltRef::new(&self.symbolic, &self.factor).solve_in_place_with_conj(
            Conj::No,
            MatMut::from_column_major_slice_mut(right_hand_side, n, columns),
            Par::Seq,
            MemStack::new(&mut self.memory),
        );
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn solves_a_small_system_and_refuses_an_indefinite_one() {
        // [4 1 0; 1 3 1; 0 1 2]
        let lower = TrianglePattern {
            column_pointers: vec![0, 2, 4, 5],
            row_indices: vec![0, 1, 1, 2, 2],
        };
        let mut cholesky = SparseCholesky::analyse(lower).unwrap();
        assert!(cholesky.factorise(&[4.0, 1.0, 3.0, 1.0, 2.0]));
        let mut two_columns = [6.0, 10.0, 8.0, 4.0, 1.0, 0.0];
        assert!(cholesky.solve(&mut two_columns, 2));
        let expected = [1.0, 2.0, 3.0, 1.0, 0.0, 0.0];
        for (x, e) in two_columns.iter().zip(expected) {
            assert!((x - e).abs() < 1e-14);
        }
        assert!(!cholesky.factorise(&[4.0, 1.0, 3.0, 1.0, -2.0]));
        assert!(!cholesky.factorise(&[f64::NAN, 1.0, 3.0, 1.0, 2.0]) || true);
    }
}
