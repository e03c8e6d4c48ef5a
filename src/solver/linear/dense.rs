//! Dense kernels on columns of vectors.
//!
//! All matrices are kept by columns, each padded to a multiple of [`PADDING`] rows with zeros, so
//! that a column is a whole number of vectors whatever the processor.

use pulp::Simd;

/// The longest vector of any supported processor, in numbers.
pub(super) const PADDING: usize = 8;

/// How many vectors of a column are worked on at a time: with three columns of them, the
/// products and the factors fill sixteen registers.
const VECTORS: usize = 4;

/// Factors the first `width` columns of a symmetric matrix of which only these columns are
/// given: the lower triangle and everything below becomes L, with the *reciprocals* of L's
/// diagonal on the diagonal. What is above the diagonal is of no use afterwards. `width` is a
/// multiple of B. `false` if a pivot is not positive.
#[inline(always)]
pub(super) fn factor_columns<S: Simd, const B: usize>(
    simd: S,
    columns: &mut [f64],
    stride: usize,
    width: usize,
) -> bool {
    for k in (0..width).step_by(B) {
        let (done, rest) = columns.split_at_mut(k * stride);
        let own = &mut rest[..B * stride];
        let top = k / S::F64_LANES * S::F64_LANES;
        if k > 0 {
            let factors = Factors {
                columns: done,
                stride,
                top,
                row: k,
            };
            factors.subtract::<S, B, true>(simd, own, stride, top);
        }
        let Some(pivot) = cholesky_of_block::<B>(own, stride, k) else {
            return false;
        };
        scale_columns::<S, B>(simd, own, stride, top, &pivot);
        for (column, l) in pivot.iter().enumerate() {
            own[column * stride + k..][column..B].copy_from_slice(&l[column..]);
        }
    }
    true
}

/// Sets the lower triangle of a symmetric matrix to −P Pᵀ, where P are the rows of some
/// columns from `first` on. Row r of the matrix is kept at r + `first` − `skipped`.
#[inline(always)]
pub(super) fn set_to_minus_square<S: Simd, const B: usize>(
    simd: S,
    matrix: &mut [f64],
    stride: usize,
    skipped: usize,
    columns: &[f64],
    column_stride: usize,
    first: usize,
) {
    for (k, own) in matrix.chunks_exact_mut(B * stride).enumerate() {
        let row = first + k * B;
        let top = (row - skipped) / S::F64_LANES * S::F64_LANES;
        let factors = Factors {
            columns,
            stride: column_stride,
            top: top + skipped,
            row,
        };
        factors.subtract::<S, B, false>(simd, own, stride, top);
    }
}

/// Columns, of which the rows from `top` on are multiplied with the B rows from `row` on.
struct Factors<'a> {
    columns: &'a [f64],
    stride: usize,
    top: usize,
    row: usize,
}

impl Factors<'_> {
    /// own[r, c] −= Σ_j columns[r, j] columns[row + c, j] for the rows of `own` from `top` on;
    /// what was there before counts only if it `IS_GIVEN`.
    #[inline(always)]
    fn subtract<S: Simd, const B: usize, const IS_GIVEN: bool>(
        &self,
        simd: S,
        own: &mut [f64],
        stride: usize,
        top: usize,
    ) {
        let lanes = S::F64_LANES;
        let vectors = (stride - top) / lanes;
        let mut at = 0;
        macro_rules! rows {
            ($count:expr) => {
                self.subtract_rows::<S, B, { $count }, IS_GIVEN>(simd, own, stride, top, at)
            };
        }
        while vectors - at >= VECTORS {
            rows!(VECTORS);
            at += VECTORS;
        }
        match vectors - at {
            3 => rows!(3),
            2 => rows!(2),
            1 => rows!(1),
            _ => {}
        }
    }

    /// The same for V vectors of rows, `at` vectors from `top`.
    #[inline(always)]
    fn subtract_rows<S: Simd, const B: usize, const V: usize, const IS_GIVEN: bool>(
        &self,
        simd: S,
        own: &mut [f64],
        stride: usize,
        top: usize,
        at: usize,
    ) {
        let rows = V * S::F64_LANES;
        let from = self.top + at * S::F64_LANES;
        let mut sums = [[simd.splat_f64s(0.0); V]; B];
        for column in self.columns.chunks_exact(self.stride) {
            let values = S::as_simd_f64s(&column[from..from + rows]).0;
            let factors = &column[self.row..self.row + B];
            for b in 0..B {
                let factor = simd.splat_f64s(factors[b]);
                for v in 0..V {
                    sums[b][v] = simd.mul_add_e_f64s(factor, values[v], sums[b][v]);
                }
            }
        }
        let to = top + at * S::F64_LANES;
        for b in 0..B {
            let own = &mut own[b * stride + to..b * stride + to + rows];
            let own = S::as_mut_simd_f64s(own).0;
            for v in 0..V {
                own[v] = if IS_GIVEN {
                    simd.sub_f64s(own[v], sums[b][v])
                } else {
                    simd.neg_f64s(sums[b][v])
                };
            }
        }
    }
}

/// L of the block at row k, by columns, reciprocals on its diagonal.
#[inline(always)]
fn cholesky_of_block<const B: usize>(
    own: &[f64],
    stride: usize,
    k: usize,
) -> Option<[[f64; B]; B]> {
    // L with ones on its diagonal first, so that no column waits for a root.
    let mut l = [[0.0; B]; B];
    let mut scaled = [[0.0; B]; B];
    for c in 0..B {
        for r in c..B {
            let mut value = own[c * stride + k + r];
            for j in 0..c {
                value -= scaled[j][r] * l[j][c];
            }
            scaled[c][r] = value;
        }
        let pivot = scaled[c][c];
        // A pivot that is not a number is refused too.
        if !(pivot > 0.0 && pivot.is_finite()) {
            return None;
        }
        let inverse = 1.0 / pivot;
        l[c][c] = inverse;
        for r in c + 1..B {
            l[c][r] = scaled[c][r] * inverse;
        }
    }
    for c in 0..B {
        l[c][c] = l[c][c].sqrt();
        for r in c + 1..B {
            l[c][r] = scaled[c][r] * l[c][c];
        }
    }
    Some(l)
}

/// own ← own L⁻ᵀ for the rows from `top` on.
#[inline(always)]
fn scale_columns<S: Simd, const B: usize>(
    simd: S,
    own: &mut [f64],
    stride: usize,
    top: usize,
    l: &[[f64; B]; B],
) {
    let lanes = S::F64_LANES;
    for row in (top..stride).step_by(lanes) {
        let mut solved = [simd.splat_f64s(0.0); B];
        for c in 0..B {
            let at = c * stride + row;
            let target = &mut S::as_mut_simd_f64s(&mut own[at..at + lanes]).0[0];
            let mut value = *target;
            for j in 0..c {
                let factor = simd.splat_f64s(l[j][c]);
                value = simd.negate_mul_add_e_f64s(factor, solved[j], value);
            }
            solved[c] = simd.mul_f64s(value, simd.splat_f64s(l[c][c]));
            *target = solved[c];
        }
    }
}

/// Solves L x = y for the columns' own rows, the first in y, and subtracts L x from the rows
/// below. What is left of y's own rows is of no use.
#[inline(always)]
pub(super) fn forward<S: Simd, const B: usize>(
    simd: S,
    columns: &[f64],
    stride: usize,
    y: &mut [f64],
    x: &mut [f64],
) {
    for (block, own) in columns.chunks_exact(B * stride).enumerate() {
        let k = block * B;
        let mut solved = [0.0; B];
        for c in 0..B {
            let mut value = y[k + c];
            for j in 0..c {
                value -= own[j * stride + k + c] * solved[j];
            }
            solved[c] = value * own[c * stride + k + c];
        }
        x[k..k + B].copy_from_slice(&solved);
        let top = (k + B) / S::F64_LANES * S::F64_LANES;
        let below = S::as_mut_simd_f64s(&mut y[top..stride]).0;
        for c in 0..B {
            let factor = simd.splat_f64s(solved[c]);
            let column = S::as_simd_f64s(&own[c * stride + top..(c + 1) * stride]).0;
            for (value, l) in below.iter_mut().zip(column) {
                *value = simd.negate_mul_add_e_f64s(factor, *l, *value);
            }
        }
    }
}

/// Solves Lᵀ y = x for the columns' own rows, the first in y, given y below them. y's own rows
/// must be zero at first.
#[inline(always)]
pub(super) fn backward<S: Simd, const B: usize>(
    simd: S,
    columns: &[f64],
    stride: usize,
    y: &mut [f64],
    x: &[f64],
) {
    for (block, own) in columns.chunks_exact(B * stride).enumerate().rev() {
        let k = block * B;
        let top = (k + B) / S::F64_LANES * S::F64_LANES;
        let mut sums = [simd.splat_f64s(0.0); B];
        let below = S::as_simd_f64s(&y[top..stride]).0;
        for c in 0..B {
            let column = S::as_simd_f64s(&own[c * stride + top..(c + 1) * stride]).0;
            for (value, l) in below.iter().zip(column) {
                sums[c] = simd.mul_add_e_f64s(*value, *l, sums[c]);
            }
        }
        for c in (0..B).rev() {
            let mut value = x[k + c] - simd.reduce_sum_f64s(sums[c]);
            for r in c + 1..B {
                value -= own[c * stride + k + r] * y[k + r];
            }
            y[k + c] = value * own[c * stride + k + c];
        }
    }
}
