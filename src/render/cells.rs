//! The cells that a straight line goes through.

use crate::geometry::Vector2;

/// Visits each cell (column, row) that the straight way from `start` to `end` goes through, once,
/// in order, without the cell in which it ends. Coordinates are in cells and not negative.
///
/// The cells to cross are counted as integers first, so that rounding can neither miss the last
/// cell nor run past it (traversal after Amanatides and Woo, 1987).
pub(super) fn for_each_cell_before_end(
    start: &Vector2<f64>,
    end: &Vector2<f64>,
    mut visit: impl FnMut(usize, usize),
) {
    let mut x = Axis::new(start.x, end.x);
    let mut y = Axis::new(start.y, end.y);
    while x.crossings_left + y.crossings_left > 0 {
        visit(x.cell, y.cell);
        if y.crossings_left == 0 || (x.crossings_left > 0 && x.next_crossing <= y.next_crossing) {
            x.cross();
        } else {
            y.cross();
        }
    }
}

/// One coordinate of a way through the cells; the way's parameter runs from 0 to 1.
struct Axis {
    cell: usize,
    crossings_left: usize,
    forward: bool,
    next_crossing: f64,
    crossing_step: f64,
}

impl Axis {
    fn new(start: f64, end: f64) -> Self {
        let (cell, last) = (start as usize, end as usize);
        let forward = last >= cell;
        let border = cell as f64 + if forward { 1.0 } else { 0.0 };
        let length = end - start;
        Self {
            cell,
            crossings_left: cell.abs_diff(last),
            forward,
            next_crossing: (border - start) / length,
            crossing_step: 1.0 / length.abs(),
        }
    }

    fn cross(&mut self) {
        self.cell = if self.forward {
            self.cell + 1
        } else {
            self.cell - 1
        };
        self.crossings_left -= 1;
        self.next_crossing += self.crossing_step;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_way_visits_exactly_the_cells_it_crosses(
            sx in 0.0..12.0_f64, sy in 0.0..12.0_f64, ex in 0.0..12.0_f64, ey in 0.0..12.0_f64,
        ) {
            let (start, end) = (Vector2::new(sx, sy), Vector2::new(ex, ey));
            let mut visited = Vec::new();
            for_each_cell_before_end(&start, &end, |c, r| visited.push((c, r)));
            visited.push((ex as usize, ey as usize));
            prop_assert_eq!(visited[0], (sx as usize, sy as usize));
            for pair in visited.windows(2) {
                let moved = pair[0].0.abs_diff(pair[1].0) + pair[0].1.abs_diff(pair[1].1);
                prop_assert_eq!(moved, 1);
            }
            for column in 0..12 {
                for row in 0..12 {
                    let crossed = |grow: f64| {
                        // The part of the way that lies in the box (slab method).
                        let (mut from, mut to) = (0.0_f64, 1.0_f64);
                        for (s, d, low) in [(sx, ex - sx, column as f64), (sy, ey - sy, row as f64)] {
                            let a = (low - grow - s) / d;
                            let b = (low + 1.0 + grow - s) / d;
                            from = from.max(a.min(b));
                            to = to.min(a.max(b));
                        }
                        from <= to
                    };
                    let seen = visited.iter().filter(|&&v| v == (column, row)).count();
                    prop_assert!(seen <= 1);
                    if crossed(-1e-9) { prop_assert_eq!(seen, 1); }
                    if seen == 1 { prop_assert!(crossed(1e-9)); }
                }
            }
        }
    }
}
