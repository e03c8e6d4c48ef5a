//! Nearest neighbours by square cells.

use super::cloud::Neighbour;
use crate::geometry::Vector2;

/// Cells for each point: as many as leave about a point in each cell that a surface crosses.
const CELLS_PER_POINT: f64 = 8.0;
/// Shortest edge of a cell, metres.
const CELL_MIN_M: f64 = 0.02;
/// Most cells along a side.
const SIDE_CELLS_MAX: f64 = 4_096.0;

/// Points sorted by cell, row by row, so that neighbouring cells of a row are one slice.
pub(super) struct PointGrid {
    positions: Vec<Vector2<f64>>,
    origin: Vector2<f64>,
    cell_m: f64,
    cells_per_m: f64,
    width: usize,
    height: usize,
    /// Places of the points given before and after each.
    beside: Vec<[u32; 2]>,
    /// Where each cell begins in `positions`, and the end of the last.
    starts: Vec<u32>,
}

impl PointGrid {
    /// Sorts points, metres; tells with it each place's index among those given. `None` if there
    /// are none.
    pub(super) fn new(points: &[Vector2<f64>]) -> Option<(Self, Vec<u32>)> {
        let first = points.first()?;
        let bounds = (*first, *first);
        let (low, high) = points.iter().fold(bounds, |(low, high), p| {
            (
                Vector2::new(low.x.min(p.x), low.y.min(p.y)),
                Vector2::new(high.x.max(p.x), high.y.max(p.y)),
            )
        });
        let size = high - low;
        let by_area_m = (size.x * size.y / (CELLS_PER_POINT * points.len() as f64)).sqrt();
        let by_side_m = size.x.max(size.y) / SIDE_CELLS_MAX;
        let cell_m = by_area_m.max(by_side_m).max(CELL_MIN_M);
        let mut grid = Self {
            positions: Vec::new(),
            beside: Vec::new(),
            origin: low,
            cell_m,
            cells_per_m: 1.0 / cell_m,
            width: (size.x / cell_m) as usize + 1,
            height: (size.y / cell_m) as usize + 1,
            starts: Vec::new(),
        };
        let order = grid.sort(points);
        Some((grid, order))
    }

    /// A stable counting sort.
    fn sort(&mut self, points: &[Vector2<f64>]) -> Vec<u32> {
        let cells: Vec<u32> = points.iter().map(|p| self.cell_of(p) as u32).collect();
        let mut starts = vec![0u32; self.width * self.height + 1];
        for &cell in &cells {
            starts[cell as usize] += 1;
        }
        let mut end = 0;
        for start in &mut starts {
            end += *start;
            *start = end;
        }
        let mut order = vec![0u32; points.len()];
        // From the back: each end becomes a start, and equal cells keep their order.
        for (k, &cell) in cells.iter().enumerate().rev() {
            let place = &mut starts[cell as usize];
            *place -= 1;
            order[*place as usize] = k as u32;
        }
        self.starts = starts;
        let mut places = vec![0u32; points.len()];
        for (place, &k) in order.iter().enumerate() {
            places[k as usize] = place as u32;
        }
        let last = points.len() - 1;
        self.beside = order
            .iter()
            .map(|&k| {
                let k = k as usize;
                [places[k.saturating_sub(1)], places[(k + 1).min(last)]]
            })
            .collect();
        self.positions = order.iter().map(|&k| points[k as usize]).collect();
        order
    }

    fn cell_of(&self, point: &Vector2<f64>) -> usize {
        self.row(point.y) * self.width + self.column(point.x)
    }

    /// The row of a y, or the one nearest to it.
    #[inline]
    fn row(&self, y: f64) -> usize {
        let row = ((y - self.origin.y) * self.cells_per_m) as i32;
        (row.max(0) as usize).min(self.height - 1)
    }

    #[inline]
    fn column(&self, x: f64) -> usize {
        let column = ((x - self.origin.x) * self.cells_per_m) as i32;
        (column.max(0) as usize).min(self.width - 1)
    }

    pub(super) fn position(&self, index: usize) -> Vector2<f64> {
        self.positions[index]
    }

    /// The nearest point within a distance; a point that is known to be near bounds the search.
    pub(super) fn nearest(
        &self,
        point: &Vector2<f64>,
        distance_max_m: f64,
        near: Option<usize>,
    ) -> Option<Neighbour> {
        let mut looking = Looking {
            grid: self,
            point: *point,
            // So that a point at just that distance is still found.
            least_m2: distance_max_m * distance_max_m * (1.0 + 2.0 * f64::EPSILON),
            index: NONE,
        };
        if let Some(near) = near {
            looking.compare(near, &self.positions[near]);
            looking.walk(near, 0);
            looking.walk(near, 1);
        }
        if looking.least_m2 < self.cell_m * self.cell_m {
            looking.scan_square();
        } else {
            let row = self.row(point.y);
            // Whatever lies in the same cell bounds the search as well.
            let cell = row * self.width + self.column(point.x);
            looking.scan(cell, cell + 1);
            looking.rows_from(row);
        }
        (looking.index != NONE).then_some(Neighbour {
            index: looking.index,
            distance_squared_m2: looking.least_m2,
        })
    }
}

/// No index.
const NONE: usize = usize::MAX;

/// A search under way.
struct Looking<'a> {
    grid: &'a PointGrid,
    point: Vector2<f64>,
    /// A point must be nearer than this, m².
    least_m2: f64,
    /// The nearest point so far, or [`NONE`].
    index: usize,
}

impl Looking<'_> {
    /// Takes a point if it is the nearest so far.
    #[inline]
    fn compare(&mut self, index: usize, position: &Vector2<f64>) {
        let (dx, dy) = (position.x - self.point.x, position.y - self.point.y);
        let distance_m2 = dx * dx + dy * dy;
        if distance_m2 < self.least_m2 {
            self.least_m2 = distance_m2;
            self.index = index;
        }
    }

    /// Steps to one side, until two in a row lead no nearer.
    #[inline]
    fn walk(&mut self, from: usize, side: usize) {
        let (mut place, mut in_vain) = (from, 0);
        while in_vain < 2 {
            let next = self.grid.beside[place][side] as usize;
            if next == place {
                return;
            }
            place = next;
            self.compare(place, &self.grid.positions[place]);
            in_vain = if self.index == place { 0 } else { in_vain + 1 };
        }
    }

    /// The points of the cells from one to before another.
    #[inline]
    fn scan(&mut self, from_cell: usize, to_cell: usize) {
        let starts = &self.grid.starts;
        let (from, to) = (starts[from_cell] as usize, starts[to_cell] as usize);
        for (k, position) in self.grid.positions[from..to].iter().enumerate() {
            self.compare(from + k, position);
        }
    }

    /// All cells of the square around a circle that is smaller than a cell: at most three by
    /// three.
    #[inline]
    fn scan_square(&mut self) {
        let (grid, reach_m) = (self.grid, self.least_m2.sqrt());
        let first = grid.column(self.point.x - reach_m);
        let last = grid.column(self.point.x + reach_m);
        for row in grid.row(self.point.y - reach_m)..grid.row(self.point.y + reach_m) + 1 {
            let cells = row * grid.width;
            self.scan(cells + first, cells + last + 1);
        }
    }

    /// All rows within reach, from one outwards.
    fn rows_from(&mut self, row: usize) {
        let grid = self.grid;
        self.scan_row(row);
        let mut below = row;
        let mut above = row + 1;
        loop {
            let to_below_m = self.point.y - (grid.origin.y + below as f64 * grid.cell_m);
            let to_above_m = grid.origin.y + above as f64 * grid.cell_m - self.point.y;
            let goes_below = below > 0 && self.reaches(to_below_m);
            let goes_above = above < grid.height && self.reaches(to_above_m);
            if !goes_below && !goes_above {
                return;
            }
            if goes_below {
                below -= 1;
                self.scan_row(below);
            }
            if goes_above {
                self.scan_row(above);
                above += 1;
            }
        }
    }

    fn reaches(&self, distance_m: f64) -> bool {
        distance_m <= 0.0 || distance_m * distance_m < self.least_m2
    }

    fn scan_row(&mut self, row: usize) {
        let reach_m = self.least_m2.sqrt();
        let first = self.grid.column(self.point.x - reach_m);
        let last = self.grid.column(self.point.x + reach_m);
        let cells = row * self.grid.width;
        self.scan(cells + first, cells + last + 1);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn check(points: &[Vector2<f64>], from: &Vector2<f64>, gate_m: f64, near: Option<usize>) {
        let (grid, order) = PointGrid::new(points).unwrap();
        let brute = points
            .iter()
            .map(|p| (p - from).norm_squared())
            .filter(|&d| d <= gate_m * gate_m)
            .min_by(f64::total_cmp);
        let found = grid.nearest(from, gate_m, near);
        assert_eq!(found.map(|n| n.distance_squared_m2), brute);
        if let Some(found) = found {
            let point = points[order[found.index] as usize];
            assert_eq!(point, grid.position(found.index));
            assert_eq!((point - from).norm_squared(), found.distance_squared_m2);
        }
    }

    proptest! {
        #[test]
        fn the_nearest_is_what_brute_force_finds(
            points in proptest::collection::vec((-5.0..5.0_f64, -2.0..2.0_f64), 1..60),
            x in -9.0..9.0_f64, y in -6.0..6.0_f64, gate_m in 0.01..9.0_f64, near in 0usize..60,
        ) {
            let points: Vec<_> = points.into_iter().map(|(x, y)| Vector2::new(x, y)).collect();
            let from = Vector2::new(x, y);
            check(&points, &from, gate_m, None);
            check(&points, &from, gate_m, Some(near % points.len()));
        }

        #[test]
        fn along_a_line_and_on_one_spot_too(
            steps in proptest::collection::vec(0i32..400, 1..60), x in -9.0..9.0_f64, turned in any::<bool>(),
        ) {
            let on_line = |x: f64, y: f64| if turned { Vector2::new(y, x) } else { Vector2::new(x, y) };
            let points: Vec<_> = steps.iter().map(|&k| on_line(f64::from(k) * 0.01, 0.0)).collect();
            check(&points, &on_line(x, 0.3), 20.0, None);
            check(&[points[0]; 9], &on_line(x, 0.3), 20.0, None);
        }
    }

    #[test]
    fn far_apart_points_make_no_giant_of_it() {
        let points = [Vector2::new(-1e6, -1e6), Vector2::new(1e6, 3.0)];
        let (grid, _) = PointGrid::new(&points).unwrap();
        assert!(grid.starts.len() < 1 << 10);
        let thin: Vec<_> = (0..100)
            .map(|k| Vector2::new(f64::from(k) * 1e4, 0.0))
            .collect();
        let (grid, _) = PointGrid::new(&thin).unwrap();
        assert!(grid.starts.len() < 1 << 13);
        assert!(PointGrid::new(&[]).is_none());
    }
}
