//! What a front begins with: the matrix's own values, and its children's updates.

use super::block_matrix::BlockMatrix;
use super::front::Front;

/// A front's own columns while they are filled.
pub(super) struct Assembly<'a, const B: usize> {
    front: &'a Front,
    columns: &'a mut [f64],
    /// By variable; of use only for the front's rows.
    place: &'a [u32],
}

impl<'a, const B: usize> Assembly<'a, B> {
    /// A front whose columns are zero.
    #[inline(always)]
    pub(super) fn new(front: &'a Front, columns: &'a mut [f64], place: &'a [u32]) -> Self {
        Self {
            front,
            columns,
            place,
        }
    }

    /// Adds the own variables' diagonal blocks, damped, and their pairs' with later variables.
    #[inline(always)]
    pub(super) fn add_matrix(&mut self, matrix: &BlockMatrix<B>, (damping, least): (f64, f64)) {
        let rows = &self.front.rows;
        let stride = self.front.stride;
        for (k, &variable) in rows[..self.front.width].iter().enumerate() {
            let own = &mut self.columns[k * B * stride..(k + 1) * B * stride];
            let diagonal = &matrix.diagonal[variable as usize].data.0;
            for (c, (column, new)) in own.chunks_exact_mut(stride).zip(diagonal).enumerate() {
                add_block(&mut column[k * B..], new);
                column[k * B + c] += damping * new[c].abs().max(least);
            }
            for (other, pair, is_column) in matrix.coupled(variable) {
                let place = self.place[other as usize] as usize;
                // Places of variables that are not in this front are left from another.
                if place <= k || rows.get(place) != Some(&other) {
                    continue;
                }
                let block = &matrix.blocks[pair];
                let turned = block.transpose();
                let block = if is_column { block } else { &turned };
                for (column, new) in own.chunks_exact_mut(stride).zip(&block.data.0) {
                    add_block(&mut column[place * B..], new);
                }
            }
        }
    }

    /// Adds a child's update, to the own columns and to the front's update.
    #[inline(always)]
    pub(super) fn add_child(
        &mut self,
        child: &Front,
        of_child: &[f64],
        update: &mut [f64],
        places: &mut Vec<u32>,
    ) {
        let below = &child.rows[child.width..];
        places.clear();
        places.extend(below.iter().map(|&v| self.place[v as usize]));
        let is_ascending = places.is_sorted();
        let child_stride = child.update_stride();
        // Where the child's first row below stands in its update's columns.
        let first = child.width * B - child.skipped;
        let (width, stride) = (self.front.width, self.front.stride);
        let (update_stride, skipped) = (self.front.update_stride(), self.front.skipped);
        for (j, sources) in of_child.chunks_exact((B * child_stride).max(1)).enumerate() {
            let place = places[j] as usize;
            if !is_ascending {
                self.add_unordered(&sources[first..], child_stride, places, j, update);
                continue;
            }
            let (targets, stride, lacks) = if place < width {
                (&mut self.columns[place * B * stride..], stride, 0)
            } else {
                let at = (place - width) * B * update_stride;
                (&mut update[at..], update_stride, skipped)
            };
            let targets = targets.chunks_exact_mut(stride);
            for (target, source) in targets.zip(sources.chunks_exact(child_stride)) {
                let blocks = source[first + j * B..].as_chunks::<B>().0;
                for (new, &place) in blocks.iter().zip(&places[j..]) {
                    add_block(&mut target[place as usize * B - lacks..], new);
                }
            }
        }
    }

    /// A column of the front, and how many rows it lacks at its top.
    #[inline(always)]
    fn column<'b>(&'b mut self, column: usize, update: &'b mut [f64]) -> (usize, &'b mut [f64]) {
        let width = self.front.width * B;
        if column < width {
            let at = column * self.front.stride;
            (0, &mut self.columns[at..at + self.front.stride])
        } else {
            let stride = self.front.update_stride();
            let at = (column - width) * stride;
            (self.front.skipped, &mut update[at..at + stride])
        }
    }

    /// Adds B columns of a child whose rows stand in another order in this front: a block that
    /// would come above the diagonal is turned over.
    #[inline(never)]
    fn add_unordered(
        &mut self,
        columns: &[f64],
        stride: usize,
        places: &[u32],
        j: usize,
        update: &mut [f64],
    ) {
        for (i, &place) in places.iter().enumerate().skip(j) {
            for c in 0..B {
                for r in 0..B {
                    let value = columns[c * stride + i * B + r];
                    let row = place as usize * B + r;
                    let column = places[j] as usize * B + c;
                    let (row, column) = if place < places[j] {
                        (column, row)
                    } else {
                        (row, column)
                    };
                    let (lacks, target) = self.column(column, update);
                    target[row - lacks] += value;
                }
            }
        }
    }
}

#[inline(always)]
fn add_block<const B: usize>(to: &mut [f64], new: &[f64; B]) {
    if let Some(to) = to.first_chunk_mut::<B>() {
        for (to, new) in to.iter_mut().zip(new) {
            *to += new;
        }
    }
}
