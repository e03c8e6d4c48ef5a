//! Where a front's numbers are.

use std::ops::Range;

use super::dense::PADDING;
use super::elimination::Part;

/// No front, no variable.
pub(super) const NONE: u32 = u32::MAX;

/// A dense matrix in which the first `width` of `rows` are eliminated.
#[derive(Debug)]
pub(super) struct Front {
    pub(super) rows: Vec<u32>,
    pub(super) width: usize,
    pub(super) parent: u32,
    pub(super) children: Vec<u32>,
    /// The length of a column of L, and where the first one starts.
    pub(super) stride: usize,
    pub(super) columns_at: usize,
    /// So many of L's rows are not in the update's columns.
    pub(super) skipped: usize,
    pub(super) update_at: usize,
    pub(super) is_in_use: bool,
}

impl Front {
    pub(super) fn new<const B: usize>(part: Part) -> Self {
        Self {
            width: part.width,
            parent: NONE,
            children: part.children,
            stride: (part.rows.len() * B).next_multiple_of(PADDING),
            columns_at: 0,
            skipped: part.width * B / PADDING * PADDING,
            update_at: 0,
            is_in_use: true,
            rows: part.rows,
        }
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

    pub(super) fn below(&self) -> &[u32] {
        &self.rows[self.width..]
    }
}
