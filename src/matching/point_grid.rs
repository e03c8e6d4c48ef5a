//! Nearest neighbours by square cells.

use pulp::Simd;

use crate::geometry::Vector2;

/// Cells for each point: as many as leave about a point in each cell that a surface crosses.
const CELLS_PER_POINT: f64 = 8.0;
/// Shortest edge of a cell, metres.
const CELL_MIN_M: f64 = 0.02;
/// How much farther than it must a search looks, as a share of a cell, so that it need not be done
/// again at once.
const SPARE_SHARE: f64 = 0.1;
/// Most cells along a side.
const SIDE_CELLS_MAX: f64 = 4_096.0;

/// Points sorted by cell, row by row, so that neighbouring cells of a row are one slice.
pub(super) struct PointGrid {
    /// Followed by [`PADDING`].
    xs: Vec<f64>,
    ys: Vec<f64>,
    origin: Vector2<f64>,
    cell_m: f64,
    cells_per_m: f64,
    width: usize,
    height: usize,
    /// One less than the width, and the height.
    last_column: f64,
    last_row: f64,
    /// Where each cell begins, and the end of the last.
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
        let (width, height) = (
            (size.x / cell_m) as usize + 1,
            (size.y / cell_m) as usize + 1,
        );
        let mut grid = Self {
            xs: Vec::new(),
            ys: Vec::new(),
            origin: low,
            cell_m,
            cells_per_m: 1.0 / cell_m,
            width,
            height,
            last_column: (width - 1) as f64,
            last_row: (height - 1) as f64,
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
        let sorted = |coordinate: fn(&Vector2<f64>) -> f64| {
            let sorted = order.iter().map(|&k| coordinate(&points[k as usize]));
            sorted.chain([f64::INFINITY; PADDING]).collect()
        };
        self.xs = sorted(|p| p.x);
        self.ys = sorted(|p| p.y);
        order
    }

    fn cell_of(&self, point: &Vector2<f64>) -> usize {
        self.row(point.y) * self.width + self.column(point.x)
    }

    /// The row of a y, or the one nearest to it.
    #[inline(always)]
    fn row(&self, y: f64) -> usize {
        whole_part(((y - self.origin.y) * self.cells_per_m).min(self.last_row))
    }

    #[inline(always)]
    fn column(&self, x: f64) -> usize {
        whole_part(((x - self.origin.x) * self.cells_per_m).min(self.last_column))
    }

    #[inline(always)]
    pub(super) fn position(&self, index: usize) -> Vector2<f64> {
        Vector2::new(self.xs[index], self.ys[index])
    }

    /// Calls back with every point within a distance, and with some that are a little farther away.
    pub(super) fn around(
        &self,
        point: &Vector2<f64>,
        distance_m: f64,
        mut take: impl FnMut(usize),
    ) {
        let first = self.column(point.x - distance_m);
        let last = self.column(point.x + distance_m);
        for row in self.row(point.y - distance_m)..self.row(point.y + distance_m) + 1 {
            let cells = row * self.width;
            let from = self.starts[cells + first] as usize;
            let to = self.starts[cells + last + 1] as usize;
            (from..to).for_each(&mut take);
        }
    }

    /// The nearest point within a distance; a point that is known to be near bounds the search.
    ///
    /// Of points at the same distance any may be found.
    #[inline(always)]
    pub(super) fn nearest<S: Simd>(
        &self,
        simd: S,
        point: &Vector2<f64>,
        distance_max_m: f64,
        near: Option<usize>,
    ) -> Found {
        let mut reach_m2 = distance_max_m * distance_max_m;
        if let Some(near) = near {
            reach_m2 = reach_m2.min((self.position(near) - point).norm_squared());
        }
        let mut looking = Looking::new(simd, self, point, just_above(reach_m2));
        if reach_m2 < self.cell_m * self.cell_m {
            looking.scan_square();
        } else {
            looking.scan_rows();
        }
        looking.found()
    }
}

/// A point and how far it is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Neighbour {
    /// Of the point, as for [`ReferenceCloud::position`](super::ReferenceCloud::position).
    pub index: usize,
    /// Square of the distance, m².
    pub distance_squared_m2: f64,
}

/// What a search found.
#[derive(Debug, Clone, Copy)]
pub(super) struct Found {
    pub nearest: Option<Neighbour>,
    /// No other point is nearer than this, metres.
    pub others_from_m: f64,
}

/// Points that stand after the last, infinitely far away: at least as many as are compared at a
/// time, less one.
const PADDING: usize = 7;
/// The numbers of the points that are compared at a time.
const LANES: [f64; PADDING + 1] = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0];

/// A search under way, which compares several points at a time.
struct Looking<'a, S: Simd> {
    simd: S,
    grid: &'a PointGrid,
    point: Vector2<f64>,
    xs: S::f64s,
    ys: S::f64s,
    /// Each lane's least squared distance so far, m² …
    least_m2: S::f64s,
    /// … the least of the others …
    second_m2: S::f64s,
    /// … and whose the least is, or infinity.
    index: S::f64s,
    /// The nearest point is no farther than this, m² …
    reach_m2: f64,
    /// … and what is nearer than this is compared, metres.
    clear_m: f64,
}

impl<'a, S: Simd> Looking<'a, S> {
    #[inline(always)]
    fn new(simd: S, grid: &'a PointGrid, point: &Vector2<f64>, reach_m2: f64) -> Self {
        Self {
            simd,
            grid,
            point: *point,
            xs: simd.splat_f64s(point.x),
            ys: simd.splat_f64s(point.y),
            least_m2: simd.splat_f64s(f64::INFINITY),
            second_m2: simd.splat_f64s(f64::INFINITY),
            index: simd.splat_f64s(f64::INFINITY),
            reach_m2,
            clear_m: reach_m2.sqrt() + SPARE_SHARE * grid.cell_m,
        }
    }

    /// The points from one to before another, and perhaps a few more.
    #[inline(always)]
    fn scan(&mut self, from: usize, to: usize) {
        let simd = self.simd;
        let mut index = simd.add_f64s(
            simd.splat_f64s(WHOLE + from as f64),
            first_lanes::<S>(&LANES),
        );
        let step = simd.splat_f64s(S::F64_LANES as f64);
        let mut first = from;
        while first < to {
            let dx = simd.sub_f64s(first_lanes::<S>(&self.grid.xs[first..]), self.xs);
            let dy = simd.sub_f64s(first_lanes::<S>(&self.grid.ys[first..]), self.ys);
            let distance_m2 = simd.add_f64s(simd.mul_f64s(dx, dx), simd.mul_f64s(dy, dy));
            let nearer = simd.less_than_f64s(distance_m2, self.least_m2);
            let farther_m2 = simd.select_f64s(nearer, self.least_m2, distance_m2);
            self.second_m2 = simd.min_f64s(self.second_m2, farther_m2);
            self.least_m2 = simd.select_f64s(nearer, distance_m2, self.least_m2);
            self.index = simd.select_f64s(nearer, index, self.index);
            index = simd.add_f64s(index, step);
            first += S::F64_LANES;
        }
    }

    /// The points of the cells from one to before another.
    #[inline(always)]
    fn scan_cells(&mut self, from: usize, to: usize) {
        let starts = &self.grid.starts;
        self.scan(starts[from] as usize, starts[to] as usize);
    }

    /// What was found bounds the rest.
    #[inline(always)]
    fn shrink(&mut self) {
        let least_m2 = self.simd.reduce_min_f64s(self.least_m2);
        self.reach_m2 = self.reach_m2.min(least_m2);
        self.clear_m = self.reach_m2.sqrt() + SPARE_SHARE * self.grid.cell_m;
    }

    /// All cells of the square around a circle of about a cell: at most three by three.
    #[inline(always)]
    fn scan_square(&mut self) {
        let (grid, clear_m) = (self.grid, self.clear_m);
        for row in grid.row(self.point.y - clear_m)..grid.row(self.point.y + clear_m) + 1 {
            self.scan_row(row);
        }
    }

    /// All rows within reach, from the point's own outwards.
    #[inline(always)]
    fn scan_rows(&mut self) {
        let grid = self.grid;
        let row = grid.row(self.point.y);
        // Whatever lies in the same cell bounds the search.
        let cell = row * grid.width + grid.column(self.point.x);
        self.scan_cells(cell, cell + 1);
        self.shrink();
        *self = Self::new(self.simd, grid, &self.point, self.reach_m2);
        self.scan_row(row);
        self.shrink();
        let mut below = row;
        let mut above = row + 1;
        loop {
            let to_below_m = self.point.y - (grid.origin.y + below as f64 * grid.cell_m);
            let to_above_m = grid.origin.y + above as f64 * grid.cell_m - self.point.y;
            let goes_below = below > 0 && to_below_m < self.clear_m;
            let goes_above = above < grid.height && to_above_m < self.clear_m;
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
            self.shrink();
        }
    }

    #[inline(always)]
    fn scan_row(&mut self, row: usize) {
        let first = self.grid.column(self.point.x - self.clear_m);
        let last = self.grid.column(self.point.x + self.clear_m);
        let cells = row * self.grid.width;
        self.scan_cells(cells + first, cells + last + 1);
    }

    /// The nearest of all lanes; of equals the first in the grid.
    #[inline(always)]
    fn found(&self) -> Found {
        let simd = self.simd;
        let infinity = simd.splat_f64s(f64::INFINITY);
        let least_m2 = simd.reduce_min_f64s(self.least_m2);
        if least_m2 > self.reach_m2 {
            return Found {
                nearest: None,
                others_from_m: self.clear_m.min(least_m2.sqrt()),
            };
        }
        let is_least = simd.equal_f64s(self.least_m2, simd.splat_f64s(least_m2));
        let index = simd.reduce_min_f64s(simd.select_f64s(is_least, self.index, infinity));
        let is_nearest = simd.equal_f64s(self.index, simd.splat_f64s(index));
        let rest_m2 = simd.select_f64s(is_nearest, infinity, self.least_m2);
        let second_m2 = simd.reduce_min_f64s(simd.min_f64s(rest_m2, self.second_m2));
        Found {
            nearest: Some(Neighbour {
                index: index.to_bits() as u32 as usize,
                distance_squared_m2: least_m2,
            }),
            others_from_m: self.clear_m.min(second_m2.sqrt()),
        }
    }
}

/// A bound that the square of just that distance, taken otherwise, still keeps.
#[inline(always)]
fn just_above(squared: f64) -> f64 {
    squared * (1.0 + 2.0 * f64::EPSILON)
}

/// The lowest bits of a number at and above this are its whole part.
const WHOLE: f64 = (1u64 << 52) as f64;

/// The whole part of a number below 2³²; zero of a negative one.
#[inline(always)]
fn whole_part(number: f64) -> usize {
    // Rounds to the nearest, so that half a unit is taken away before.
    ((number - 0.5).max(0.0) + WHOLE).to_bits() as u32 as usize
}

/// As many values as are handled at a time.
#[inline(always)]
fn first_lanes<S: Simd>(values: &[f64]) -> S::f64s {
    S::as_simd_f64s(&values[..S::F64_LANES]).0[0]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn check(points: &[Vector2<f64>], from: &Vector2<f64>, gate_m: f64, near: Option<usize>) {
        let (grid, order) = PointGrid::new(points).unwrap();
        let nearest = points
            .iter()
            .map(|p| (p - from).norm_squared())
            .filter(|&d| d <= gate_m * gate_m)
            .min_by(f64::total_cmp);
        for found in [
            grid.nearest(pulp::Scalar::new(), from, gate_m, near),
            pulp::Arch::new().dispatch(Nearest(&grid, *from, gate_m, near)),
        ] {
            let others =
                (0..points.len()).filter(|&place| found.nearest.map(|n| n.index) != Some(place));
            let distances = others.map(|place| (grid.position(place) - from).norm());
            let others_from_m = distances.fold(f64::INFINITY, f64::min);
            assert!(found.others_from_m <= others_from_m * (1.0 + 1e-12));
            let found = found.nearest;
            assert_eq!(found.map(|n| n.distance_squared_m2), nearest);
            if let Some(found) = found {
                let point = points[order[found.index] as usize];
                assert_eq!(point, grid.position(found.index));
                assert_eq!((point - from).norm_squared(), found.distance_squared_m2);
            }
        }
    }

    struct Nearest<'a>(&'a PointGrid, Vector2<f64>, f64, Option<usize>);

    impl pulp::WithSimd for Nearest<'_> {
        type Output = Found;

        fn with_simd<S: Simd>(self, simd: S) -> Found {
            self.0.nearest(simd, &self.1, self.2, self.3)
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
            let near = near % points.len();
            check(&points, &from, gate_m, Some(near));
            // Indices are the grid's own: the point itself, and any other beside it.
            check(&points, &points[near], gate_m, None);
            for place in 0..points.len() {
                check(&points, &points[near], gate_m, Some(place));
            }
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
