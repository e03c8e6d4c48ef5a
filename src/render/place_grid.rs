//! Hits and misses of a place, cell by cell, before a change and since.

use super::cells::for_each_cell_before_end;
use super::{Occupancy, PosedScan};
use crate::geometry::Vector2;
use crate::model::PassSide;
use crate::observation::{Observation, reach_m};

/// Edge of a cell, metres; doubled until there are no more than [`CELLS_MAX`].
const RESOLUTION_M: f64 = 0.05;
/// Most cells of a place.
const CELLS_MAX: f64 = 250_000.0;
/// Surroundings shown on each side of a region, metres.
const MARGIN_M: f64 = 2.5;
/// A cell is occupied if at least this share of its hits and misses are hits.
const OCCUPIED_SHARE_MIN: f64 = 0.15;

/// A grid round a place that counts observations.
///
/// An observation hits the cells in which its beams end, and misses those that its beams only went through.
/// A beam without a return counts for nothing.
#[derive(Debug, Clone, PartialEq)]
pub struct PlaceGrid {
    /// Edge of a cell, metres.
    pub resolution_m: f64,
    /// The lower left corner of cell (0, 0), map frame, metres.
    pub origin: Vector2<f64>,
    /// Cells along x.
    pub width: usize,
    /// Cells along y.
    pub height: usize,
    /// Observations before the change.
    pub before: SideCells,
    /// Observations since.
    pub since: SideCells,
}

/// The cells of one side, row by row from the lowest y.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct SideCells {
    /// Position of the lidar at each observation that hits or misses a cell, map frame, metres.
    pub eyes: Vec<Vector2<f64>>,
    /// Observations that hit each cell.
    pub hits: Vec<u32>,
    /// Observations that missed it.
    pub misses: Vec<u32>,
}

impl SideCells {
    /// The occupancy of a cell by its hits and misses.
    pub fn occupancy(&self, cell: usize) -> Occupancy {
        let (hits, misses) = (f64::from(self.hits[cell]), f64::from(self.misses[cell]));
        if hits + misses == 0.0 {
            Occupancy::Unknown
        } else if hits > 0.0 && hits >= OCCUPIED_SHARE_MIN * (hits + misses) {
            Occupancy::Occupied
        } else {
            Occupancy::Free
        }
    }
}

impl PlaceGrid {
    /// Whether a cell or one of its neighbours is occupied: a surface on the border of two cells is hit in
    /// either.
    pub fn is_hit_near(&self, side: &SideCells, cell: usize) -> bool {
        let (column, row) = (cell % self.width, cell / self.width);
        let columns = column.saturating_sub(1)..(column + 2).min(self.width);
        let mut rows = row.saturating_sub(1)..(row + 2).min(self.height);
        rows.any(|row| {
            let mut cells = columns.clone().map(|column| row * self.width + column);
            cells.any(|cell| side.occupancy(cell) == Occupancy::Occupied)
        })
    }

    /// An empty grid round a region; round the origin without one.
    pub fn around(region: &[Vector2<f64>]) -> Self {
        let first = region.first().copied().unwrap_or_default();
        let low = region.iter().fold(first, |low, corner| low.inf(corner));
        let high = region.iter().fold(first, |high, corner| high.sup(corner));
        let margin = Vector2::repeat(MARGIN_M);
        let (low, high) = (low - margin, high + margin);
        let mut resolution_m = RESOLUTION_M;
        loop {
            let first = (low / resolution_m).map(f64::floor);
            let size = (high / resolution_m).map(f64::ceil) - first;
            if size.x * size.y <= CELLS_MAX {
                let (width, height) = (size.x as usize, size.y as usize);
                let side = SideCells {
                    eyes: Vec::new(),
                    hits: vec![0; width * height],
                    misses: vec![0; width * height],
                };
                return Self {
                    resolution_m,
                    origin: first * resolution_m,
                    width,
                    height,
                    before: side.clone(),
                    since: side,
                };
            }
            resolution_m *= 2.0;
        }
    }

    /// Counts scans, each on its side. Cost: beams × cells a beam.
    #[must_use]
    pub fn with_scans<'a>(
        mut self,
        scans: impl IntoIterator<Item = (PassSide, PosedScan<'a>)>,
    ) -> Self {
        let mut counted_by = vec![0; self.width * self.height];
        for (number, (side, scan)) in (1..).zip(scans) {
            let cells = self.touched_by(&scan, number, &mut counted_by);
            let Some((hits, misses)) = cells else {
                continue;
            };
            let side = match side {
                PassSide::Before => &mut self.before,
                PassSide::Since => &mut self.since,
            };
            hits.into_iter().for_each(|cell| side.hits[cell] += 1);
            misses.into_iter().for_each(|cell| side.misses[cell] += 1);
            let mount = scan.scan.lidar().mount;
            let eye = scan.map_from_base.compose(&mount).translation();
            side.eyes.push(eye);
        }
        self
    }

    /// The cells that a scan hits and those that it misses, each once; `None` if there are none.
    fn touched_by(
        &self,
        scan: &PosedScan<'_>,
        number: u32,
        counted_by: &mut [u32],
    ) -> Option<(Vec<usize>, Vec<usize>)> {
        let lidar = scan.scan.lidar();
        let observation = Observation::new(scan.scan, &scan.map_from_base);
        let to_cells = |point: &Vector2<f64>| (point - self.origin) / self.resolution_m;
        let (eye, reach_m) = (observation.eye(), reach_m(lidar));
        let (mut hits, mut misses) = (Vec::new(), Vec::new());
        let mut count = |cell: usize, cells: &mut Vec<usize>| {
            if counted_by[cell] != number {
                counted_by[cell] = number;
                cells.push(cell);
            }
        };
        for hit in observation.hits() {
            if let Some(cell) = self.cell_at(&to_cells(&hit)) {
                count(cell, &mut hits);
            }
        }
        for beam in 0..scan.scan.beam_count() {
            let Some(end) = observation.end_of(beam) else {
                continue;
            };
            let (way, range_m) = (end - eye, (end - eye).norm());
            let (clear_from_m, clear_to_m) = lidar.band.map_or((0.0, reach_m), |view| {
                (view.clear_from_m, view.clear_to_m.min(reach_m))
            });
            if range_m <= clear_from_m {
                continue;
            }
            let start = to_cells(&(eye + way * (clear_from_m / range_m)));
            let stop = to_cells(&(eye + way * (clear_to_m / range_m).min(1.0)));
            if let Some((start, stop)) = self.clipped(&start, &stop) {
                for_each_cell_before_end(&start, &stop, |column, row| {
                    if column < self.width && row < self.height {
                        count(row * self.width + column, &mut misses);
                    }
                });
            }
        }
        (!hits.is_empty() || !misses.is_empty()).then_some((hits, misses))
    }

    fn cell_at(&self, in_cells: &Vector2<f64>) -> Option<usize> {
        let is_inside = in_cells.x >= 0.0
            && in_cells.y >= 0.0
            && in_cells.x < self.width as f64
            && in_cells.y < self.height as f64;
        is_inside.then(|| in_cells.y as usize * self.width + in_cells.x as usize)
    }

    /// The part of a way that lies in the grid (after Liang and Barsky, 1984).
    fn clipped(
        &self,
        start: &Vector2<f64>,
        stop: &Vector2<f64>,
    ) -> Option<(Vector2<f64>, Vector2<f64>)> {
        let size = Vector2::new(self.width as f64, self.height as f64);
        let way = stop - start;
        let (mut from, mut to) = (0.0_f64, 1.0_f64);
        for k in 0..2 {
            if way[k] == 0.0 {
                if !(0.0..=size[k]).contains(&start[k]) {
                    return None;
                }
                continue;
            }
            let (a, b) = (-start[k] / way[k], (size[k] - start[k]) / way[k]);
            from = from.max(a.min(b));
            to = to.min(a.max(b));
        }
        let inside = |share: f64| (start + way * share).sup(&Vector2::zeros()).inf(&size);
        (from < to).then(|| (inside(from), inside(to)))
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::geometry::Pose2;
    use crate::ids::StampNs;
    use crate::observation::testing::{World, all_round};

    fn region() -> Vec<Vector2<f64>> {
        [[2.0, 0.9], [2.4, 0.9], [2.4, 1.3], [2.0, 1.3]]
            .map(Vector2::from)
            .to_vec()
    }

    fn cell(grid: &PlaceGrid, x: f64, y: f64) -> usize {
        let in_cells = (Vector2::new(x, y) - grid.origin) / grid.resolution_m;
        grid.cell_at(&in_cells).unwrap()
    }

    fn seen(worlds: [&World; 2]) -> PlaceGrid {
        let lidar = Arc::new(all_round(1440));
        let pose = |k: u32| Pose2::new(-3.0 + 0.5 * f64::from(k), 0.1, 0.2);
        let sides = [PassSide::Before, PassSide::Since].into_iter().zip(worlds);
        let taken = sides.flat_map(|(side, world)| {
            let lidar = lidar.clone();
            (0..5).map(move |k| (side, pose(k), world.scan(&lidar, 1440, &pose(k), || 0.0)))
        });
        let taken: Vec<_> = taken.collect();
        PlaceGrid::around(&region()).with_scans(taken.iter().map(|(side, map_from_base, scan)| {
            let (stamp, map_from_base) = (StampNs(0), *map_from_base);
            let scan = PosedScan {
                stamp,
                map_from_base,
                scan,
                untied: None,
            };
            (*side, scan)
        }))
    }

    #[test]
    fn a_box_is_hit_since_where_it_was_free_before() {
        let room = World::default().with_rectangle([-4.0, -2.0], [4.02, 2.0]);
        let with_box = World::default()
            .with_rectangle([-4.0, -2.0], [4.02, 2.0])
            .with_rectangle([2.02, 0.92], [2.38, 1.28]);
        let grid = seen([&room, &with_box]);
        assert_eq!((grid.before.eyes.len(), grid.since.eyes.len()), (5, 5));
        let near = cell(&grid, 2.03, 1.1);
        assert_eq!(grid.before.occupancy(near), Occupancy::Free);
        assert_eq!(grid.since.occupancy(near), Occupancy::Occupied);
        assert_eq!((grid.before.hits[near], grid.before.misses[near]), (0, 5));
        let inside = cell(&grid, 2.2, 1.1);
        assert_eq!(grid.before.occupancy(inside), Occupancy::Free);
        assert_eq!(grid.since.occupancy(inside), Occupancy::Unknown);
        let wall = cell(&grid, 4.02, -1.0);
        assert_eq!(grid.before.occupancy(wall), Occupancy::Occupied);
        assert_eq!(grid.since.occupancy(wall), Occupancy::Occupied);
        // A cell is counted once for each observation.
        let most = |side: &SideCells| {
            let counts = side.hits.iter().zip(&side.misses);
            counts.map(|(hits, misses)| hits + misses).max()
        };
        assert_eq!(most(&grid.before), Some(5));
        assert_eq!(most(&grid.since), Some(5));
    }

    #[test]
    fn beyond_walls_nothing_is_said() {
        let room = World::default().with_rectangle([-4.0, -2.0], [4.0, 0.6]);
        let grid = seen([&room, &room]);
        let hidden = cell(&grid, 2.2, 1.1);
        assert_eq!(grid.before.occupancy(hidden), Occupancy::Unknown);
        let elsewhere = World::default().with_rectangle([-4.0, -0.4], [-0.6, 0.5]);
        assert!(seen([&elsewhere, &room]).before.eyes.is_empty());
    }

    #[test]
    fn large_places_have_coarser_cells() {
        let grid = PlaceGrid::around(&[Vector2::zeros(), Vector2::new(60.0, 40.0)]);
        assert_eq!(grid.resolution_m, 0.2);
        assert!(grid.width * grid.height <= CELLS_MAX as usize);
        assert!(grid.origin.x <= -2.5 && grid.origin.y <= -2.5);
    }
}
