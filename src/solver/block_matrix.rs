//! A symmetric sparse matrix of B × B blocks.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::sparse::SymbolicSparseColMatRef;
use faer::sparse::linalg::amd;
use nalgebra::SMatrix;

use super::cholesky::TrianglePattern;

/// Where a pair's block is: a block column, and a place in it (0 is the diagonal).
#[derive(Debug, Clone, Copy)]
pub(super) struct Slot {
    column: usize,
    place: usize,
    /// Whether the pair (a, b) comes as block (b, a) of the lower triangle.
    transposed: bool,
}

/// The lower triangle of a symmetric matrix of B × B blocks, its variables in an order that
/// keeps the Cholesky factor sparse. The values are kept in scalar columns, as faer wants them.
#[derive(Debug)]
pub(super) struct BlockMatrix<const B: usize> {
    position_of_variable: Vec<usize>,
    column_start: Vec<usize>,
    blocks_below: Vec<usize>,
    pub(super) values: Vec<f64>,
}

impl<const B: usize> BlockMatrix<B> {
    /// The matrix for `variables` variables that are coupled in these pairs, and for each pair
    /// the slot of its block; `None` if memory runs out.
    pub(super) fn new(
        variables: usize,
        pairs: &[(usize, usize)],
    ) -> Option<(Self, Vec<Slot>, TrianglePattern)> {
        let position = order_by_minimum_degree(variables, pairs)?;
        let ordered = |&(a, b): &(usize, usize)| {
            let (a, b) = (position[a], position[b]);
            (a.min(b), a.max(b))
        };
        let mut below: Vec<(usize, usize)> = pairs.iter().map(ordered).collect();
        below.sort_unstable();
        below.dedup();
        let mut first_below = vec![0; variables + 1];
        for &(column, _) in &below {
            first_below[column + 1] += 1;
        }
        for c in 0..variables {
            first_below[c + 1] += first_below[c];
        }
        let slots = pairs
            .iter()
            .map(|pair| {
                let (column, row) = ordered(pair);
                let rows = &below[first_below[column]..first_below[column + 1]];
                Slot {
                    column,
                    place: 1 + rows.partition_point(|&(_, r)| r < row),
                    transposed: position[pair.0] < position[pair.1],
                }
            })
            .collect();
        let (matrix, pattern) = Self::with_columns(position, &below, &first_below);
        Some((matrix, slots, pattern))
    }

    fn with_columns(
        position_of_variable: Vec<usize>,
        below: &[(usize, usize)],
        first_below: &[usize],
    ) -> (Self, TrianglePattern) {
        let variables = position_of_variable.len();
        let entries = variables * B * (B + 1) / 2 + below.len() * B * B;
        let mut pattern = TrianglePattern {
            column_pointers: Vec::with_capacity(variables * B + 1),
            row_indices: Vec::with_capacity(entries),
        };
        pattern.column_pointers.push(0);
        let mut column_start = Vec::with_capacity(variables);
        let mut blocks_below = Vec::with_capacity(variables);
        for c in 0..variables {
            let rows = &below[first_below[c]..first_below[c + 1]];
            column_start.push(pattern.row_indices.len());
            blocks_below.push(rows.len());
            for k in 0..B {
                pattern.row_indices.extend(c * B + k..(c + 1) * B);
                for &(_, row) in rows {
                    pattern.row_indices.extend(row * B..(row + 1) * B);
                }
                pattern.column_pointers.push(pattern.row_indices.len());
            }
        }
        let matrix = Self {
            position_of_variable,
            column_start,
            blocks_below,
            values: vec![0.0; entries],
        };
        (matrix, pattern)
    }

    /// Where a variable's first scalar stands in a right-hand side.
    pub(super) fn offset(&self, variable: usize) -> usize {
        self.position_of_variable[variable] * B
    }

    /// The number of scalars.
    pub(super) fn dimension(&self) -> usize {
        self.position_of_variable.len() * B
    }

    fn scalar_column(&self, column: usize, k: usize) -> usize {
        let full = B + B * self.blocks_below[column];
        // Column k of the diagonal block lacks its first k rows.
        self.column_start[column] + k * full - k * k.saturating_sub(1) / 2
    }

    /// Adds to the block of a pair (a, b) of different variables.
    pub(super) fn add_pair(&mut self, slot: Slot, block: &SMatrix<f64, B, B>) {
        for k in 0..B {
            let start = self.scalar_column(slot.column, k) + (B - k) + (slot.place - 1) * B;
            let target = &mut self.values[start..start + B];
            for (row, value) in target.iter_mut().enumerate() {
                // The lower triangle holds the block whose row is the later variable.
                *value += if slot.transposed {
                    block[(k, row)]
                } else {
                    block[(row, k)]
                };
            }
        }
    }

    /// Adds to a variable's diagonal block.
    pub(super) fn add_diagonal(&mut self, variable: usize, block: &SMatrix<f64, B, B>) {
        let column = self.position_of_variable[variable];
        for k in 0..B {
            let start = self.scalar_column(column, k);
            for row in k..B {
                self.values[start + row - k] += block[(row, k)];
            }
        }
    }

    /// The places of the diagonal entries among the values, by scalar.
    pub(super) fn diagonal_places(&self) -> Vec<usize> {
        let columns = 0..self.column_start.len();
        columns
            .flat_map(|c| (0..B).map(move |k| (c, k)))
            .map(|(c, k)| self.scalar_column(c, k))
            .collect()
    }
}

/// An elimination order by approximate minimum degree: for each variable its position.
fn order_by_minimum_degree(variables: usize, pairs: &[(usize, usize)]) -> Option<Vec<usize>> {
    // By columns of the upper triangle: the later variable is the column.
    let mut entries: Vec<(usize, usize)> =
        pairs.iter().map(|&(a, b)| (a.max(b), a.min(b))).collect();
    entries.sort_unstable();
    entries.dedup();
    let mut column_pointers = vec![0; variables + 1];
    for &(column, _) in &entries {
        column_pointers[column + 1] += 1;
    }
    for c in 0..variables {
        column_pointers[c + 1] += column_pointers[c];
    }
    let row_indices: Vec<usize> = entries.iter().map(|&(_, row)| row).collect();
    let upper = SymbolicSparseColMatRef::new_checked(
        variables,
        variables,
        &column_pointers,
        None,
        &row_indices,
    );
    let scratch = amd::order_scratch::<usize>(variables, entries.len());
    let mut memory = MemBuffer::try_new(scratch).ok()?;
    let (mut order, mut position) = (vec![0; variables], vec![0; variables]);
    amd::order(
        &mut order,
        &mut position,
        upper,
        amd::Control::default(),
        MemStack::new(&mut memory),
    )
    .ok()?;
    Some(position)
}
