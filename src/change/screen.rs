//! Which places may have changed: a grid of hits and misses to which every observation is added once.
//!
//! A cell is counted while at least two observations have a hit in it. It keeps, for each pass, how many
//! observations hit and missed it. This is a sum over pairs of cell and observation, so it depends neither
//! on the order of arrival nor on what was moved or removed in between. Sites are judged elsewhere: a change
//! must not be missed here, a false candidate only costs time.

mod cell_key;
mod counted_cell;
mod fit;
mod grid;
mod recorded;
mod reliability;
mod selection;
mod sites;

use std::collections::BTreeSet;

use self::cell_key::{CELL_M, CellKey, key_of};
use self::counted_cell::{CountedCell, HITS_TO_COUNT, PassCounts, PassKey};
pub use self::fit::{Agreement, Fit};
use self::grid::{CellGrid, TILE_RADIUS_M};
pub use self::recorded::{ObservationKey, Screened};
use self::recorded::{Recorded, RecordedObservations};
pub use self::reliability::Reliability;
pub use self::selection::JUDGED_WITHIN_M;
pub use self::sites::{CandidateSite, SURROUNDINGS_M};
use crate::geometry::Vector2;
use crate::observation::{Observation, Outcome, REACH_M, Visibility};

/// The grid of one layer.
#[derive(Default)]
pub struct Screen {
    recorded: RecordedObservations,
    grid: CellGrid,
    /// Cells whose history differs from when they were last judged.
    touched: BTreeSet<CellKey>,
}

impl Screen {
    /// Updates the grid to all observations of a map.
    pub fn update<'a>(&mut self, observations: impl Iterator<Item = Screened<'a>>) {
        let mut gone: BTreeSet<ObservationKey> = self.recorded.keys().collect();
        let mut come = Vec::new();
        for screened in observations {
            if self.recorded.holds(&screened) {
                gone.remove(&screened.key);
            } else {
                come.push(screened);
            }
        }
        for key in gone {
            self.remove(key);
        }
        for screened in come {
            self.add(&screened);
        }
        let grid = &mut self.grid;
        self.touched.retain(|key| {
            grid.get_mut(*key).is_none_or(|cell| {
                cell.candidate = cell.has_change();
                if cell.before == Some(cell.signature()) {
                    cell.before = None;
                }
                cell.before.is_some()
            })
        });
    }

    /// Marks all touched cells as judged.
    pub fn mark_judged(&mut self) {
        for key in std::mem::take(&mut self.touched) {
            if let Some(cell) = self.grid.get_mut(key) {
                cell.before = None;
            }
        }
    }

    fn add(&mut self, screened: &Screened<'_>) {
        let recorded = Recorded::of(screened);
        for key in hit_cells(&recorded.observation) {
            let cell = self.grid.entry(key);
            cell.hit_by += 1;
            if cell.hit_by == HITS_TO_COUNT {
                cell.touch();
                self.touched.insert(key);
                // Earlier observations are tested against the new cell.
                let geometry = cell.geometry();
                let reach = Vector2::repeat(REACH_M);
                let (low, high) = (geometry.centre - reach, geometry.centre + reach);
                for before in self.recorded.between(&low, &high) {
                    cell.count(before.pass, before.observation.test(&geometry), true);
                }
            }
        }
        self.count_all(&recorded.observation, recorded.pass, true);
        self.recorded.insert(&screened.map_from_base, recorded);
    }

    fn remove(&mut self, key: ObservationKey) {
        let Some(recorded) = self.recorded.take(&key) else {
            return;
        };
        self.count_all(&recorded.observation, recorded.pass, false);
        for key in hit_cells(&recorded.observation) {
            let Some(cell) = self.grid.get_mut(key) else {
                continue;
            };
            cell.hit_by -= 1;
            if cell.hit_by == 0 {
                self.grid.remove(key);
            } else if !cell.is_counted() {
                cell.clear();
            }
        }
    }

    /// Adds an observation to every cell within reach, or removes it.
    fn count_all(&mut self, observation: &Observation, pass: PassKey, adds: bool) {
        let touched = &mut self.touched;
        let (low, high) = box_in_reach(observation);
        self.grid.visit_tiles(&low, &high, |middle, cells| {
            let visibility = observation.visibility_of(middle, TILE_RADIUS_M, 0.5 * CELL_M);
            if visibility == Visibility::Hidden {
                return;
            }
            for cell in cells.iter_mut().filter(|cell| cell.is_counted()) {
                let outcome = observation.test(&cell.geometry());
                if outcome != Outcome::Unknown {
                    if cell.touch() {
                        touched.insert(cell.key);
                    }
                    cell.count(pass, outcome, adds);
                }
            }
        });
    }

    /// Approximate size in memory, bytes.
    pub fn size_bytes(&self) -> usize {
        let cells = self.grid.cells();
        let cells: usize = cells
            .map(|cell| size_of::<CountedCell>() + cell.passes.capacity() * size_of::<PassCounts>())
            .sum();
        cells + self.recorded.len() * (size_of::<Recorded>() + OBSERVATION_BYTES)
    }
}

/// Size of an observation's index entries, bytes; its ranges are shared with the map.
const OBSERVATION_BYTES: usize = 128;

/// The box within an observation's reach, map frame, metres.
fn box_in_reach(observation: &Observation) -> (Vector2<f64>, Vector2<f64>) {
    let (eye, reach) = (observation.eye(), Vector2::repeat(observation.reach_m()));
    (eye - reach, eye + reach)
}

fn hit_cells(observation: &Observation) -> BTreeSet<CellKey> {
    observation.hits().map(|hit| key_of(&hit)).collect()
}

#[cfg(test)]
mod tests;
