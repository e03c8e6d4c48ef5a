//! Pictures: of maps, of the evidence of an alert, of curves.
//!
//! Knows scans, changes and series; knows nothing of files or of who scans at them. Begin with
//! [`MapPicture::draw`].

pub mod evidence_svg;
pub mod place_svg;

mod cells;
mod decided;
mod differing_cells;
mod map_difference;
mod map_image;
mod map_picture;
mod occupancy;
mod place_grid;
mod plot_svg;
mod svg_text;
mod tiles;

pub use decided::Decided;
pub use differing_cells::{DifferingCells, differing_cells};
pub use map_difference::MapDifference;
pub use map_image::{MapImageError, to_pgm, to_png, to_yaml};
pub use map_picture::{MAP_RESOLUTION_M, MapPicture};
pub use occupancy::{CELLS_MAX, Occupancy, OccupancyGrid, PosedScan, untied_trips};
pub use place_grid::{PlaceGrid, SideCells};
pub use plot_svg::{Crossing, Curve, Guide, Plot, to_svg};
pub use tiles::{MapRaster, TILE_PIXELS, ZOOM_MAX};
