//! The cells of a site: every place where an observation has a hit.

use std::ops::Index;

use super::Site;
use crate::change::nearness::Nearness;
use crate::geometry::Vector2;
use crate::observation::{Cell, CellBuilder};

/// Width of a cell, metres.
pub const CELL_M: f64 = 0.06;
/// Cells within this distance contribute to a cell's normal, in cells.
const NEIGHBOURS: usize = 3;

/// Cells of a site, in the order of their places.
pub struct SiteCells {
    cells: Vec<Cell>,
}

impl SiteCells {
    /// The cells within a distance of the candidates with hits of some observations; one in `every`, in a
    /// chequered pattern.
    pub fn of(
        site: &Site<'_>,
        observations: impl Iterator<Item = usize>,
        within_m: f64,
        every: i64,
    ) -> Self {
        let near = Nearness::to(site.candidates);
        let mut grid = Grid::over(&near, within_m);
        let (centre, radius_m) = near.circle(within_m);
        for k in observations {
            let observation = &site.observations[k].observation;
            let eye = observation.eye();
            for hit in observation.hits_near(&centre, radius_m) {
                if let Some(builder) = grid.at_mut(&hit) {
                    builder.add(&hit, &eye);
                }
            }
        }
        let mut kept = Self { cells: Vec::new() };
        for (place, builder) in grid.hit() {
            if near.holds(&builder.mean(), within_m) && grid.is_taken(place, every) {
                kept.cells.push(builder.build(grid.around(place)));
            }
        }
        kept
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.cells.len()
    }
}

impl Index<usize> for SiteCells {
    type Output = Cell;

    fn index(&self, cell: usize) -> &Cell {
        &self.cells[cell]
    }
}

/// The cells round some points, column by column.
struct Grid {
    origin: Vector2<f64>,
    columns: usize,
    rows: usize,
    builders: Vec<CellBuilder>,
}

impl Grid {
    /// The cells belong to one grid of the map, so that overlapping sites share them.
    fn over(near: &Nearness, margin_m: f64) -> Self {
        let margin = Vector2::repeat(margin_m);
        let (low, high) = near.bounds();
        let low = ((low - margin) / CELL_M).map(f64::floor);
        let high = ((high + margin) / CELL_M).map(f64::ceil);
        let size = (high - low).map(|cells| cells.max(0.0) as usize);
        Self {
            origin: low * CELL_M,
            columns: size.x,
            rows: size.y,
            builders: vec![CellBuilder::default(); size.x * size.y],
        }
    }

    fn at_mut(&mut self, point: &Vector2<f64>) -> Option<&mut CellBuilder> {
        let at = (point - self.origin) / CELL_M;
        let is_inside = at.x >= 0.0 && at.y >= 0.0;
        let (column, row) = (at.x as usize, at.y as usize);
        if !is_inside || column >= self.columns || row >= self.rows {
            return None;
        }
        self.builders.get_mut(column * self.rows + row)
    }

    /// Cells with hits, with their indices.
    fn hit(&self) -> impl Iterator<Item = (usize, &CellBuilder)> {
        let builders = self.builders.iter().enumerate();
        builders.filter(|(_, builder)| builder.is_hit())
    }

    fn is_taken(&self, place: usize, every: i64) -> bool {
        let at = (self.origin / CELL_M).map(|cells| cells.round() as i64);
        let (column, row) = (place / self.rows, place % self.rows);
        (at.x + column as i64 + at.y + row as i64).rem_euclid(every) == 0
    }

    /// A cell and its neighbours, those with hits.
    fn around(&self, place: usize) -> impl Iterator<Item = &CellBuilder> {
        let (column, row) = (place / self.rows, place % self.rows);
        let span = |at: usize, count: usize| {
            at.saturating_sub(NEIGHBOURS)..(at + NEIGHBOURS + 1).min(count)
        };
        let rows = span(row, self.rows);
        let columns = span(column, self.columns);
        let near = columns.flat_map(move |column| {
            let first = column * self.rows;
            &self.builders[first + rows.start..first + rows.end]
        });
        near.filter(|builder| builder.is_hit())
    }
}
