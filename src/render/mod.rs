//! Pictures: of maps, of the evidence of an alert, of curves.
//!
//! Knows scans, changes and series; knows nothing of files or of who looks at them. Begin with
//! [`MapPicture::draw`].

pub mod evidence_svg;
pub mod place_svg;

mod cell_changes;
mod cells;
mod map_difference;
mod map_image;
mod map_picture;
mod occupancy;
mod place_grid;
mod plot_svg;
mod svg_text;
mod tiles;

pub use cell_changes::{CellChanges, cell_changes};
pub use map_difference::{DifferingCells, MapDifference};
pub use map_image::{MapImageError, to_pgm, to_png, to_yaml};
pub use map_picture::{MAP_RESOLUTION_M, MapPicture};
pub use occupancy::{CELLS_MAX, Decided, Look, Occupancy, OccupancyGrid};
pub use place_grid::{PlaceGrid, SideCells};
pub use plot_svg::{Crossing, Curve, Guide, Plot, to_svg};
pub use tiles::{MapRaster, TILE_PIXELS, ZOOM_MAX};
