//! Bytes to core types and back: uploads, recordings of other programs, pictures of maps.

pub mod batch_json;
pub mod g2o;
pub mod json;

mod carmen;
mod carmen_line;
mod cells;
mod map_image;
mod occupancy;
mod plot_svg;

pub use carmen::{CarmenClock, CarmenError, CarmenLog, CarmenScan};
pub use carmen_line::SkipReason;
pub use map_image::{MapImageError, to_pgm, to_png, to_yaml};
pub use occupancy::{CELLS_MAX, Occupancy, OccupancyGrid};
pub use plot_svg::{Crossing, Curve, Guide, Plot, to_svg};
