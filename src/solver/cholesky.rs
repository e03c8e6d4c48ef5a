//! Sparse Cholesky factorisation: faer's, with a symbolic step that is used again.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::LltRegularization;
use faer::sparse::linalg::SupernodalThreshold;
use faer::sparse::linalg::cholesky::supernodal::SymbolicSupernodalCholesky;
use faer::sparse::linalg::cholesky::{
    CholeskySymbolicParams, SymbolicCholesky, SymbolicCholeskyRaw, SymmetricOrdering,
    factorize_symbolic_cholesky,
};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMatRef};
use faer::{Par, Side};

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
    /// One number for each row below a supernode.
    below: Vec<f64>,
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
        let scratch = symbolic.factorize_numeric_llt_scratch::<f64>(Par::Seq, Default::default());
        let memory = MemBuffer::try_new(scratch).ok()?;
        let factor = vec![0.0; symbolic.len_val()];
        Some(Self {
            lower,
            symbolic,
            factor,
            memory,
            below: Vec::new(),
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

    /// Solves A X = B in place; B has `columns` columns, one after the other.
    ///
    /// Written out, since faer's solve is made for many columns and takes four times as long for
    /// one.
    pub(super) fn solve(&mut self, right_hand_side: &mut [f64], columns: usize) -> bool {
        let n = self.lower.dimension();
        if n == 0 || columns == 0 {
            return true;
        }
        let SymbolicCholeskyRaw::Supernodal(symbolic) = self.symbolic.raw() else {
            return false;
        };
        for x in right_hand_side.chunks_exact_mut(n).take(columns) {
            for s in 0..symbolic.n_supernodes() {
                Supernode::of(symbolic, &self.factor, s).forward(x, &mut self.below);
            }
            for s in (0..symbolic.n_supernodes()).rev() {
                Supernode::of(symbolic, &self.factor, s).backward(x, &mut self.below);
            }
        }
        true
    }
}

/// Neighbouring columns of L that share their rows below.
struct Supernode<'a> {
    start: usize,
    width: usize,
    rows_below: &'a [usize],
    /// Column by column: `width` rows of the diagonal block, then the rows below.
    values: &'a [f64],
}

impl<'a> Supernode<'a> {
    fn of(symbolic: &'a SymbolicSupernodalCholesky<usize>, factor: &'a [f64], s: usize) -> Self {
        let (start, end) = (symbolic.supernode_begin()[s], symbolic.supernode_end()[s]);
        let values = symbolic.col_ptr_for_val();
        Self {
            start,
            width: end - start,
            rows_below: symbolic.supernode(s).pattern(),
            values: &factor[values[s]..values[s + 1]],
        }
    }

    /// A column's part in the diagonal block, and below it.
    fn column(&self, k: usize) -> (&'a [f64], &'a [f64]) {
        let height = self.width + self.rows_below.len();
        self.values[k * height..(k + 1) * height].split_at(self.width)
    }

    /// x ← L⁻¹x for these columns.
    fn forward(&self, x: &mut [f64], sums: &mut Vec<f64>) {
        sums.clear();
        sums.resize(self.rows_below.len(), 0.0);
        let own = &mut x[self.start..self.start + self.width];
        for k in 0..self.width {
            let (diagonal, below) = self.column(k);
            let value = own[k] / diagonal[k];
            own[k] = value;
            for (x, l) in own[k + 1..].iter_mut().zip(&diagonal[k + 1..]) {
                *x -= l * value;
            }
            for (sum, l) in sums.iter_mut().zip(below) {
                *sum += l * value;
            }
        }
        for (&row, sum) in self.rows_below.iter().zip(sums.iter()) {
            x[row] -= sum;
        }
    }

    /// x ← L⁻ᵀx for these columns.
    fn backward(&self, x: &mut [f64], below_x: &mut Vec<f64>) {
        below_x.clear();
        below_x.extend(self.rows_below.iter().map(|&row| x[row]));
        let own = &mut x[self.start..self.start + self.width];
        for k in (0..self.width).rev() {
            let (diagonal, below) = self.column(k);
            let inside = dot(&diagonal[k + 1..], &own[k + 1..]);
            own[k] = (own[k] - inside - dot(below, below_x)) / diagonal[k];
        }
    }
}

/// Four sums at a time, so that they can share a vector register.
fn dot(a: &[f64], b: &[f64]) -> f64 {
    const LANES: usize = 4;
    let mut sums = [0.0; LANES];
    let (a_chunks, b_chunks) = (a.chunks_exact(LANES), b.chunks_exact(LANES));
    let rest: f64 = a_chunks
        .remainder()
        .iter()
        .zip(b_chunks.remainder())
        .map(|(a, b)| a * b)
        .sum();
    for (a, b) in a_chunks.zip(b_chunks) {
        for k in 0..LANES {
            sums[k] += a[k] * b[k];
        }
    }
    sums.iter().sum::<f64>() + rest
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
    }
}
