//! Bytes to core types and back: uploads, recordings of other programs, pictures of maps.

pub mod batch_json;
pub mod edges_json;
pub mod evidence_svg;
pub mod g2o;
pub mod json;

mod carmen;
mod carmen_line;
mod cells;
mod map_image;
mod map_picture;
mod occupancy;
mod plot_svg;

pub use carmen::{CarmenClock, CarmenError, CarmenLog, CarmenScan};
pub use carmen_line::SkipReason;
pub use map_image::{MapImageError, to_pgm, to_png, to_yaml};
pub use map_picture::{MAP_RESOLUTION_M, MapPicture};
pub use occupancy::{CELLS_MAX, Look, Occupancy, OccupancyGrid};
pub use plot_svg::{Crossing, Curve, Guide, Plot, to_svg};
