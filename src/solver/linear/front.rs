//! A dense matrix in which some variables are eliminated: where its numbers are, and what they
//! are made from.

use std::ops::Range;

use super::block_matrix::BlockMatrix;
use super::dense::PADDING;
use super::elimination::Part;

/// No front, no variable.
pub(super) const NONE: u32 = u32::MAX;

/// A dense matrix in which the first `width` of `rows` are eliminated. Below its rows it has one
/// more scalar row, for a right-hand side that is brought along.
#[derive(Debug)]
pub(super) struct Front {
    pub(super) rows: Vec<u32>,
    pub(super) width: usize,
    pub(super) parent: u32,
    pub(super) children: Vec<u32>,
    /// The length of a column of L, and where the first one starts.
    pub(super) stride: usize,
    pub(super) columns_at: usize,
    /// This many of L's rows are not in the update's columns.
    pub(super) skipped: usize,
    pub(super) update_at: usize,
    pub(super) is_in_use: bool,
    /// Pairs of the matrix that are filled in here.
    pub(super) couplings: Vec<Coupling>,
    pub(super) in_parent: InParent,
}

/// An own variable's pair with a later one.
#[derive(Debug, Clone, Copy)]
pub(super) struct Coupling {
    pub(super) pair: u32,
    /// Where its block begins in the front's columns.
    pub(super) at: u32,
    /// Whether the pair's rows are the own variable's, and must become columns.
    pub(super) is_turned: bool,
}

/// Where the rows below a front are in its parent.
#[derive(Debug, Default)]
pub(super) struct InParent {
    /// The first scalar row of each, in the order of the front's own rows.
    pub(super) rows: Vec<u32>,
    pub(super) are_ascending: bool,
    /// If they are: how many of them the parent eliminates.
    pub(super) eliminated: usize,
}

impl Front {
    pub(super) fn new<const B: usize>(part: Part) -> Self {
        Self {
            width: part.width,
            parent: NONE,
            children: part.children,
            stride: (part.rows.len() * B + 1).next_multiple_of(PADDING),
            columns_at: 0,
            skipped: part.width * B / PADDING * PADDING,
            update_at: 0,
            is_in_use: true,
            rows: part.rows,
            couplings: Vec::new(),
            in_parent: InParent::default(),
        }
    }

    /// Notes which pairs are filled in here. `place` has the front's rows, by variable; what it
    /// has for others is of no use.
    pub(super) fn find_couplings<const B: usize>(
        &mut self,
        matrix: &BlockMatrix<B>,
        place: &[u32],
    ) {
        for (k, &variable) in self.rows[..self.width].iter().enumerate() {
            for (other, pair, is_column) in matrix.coupled(variable) {
                let row = place[other as usize] as usize;
                if row > k && self.rows.get(row) == Some(&other) {
                    self.couplings.push(Coupling {
                        pair: pair as u32,
                        at: ((k * self.stride + row) * B) as u32,
                        is_turned: !is_column,
                    });
                }
            }
        }
    }

    /// Notes where its rows below are in its parent, which is `width` wide; `place` has the
    /// parent's rows.
    pub(super) fn find_in_parent<const B: usize>(&mut self, width: usize, place: &[u32]) {
        let (below, found) = (&self.rows[self.width..], &mut self.in_parent);
        found.rows.clear();
        let rows = below.iter().map(|&v| place[v as usize] * B as u32);
        found.rows.extend(rows);
        found.are_ascending = found.rows.is_sorted();
        found.eliminated = found
            .rows
            .partition_point(|&row| (row as usize) < width * B);
    }

    pub(super) fn columns<const B: usize>(&self) -> Range<usize> {
        self.columns_at..self.columns_at + self.width * B * self.stride
    }

    pub(super) fn update_stride(&self) -> usize {
        self.stride - self.skipped
    }

    pub(super) fn update<const B: usize>(&self) -> Range<usize> {
        let columns = (self.rows.len() - self.width) * B;
        self.update_at..self.update_at + columns * self.update_stride()
    }

    /// The scalar row of the right-hand side.
    pub(super) fn right_row<const B: usize>(&self) -> usize {
        self.rows.len() * B
    }

    pub(super) fn below(&self) -> &[u32] {
        &self.rows[self.width..]
    }
}
