//! Cells of the screen by index, and their centres.

use crate::geometry::Vector2;

/// Width of a cell, metres.
pub const CELL_M: f64 = 0.08;

/// Column and row of a cell, counted from the map's origin.
pub type CellKey = (i32, i32);

/// The cell that holds a point.
pub fn key_of(point: &Vector2<f64>) -> CellKey {
    let key = |v: f64| (v / CELL_M).floor() as i32;
    (key(point.x), key(point.y))
}

/// The centre of a cell, map frame, metres.
pub fn centre_of(key: CellKey) -> Vector2<f64> {
    let centre = |k: i32| (f64::from(k) + 0.5) * CELL_M;
    Vector2::new(centre(key.0), centre(key.1))
}
