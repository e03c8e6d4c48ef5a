//! The counted cells, in tiles.

use std::collections::BTreeMap;

use super::cell_key::{CELL_M, CellKey, key_of};
use super::counted_cell::CountedCell;
use crate::geometry::Vector2;

/// Cells along a tile.
const TILE_CELLS: i32 = 16;
/// Largest distance from a tile's centre to the centres of its cells, metres.
pub const TILE_RADIUS_M: f64 = 0.5 * std::f64::consts::SQRT_2 * TILE_CELLS as f64 * CELL_M;

/// A tile, in tiles from the map's origin.
type TileKey = (i32, i32);

/// All cells with a hit.
#[derive(Default)]
pub struct CellGrid {
    /// Each tile's cells ascend by key.
    tiles: BTreeMap<TileKey, Vec<CountedCell>>,
}

impl CellGrid {
    /// A cell; it is added if there is none.
    pub fn entry(&mut self, key: CellKey) -> &mut CountedCell {
        let cells = self.tiles.entry(tile_of(key)).or_default();
        let at = cells.partition_point(|cell| cell.key < key);
        if cells.get(at).is_none_or(|cell| cell.key != key) {
            cells.insert(at, CountedCell::new(key));
        }
        &mut cells[at]
    }

    /// A cell.
    pub fn get(&self, key: CellKey) -> Option<&CountedCell> {
        let cells = self.tiles.get(&tile_of(key))?;
        let at = cells.binary_search_by_key(&key, |cell| cell.key).ok()?;
        Some(&cells[at])
    }

    /// A cell, to be changed.
    pub fn get_mut(&mut self, key: CellKey) -> Option<&mut CountedCell> {
        let cells = self.tiles.get_mut(&tile_of(key))?;
        let at = cells.binary_search_by_key(&key, |cell| cell.key).ok()?;
        Some(&mut cells[at])
    }

    /// Removes a cell.
    pub fn remove(&mut self, key: CellKey) {
        let Some(cells) = self.tiles.get_mut(&tile_of(key)) else {
            return;
        };
        cells.retain(|cell| cell.key != key);
        if cells.is_empty() {
            self.tiles.remove(&tile_of(key));
        }
    }

    /// Every cell.
    pub fn cells(&self) -> impl Iterator<Item = &CountedCell> {
        self.tiles.values().flatten()
    }

    /// The cells of all tiles that a box touches; corners in the map frame, metres.
    pub fn cells_between(
        &self,
        low: &Vector2<f64>,
        high: &Vector2<f64>,
    ) -> impl Iterator<Item = &CountedCell> + use<'_> {
        let (low, high) = (tile_of(key_of(low)), tile_of(key_of(high)));
        let columns = low.0..=high.0;
        let tiles = columns.flat_map(move |x| self.tiles.range((x, low.1)..=(x, high.1)));
        tiles.flat_map(|(_, cells)| cells)
    }

    /// Calls `visit` with the centre and the cells of every tile that a box touches.
    pub fn visit_tiles(
        &mut self,
        low: &Vector2<f64>,
        high: &Vector2<f64>,
        mut visit: impl FnMut(&Vector2<f64>, &mut [CountedCell]),
    ) {
        let (low, high) = (tile_of(key_of(low)), tile_of(key_of(high)));
        for x in low.0..=high.0 {
            for (tile, cells) in self.tiles.range_mut((x, low.1)..=(x, high.1)) {
                visit(&middle_of(*tile), cells);
            }
        }
    }
}

/// The centre of a tile, map frame, metres.
fn middle_of(tile: TileKey) -> Vector2<f64> {
    let middle = |k: i32| (f64::from(k) + 0.5) * f64::from(TILE_CELLS) * CELL_M;
    Vector2::new(middle(tile.0), middle(tile.1))
}

fn tile_of(key: CellKey) -> TileKey {
    (key.0.div_euclid(TILE_CELLS), key.1.div_euclid(TILE_CELLS))
}
