//! How far the observations of one pass err together.
//!
//! Asked are cells that at least two observations hit, where in the view of most passes nothing
//! stands: a pass that shows most of its observations something there errs, or meets what was
//! gone by the next pass.

use std::collections::{BTreeMap, BTreeSet};

use serde::Serialize;

use super::placed::placed_scans;
use super::recording::Recording;
use super::route::RouteRun;
use super::wilson::Share;
use crate::change::{Standpoint, passes};
use crate::geometry::{Vector2, distance_to_polygon};
use crate::observation::{CellBuilder, Observation, Outcome, REACH_M};
use crate::scan::LaserScan;

/// Width of a cell, metres.
const CELL_M: f64 = 0.12;
/// Cells asked for each route: every k-th, so that no more are.
const CELLS_MAX: usize = 20_000;
/// A pass is counted if this many of its observations are hits or misses.
const OBSERVATIONS_MIN: usize = 6;
/// A cell is counted if this many observations hit it, as one that the detector decides about, …
const HITS_MIN: usize = 2;
/// … and this many passes over it are counted.
const PASSES_MIN: usize = 3;
/// Cells this near to an alert may have changed, metres.
const ALERT_M: f64 = 0.5;
/// Observations are found by tiles of this width, metres.
const TILE_M: f64 = 4.0;

/// Counts of unchanged free cells and their passes.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Correlation {
    /// Passes that contradict the majority, of those with at least six observations.
    pub contradicting: Share,
    /// What the correlation within a pass follows from.
    pub(super) sums: Sums,
}

/// Sums over passes of n observations, h of them hits.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub(super) struct Sums {
    observations: f64,
    hits: f64,
    /// Σ n².
    squares: f64,
    /// Σ h²/n.
    hits_squared: f64,
}

impl Correlation {
    /// Measures it on what a map keeps of some recordings. Cells near an alert are left out: there
    /// the world may have changed.
    ///
    /// # Errors
    /// If a scan does not fit its lidar.
    pub(super) fn of(recordings: &[Recording], run: &RouteRun) -> anyhow::Result<Self> {
        let observed = Observed::of(recordings, run)?;
        let mut correlation = Self::default();
        let cells = observed.cells();
        let alerts: Vec<_> = run.alerts.iter().map(|alert| alert.scored()).collect();
        for &key in cells.keys().step_by(cells.len().div_ceil(CELLS_MAX).max(1)) {
            let cell = cell_at(&cells, key);
            let is_near =
                |region: &[Vector2<f64>]| distance_to_polygon(&cell.centre, region) <= ALERT_M;
            let changes = |a: &super::ScoredAlert| a.sides().any(|(_, region)| is_near(region));
            if !alerts.iter().any(changes) {
                correlation.add_cell(&observed.passes_of(&cell));
            }
        }
        Ok(correlation)
    }

    /// The correlation of two observations of one pass (analysis of variance); `None` where
    /// nothing varies.
    pub fn within_pass(&self) -> Option<f64> {
        let Sums {
            observations,
            hits,
            squares,
            hits_squared,
        } = self.sums;
        let groups = self.contradicting.of as f64;
        if groups < 2.0 || hits == 0.0 || observations <= groups {
            return None;
        }
        let between = (hits_squared - hits * hits / observations) / (groups - 1.0);
        let within = (hits - hits_squared) / (observations - groups);
        let size = (observations - squares / observations) / (groups - 1.0);
        Some((between - within) / (between + (size - 1.0) * within))
    }

    /// Adds another route's.
    pub(super) fn merge(&mut self, other: &Self) {
        self.contradicting.hits += other.contradicting.hits;
        self.contradicting.of += other.contradicting.of;
        self.sums.observations += other.sums.observations;
        self.sums.hits += other.sums.hits;
        self.sums.squares += other.sums.squares;
        self.sums.hits_squared += other.sums.hits_squared;
    }

    /// Adds a cell's passes: hits, and hits with misses.
    fn add_cell(&mut self, passes: &[Share]) {
        let counted = || passes.iter().filter(|pass| pass.of >= OBSERVATIONS_MIN);
        let contradicts = |pass: &&Share| 2 * pass.hits > pass.of;
        let contradicting = counted().filter(contradicts).count();
        let hits: usize = passes.iter().map(|pass| pass.hits).sum();
        if hits < HITS_MIN
            || counted().count() < PASSES_MIN
            || 2 * contradicting >= counted().count()
        {
            return;
        }
        self.contradicting.hits += contradicting;
        self.contradicting.of += counted().count();
        for pass in counted() {
            let (hits, of) = (pass.hits as f64, pass.of as f64);
            self.sums.observations += of;
            self.sums.hits += hits;
            self.sums.squares += of * of;
            self.sums.hits_squared += hits * hits / of;
        }
    }
}

/// A cell's place, in cells from the map's origin.
type CellKey = (i64, i64);

/// The observations of a route.
struct Observed {
    /// In the order of trip and time.
    observations: Vec<(Standpoint, Observation)>,
    /// By where the lidar was.
    tiles: BTreeMap<(i64, i64), Vec<usize>>,
}

impl Observed {
    fn of(recordings: &[Recording], run: &RouteRun) -> anyhow::Result<Self> {
        let trips: BTreeSet<_> = recordings.iter().map(|r| &r.trip).collect();
        let numbers: BTreeMap<_, usize> = trips.into_iter().zip(0..).collect();
        let mut observations = Vec::new();
        for recording in recordings {
            for placed in placed_scans(std::slice::from_ref(recording), &run.poses) {
                if !run.observed.contains(&placed.scan.stamp) {
                    continue;
                }
                let ranges_m = placed.scan.ranges_m.iter().copied();
                let scan = LaserScan::new(recording.lidar.clone(), ranges_m)?;
                let standpoint = Standpoint {
                    trip: numbers[&recording.trip],
                    stamp: placed.scan.stamp,
                    eye: placed.map_from_lidar.translation(),
                };
                observations.push((standpoint, Observation::new(&scan, &placed.map_from_base)));
            }
        }
        observations.sort_by_key(|(standpoint, _)| (standpoint.trip, standpoint.stamp));
        let mut tiles: BTreeMap<_, Vec<usize>> = BTreeMap::new();
        for (k, (standpoint, _)) in observations.iter().enumerate() {
            tiles
                .entry(key_of(&standpoint.eye, TILE_M))
                .or_default()
                .push(k);
        }
        Ok(Self {
            observations,
            tiles,
        })
    }

    /// Every cell in which a beam ended.
    fn cells(&self) -> BTreeMap<CellKey, CellBuilder> {
        let mut cells: BTreeMap<CellKey, CellBuilder> = BTreeMap::new();
        for (standpoint, observation) in &self.observations {
            for hit in observation.hits() {
                let cell = cells.entry(key_of(&hit, CELL_M)).or_default();
                cell.add(&hit, &standpoint.eye);
            }
        }
        cells
    }

    /// For each pass over a cell its hits, of hits and misses.
    fn passes_of(&self, cell: &crate::observation::Cell) -> Vec<Share> {
        let (x, y) = key_of(&cell.centre, TILE_M);
        let reach = (REACH_M / TILE_M).ceil() as i64;
        let tiles = (-reach..=reach).flat_map(|i| (-reach..=reach).map(move |j| (x + i, y + j)));
        let mut asked: Vec<usize> = tiles
            .filter_map(|tile| self.tiles.get(&tile))
            .flatten()
            .copied()
            .collect();
        asked.sort_unstable();
        let outcomes = asked.into_iter().filter_map(|k| {
            let (standpoint, observation) = &self.observations[k];
            match observation.test(cell) {
                Outcome::Hit => Some((*standpoint, 1)),
                Outcome::Miss => Some((*standpoint, 0)),
                Outcome::NoReturn | Outcome::Unknown => None,
            }
        });
        let (standpoints, hits): (Vec<Standpoint>, Vec<usize>) = outcomes.unzip();
        let share = |pass: std::ops::Range<usize>| Share {
            of: pass.len(),
            hits: hits[pass].iter().sum(),
        };
        passes(&standpoints).into_iter().map(share).collect()
    }
}

fn cell_at(cells: &BTreeMap<CellKey, CellBuilder>, key: CellKey) -> crate::observation::Cell {
    let around = (-1..=1).flat_map(|i| (-1..=1).map(move |j| (key.0 + i, key.1 + j)));
    let neighbours = around.filter_map(|key| cells.get(&key));
    cells[&key].build(neighbours)
}

fn key_of(point: &Vector2<f64>, width_m: f64) -> (i64, i64) {
    let key = |v: f64| (v / width_m).floor() as i64;
    (key(point.x), key(point.y))
}

#[cfg(test)]
mod tests {
    use super::super::baselines::testing::{posed, room};
    use super::*;
    use crate::geometry::Pose2;
    use crate::sim::Shape;

    fn of(passes: &[(usize, usize)]) -> Correlation {
        let mut correlation = Correlation::default();
        let shares: Vec<_> = (passes.iter())
            .map(|&(hits, of)| Share { hits, of })
            .collect();
        correlation.add_cell(&shares);
        correlation
    }

    #[test]
    fn only_free_cells_with_enough_passes_count() {
        let free = of(&[(0, 8), (7, 8), (1, 6), (3, 3)]);
        assert_eq!(free.contradicting, Share { hits: 1, of: 3 });
        let solid = of(&[(8, 8), (7, 8), (1, 6)]);
        let seldom = of(&[(0, 8), (0, 8), (0, 5)]);
        let undecided = of(&[(8, 8), (7, 8), (0, 8), (0, 8)]);
        for none in [solid, seldom, undecided] {
            assert_eq!(none, Correlation::default());
        }
    }

    #[test]
    fn passes_that_err_as_one_are_correlated_and_others_not() {
        let mut as_one = Correlation::default();
        let mut each_alone = Correlation::default();
        for _ in 0..50 {
            as_one.merge(&of(&[(0, 10), (0, 10), (0, 10), (10, 10)]));
            each_alone.merge(&of(&[(2, 10), (3, 10), (2, 10), (3, 10)]));
        }
        assert!((as_one.within_pass().unwrap() - 1.0).abs() < 1e-9);
        assert!(each_alone.within_pass().unwrap() < 0.0);
        assert_eq!(as_one.contradicting, Share { hits: 50, of: 200 });
        assert_eq!(Correlation::default().within_pass(), None);
    }

    #[test]
    fn what_stands_for_one_pass_is_what_a_pass_gets_wrong() {
        // Five passes of two minutes, in the fourth of which something stands beside the way.
        let mut recordings = room(600, None);
        let person = Shape::rectangle(&Pose2::new(4.0, 1.2, 0.0), 0.4, 0.4);
        let recording = &mut recordings[0];
        for scan in &mut recording.scans[366..480] {
            let eye = scan.odom_from_base.translation();
            let beams = recording.lidar.beam_directions(scan.ranges_m.len());
            for (range_m, direction) in scan.ranges_m.iter_mut().zip(beams) {
                let nearer = person.distance_along(&eye, &direction);
                *range_m = match (*range_m, nearer) {
                    (Some(range_m), Some(nearer_m)) => Some(range_m.min(nearer_m)),
                    (range_m, _) => range_m,
                };
            }
        }
        let poses = posed(&recordings);
        let run = RouteRun {
            observed: poses.keys().copied().collect(),
            poses,
            mendings: Vec::new(),
            alerts: Vec::new(),
            scans: 600,
            cpu_s: 0.0,
            batches: 10,
            batches_not_merged: 0,
        };
        let correlation = Correlation::of(&recordings, &run).unwrap();
        let Share { hits, of } = correlation.contradicting;
        assert!(hits > 0 && 5 * hits <= 2 * of, "{hits} of {of}");
        assert!(correlation.within_pass().unwrap() > 0.5);
    }
}
