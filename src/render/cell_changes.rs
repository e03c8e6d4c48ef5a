//! In how many cells two maps differ.

use serde::Serialize;

use super::{Occupancy, OccupancyGrid};
use crate::geometry::Vector2;

/// Cells that differ, by what they become.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct CellChanges {
    /// Cells that become free.
    pub to_free: usize,
    /// Cells that become occupied.
    pub to_occupied: usize,
    /// Cells of which nothing is known any more.
    pub to_unknown: usize,
}

impl CellChanges {
    fn count(&mut self, before: Occupancy, after: Occupancy) {
        if before == after {
            return;
        }
        match after {
            Occupancy::Free => self.to_free += 1,
            Occupancy::Occupied => self.to_occupied += 1,
            Occupancy::Unknown => self.to_unknown += 1,
        }
    }
}

/// The cells that differ between two grids of the same map, wherever they are; outside a grid nothing is
/// known.
pub fn cell_changes(before: &OccupancyGrid, after: &OccupancyGrid) -> CellChanges {
    let mut changes = CellChanges::default();
    for (cell, then) in cells(before) {
        if after.cell_at(&cell).is_none() {
            changes.count(then, Occupancy::Unknown);
        }
    }
    for (cell, now) in cells(after) {
        let then = before.cell_at(&cell);
        let then = then.map_or(Occupancy::Unknown, |(column, row)| {
            before.occupancy(column, row)
        });
        changes.count(then, now);
    }
    changes
}

/// The centre of each cell, map frame, metres, and what is known of it.
fn cells(grid: &OccupancyGrid) -> impl Iterator<Item = (Vector2<f64>, Occupancy)> + '_ {
    let rows =
        (0..grid.height()).flat_map(|row| (0..grid.width()).map(move |column| (column, row)));
    rows.map(|(column, row)| {
        let in_cells = Vector2::new(column as f64 + 0.5, row as f64 + 0.5);
        let centre = grid.origin() + in_cells * grid.resolution_m();
        (centre, grid.occupancy(column, row))
    })
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::geometry::Pose2;
    use crate::scan::{LaserScan, Lidar};

    /// A lidar at the origin with one beam along +x.
    fn grid(range_m: f64) -> OccupancyGrid {
        let lidar = Lidar {
            angle_min_rad: 0.0,
            angle_increment_rad: 0.1,
            range_min_m: 0.05,
            range_max_m: 20.0,
            mount: Pose2::new(0.0, 0.0, 0.0),
            range_sigma_m: 0.01,
            band: None,
        };
        let scan = LaserScan::new(Arc::new(lidar), [Some(range_m), None]).unwrap();
        let pose = Pose2::new(0.025, 0.025, 0.0);
        OccupancyGrid::from_scans([(pose, &scan)], 0.05)
    }

    #[test]
    fn a_wall_that_is_farther_frees_what_is_before_it() {
        let (near, far) = (grid(1.0), grid(2.0));
        assert_eq!(cell_changes(&near, &near), CellChanges::default());
        let freed = CellChanges {
            to_free: 20,
            to_occupied: 1,
            to_unknown: 0,
        };
        assert_eq!(cell_changes(&near, &far), freed);
        let hidden = CellChanges {
            to_free: 0,
            to_occupied: 1,
            to_unknown: 20,
        };
        assert_eq!(cell_changes(&far, &near), hidden);
    }
}
