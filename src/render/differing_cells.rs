//! In how many cells two maps differ: the one rule by which previews, replays and versions count.

use serde::Serialize;

use super::{Occupancy, OccupancyGrid};
use crate::geometry::Vector2;

/// How many cells differ; each counts once.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct DifferingCells {
    /// Free before, occupied now.
    pub to_occupied: u64,
    /// Occupied before, free now.
    pub to_free: u64,
    /// Free or occupied before, unknown now.
    pub to_unknown: u64,
    /// Unknown before, free or occupied now.
    pub from_unknown: u64,
}

impl DifferingCells {
    /// Counts one cell; nothing if it has not changed.
    pub(super) fn count(&mut self, before: Occupancy, now: Occupancy) {
        use Occupancy::{Free, Occupied, Unknown};
        match (before, now) {
            (Free, Occupied) => self.to_occupied += 1,
            (Occupied, Free) => self.to_free += 1,
            (Free | Occupied, Unknown) => self.to_unknown += 1,
            (Unknown, Free | Occupied) => self.from_unknown += 1,
            (Free, Free) | (Occupied, Occupied) | (Unknown, Unknown) => {}
        }
    }
}

/// The cells that differ between two grids of the same map. Outside a grid everything is unknown.
pub fn differing_cells(before: &OccupancyGrid, now: &OccupancyGrid) -> DifferingCells {
    let mut differing = DifferingCells::default();
    for (centre, occupancy) in cells(before) {
        if now.cell_at(&centre).is_none() {
            differing.count(occupancy, Occupancy::Unknown);
        }
    }
    for (centre, occupancy) in cells(now) {
        let earlier = before.cell_at(&centre);
        let earlier = earlier.map_or(Occupancy::Unknown, |(column, row)| {
            before.occupancy(column, row)
        });
        differing.count(earlier, occupancy);
    }
    differing
}

/// The centre of each cell, map frame, metres, and its occupancy.
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
    fn a_wall_that_moves_away_frees_the_cells_before_it() {
        let (near, far) = (grid(1.0), grid(2.0));
        assert_eq!(differing_cells(&near, &near), DifferingCells::default());
        let freed = DifferingCells {
            to_free: 1,
            from_unknown: 20,
            ..DifferingCells::default()
        };
        assert_eq!(differing_cells(&near, &far), freed);
        let hidden = DifferingCells {
            to_occupied: 1,
            to_unknown: 20,
            ..DifferingCells::default()
        };
        assert_eq!(differing_cells(&far, &near), hidden);
    }
}
