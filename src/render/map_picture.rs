//! A map's picture in every format that the API offers.

use super::{Decided, MapImageError, OccupancyGrid, PosedScan, to_pgm, to_png, to_yaml};

/// Edge of a cell of a map's picture, metres.
pub const MAP_RESOLUTION_M: f64 = 0.05;
/// The name of the PGM in the YAML file that goes with it.
const PGM_NAME: &str = "map.pgm";

/// A map's picture in the three formats.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct MapPicture {
    /// For people.
    pub png: Vec<u8>,
    /// For ROS's `map_server`.
    pub pgm: Vec<u8>,
    /// The description that goes with the PGM.
    pub yaml: String,
}

impl MapPicture {
    /// Draws scans as [`OccupancyGrid::from_posed_scans`] counts them. The same scans and changes make the
    /// same bytes.
    ///
    /// # Errors
    /// [`MapImageError`].
    pub fn draw<'a>(
        scans: impl IntoIterator<Item = PosedScan<'a>>,
        decided: Decided<'_>,
    ) -> Result<Self, MapImageError> {
        Self::of_grid(&OccupancyGrid::from_posed_scans(
            scans,
            decided,
            MAP_RESOLUTION_M,
        ))
    }

    /// The picture of a grid.
    ///
    /// # Errors
    /// [`MapImageError`].
    pub fn of_grid(grid: &OccupancyGrid) -> Result<Self, MapImageError> {
        Ok(Self {
            png: to_png(grid)?,
            pgm: to_pgm(grid),
            yaml: to_yaml(grid, PGM_NAME),
        })
    }
}
