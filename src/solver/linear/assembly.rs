//! Assembles a front from the matrix's values and its children's updates.

use super::block_matrix::BlockMatrix;
use super::front::Front;

/// Fills a front's columns with the own variables' diagonal blocks, damped, and their pairs with
/// later variables.
#[inline(always)]
pub(super) fn fill_columns<const B: usize>(
    front: &Front,
    columns: &mut [f64],
    matrix: &BlockMatrix<B>,
    (damping, least): (f64, f64),
) {
    columns.fill(0.0);
    let stride = front.stride;
    let own = &front.rows[..front.width];
    let all = columns.chunks_exact_mut((B * stride).max(1));
    for ((k, &variable), columns) in own.iter().enumerate().zip(all) {
        let diagonal = &matrix.diagonal[variable as usize].data.0;
        for (c, (column, new)) in columns.chunks_exact_mut(stride).zip(diagonal).enumerate() {
            let block = &mut column[k * B..k * B + B];
            block.copy_from_slice(new);
            block[c] += damping * new[c].abs().max(least);
        }
    }
    for coupling in &front.couplings {
        let block = &matrix.blocks[coupling.pair as usize].data.0;
        let columns = &mut columns[coupling.at as usize..];
        for c in 0..B {
            let column = &mut columns[c * stride..c * stride + B];
            for (r, value) in column.iter_mut().enumerate() {
                *value += if coupling.is_turned {
                    block[r][c]
                } else {
                    block[c][r]
                };
            }
        }
    }
}

/// Puts the own variables' right-hand side into the row for it.
#[inline(always)]
pub(super) fn fill_right_row<const B: usize>(front: &Front, columns: &mut [f64], x: &[f64]) {
    let (blocks, right) = (x.as_chunks::<B>().0, front.right_row::<B>());
    let own = &front.rows[..front.width];
    let values = own.iter().flat_map(|&variable| blocks[variable as usize]);
    for (column, value) in columns.chunks_exact_mut(front.stride).zip(values) {
        column[right] = value;
    }
}

/// Reads y of L y = x out of it, once the front is factored.
#[inline(always)]
pub(super) fn read_right_row<const B: usize>(front: &Front, columns: &[f64], x: &mut [f64]) {
    let (blocks, right) = (x.as_chunks_mut::<B>().0, front.right_row::<B>());
    let solved = columns.chunks_exact((B * front.stride).max(1));
    for (columns, &variable) in solved.zip(&front.rows) {
        let block = &mut blocks[variable as usize];
        for (value, column) in block.iter_mut().zip(columns.chunks_exact(front.stride)) {
            *value = column[right];
        }
    }
}

/// A child's update on its way into its parent.
pub(super) struct FromChild<'a> {
    pub(super) parent: &'a Front,
    pub(super) child: &'a Front,
    pub(super) update: &'a [f64],
}

impl FromChild<'_> {
    /// Adds the part of the update that belongs to the columns which the parent eliminates.
    #[inline(always)]
    pub(super) fn add_to_columns<const B: usize>(&self, columns: &mut [f64]) {
        let in_parent = &self.child.in_parent;
        if !in_parent.are_ascending {
            return self.add_unordered::<B>(columns, true);
        }
        for j in 0..in_parent.eliminated {
            let at = in_parent.rows[j] as usize * self.parent.stride;
            self.add_column_block::<B>(j, &mut columns[at..], self.parent.stride, 0);
        }
    }

    /// Adds the rest of it to the parent's own update.
    #[inline(always)]
    pub(super) fn add_to_update<const B: usize>(&self, update: &mut [f64]) {
        let in_parent = &self.child.in_parent;
        if !in_parent.are_ascending {
            return self.add_unordered::<B>(update, false);
        }
        let (stride, width) = (self.parent.update_stride(), self.parent.width * B);
        for j in in_parent.eliminated..in_parent.rows.len() {
            let at = (in_parent.rows[j] as usize - width) * stride;
            self.add_column_block::<B>(j, &mut update[at..], stride, self.parent.skipped);
        }
    }

    /// Adds the child's jth B columns to these, which lack the first rows of the parent.
    #[inline(always)]
    fn add_column_block<const B: usize>(
        &self,
        j: usize,
        to: &mut [f64],
        stride: usize,
        lacks: usize,
    ) {
        let (child, own_stride) = (self.child, self.child.update_stride());
        // Where the jth row below stands in the child's columns.
        let first = (child.width + j) * B - child.skipped;
        let from = &self.update[j * B * own_stride..(j + 1) * B * own_stride];
        let (at, right) = (
            child.right_row::<B>() - child.skipped,
            self.parent.right_row::<B>() - lacks,
        );
        for c in 0..B {
            to[c * stride + right] += from[c * own_stride + at];
        }
        for (i, &row) in child.in_parent.rows[j..].iter().enumerate() {
            let (at, row) = (first + i * B, row as usize - lacks);
            for c in 0..B {
                let from = &from[c * own_stride + at..][..B];
                let to = &mut to[c * stride + row..][..B];
                for (to, from) in to.iter_mut().zip(from) {
                    *to += from;
                }
            }
        }
    }

    /// The same where the rows stand in another order in the parent: a block that would come
    /// above the diagonal is turned over.
    #[inline(never)]
    fn add_unordered<const B: usize>(&self, to: &mut [f64], to_columns: bool) {
        let (child, parent) = (self.child, self.parent);
        let (own_stride, width) = (child.update_stride(), parent.width * B);
        let first = child.width * B - child.skipped;
        let (stride, column_first, lacks) = if to_columns {
            (parent.stride, 0, 0)
        } else {
            (parent.update_stride(), width, parent.skipped)
        };
        let rows = &child.in_parent.rows;
        for (j, &column) in rows.iter().enumerate() {
            if ((column as usize) < width) == to_columns {
                let from =
                    &self.update[j * B * own_stride + child.right_row::<B>() - child.skipped..];
                let to = &mut to
                    [(column as usize - column_first) * stride + parent.right_row::<B>() - lacks..];
                for c in 0..B {
                    to[c * stride] += from[c * own_stride];
                }
            }
            for (i, &row) in rows.iter().enumerate().skip(j) {
                let (row, column) = (row as usize, column as usize);
                let is_turned = row < column;
                let (row, column) = (row.max(column), row.min(column));
                if (column < width) != to_columns {
                    continue;
                }
                let from = &self.update[j * B * own_stride + first + i * B..];
                let to = &mut to[(column - column_first) * stride + row - lacks..];
                for c in 0..B {
                    for r in 0..B {
                        let at = if is_turned {
                            r * stride + c
                        } else {
                            c * stride + r
                        };
                        to[at] += from[c * own_stride + r];
                    }
                }
            }
        }
    }
}
