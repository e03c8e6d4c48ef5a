//! Sites: groups of candidate cells.

use std::collections::BTreeSet;

use super::Screen;
use super::cell_key::{CELL_M, CellKey, centre_of, key_of};
use super::counted_cell::CountedCell;
use crate::geometry::{Vector2, distance_to_polygon};

/// Candidates this near to each other belong to one site, metres.
const LINK_M: f64 = 0.25;
/// Largest extent of a site from its first cell, metres.
const SITE_REACH_M: f64 = 4.0;
/// Fewest candidates of a site.
const SITE_CELLS_MIN: usize = 2;
/// The surroundings of a site reach this far from its cells, metres.
pub const SURROUNDINGS_M: f64 = 3.0;
/// Cells this near to an alert's region belong to it, metres.
const REGION_MARGIN_M: f64 = 0.3;

/// A group of candidate cells.
#[derive(Debug, Clone, PartialEq)]
pub struct CandidateSite {
    /// Centres of the cells, map frame, metres.
    pub cells: Vec<Vector2<f64>>,
    /// Centres of all candidates in its surroundings, its own among them.
    pub around: Vec<Vector2<f64>>,
}

impl Screen {
    /// The sites that were touched since the last [`Screen::mark_judged`], by their first cells, and all
    /// in or near some regions.
    pub fn touched_sites<'a>(
        &self,
        regions: impl Iterator<Item = &'a [Vector2<f64>]>,
    ) -> Vec<CandidateSite> {
        let mut seeds = self.touched.clone();
        for region in regions {
            seeds.extend(self.cells_near(region));
        }
        self.sites(seeds)
    }

    /// Every site.
    pub fn all_sites(&self) -> Vec<CandidateSite> {
        self.sites(self.grid.cells().map(|cell| cell.key).collect())
    }

    /// Whether a cell in or near a region was touched since the last [`Screen::mark_judged`], removed cells
    /// included.
    pub fn is_touched(&self, region: &[Vector2<f64>]) -> bool {
        let Some((low, high)) = box_round(region, REGION_MARGIN_M) else {
            return false;
        };
        let (low, high) = (key_of(&low), key_of(&high));
        let columns = self.touched.range((low.0, i32::MIN)..=(high.0, i32::MAX));
        columns
            .filter(|(_, row)| (low.1..=high.1).contains(row))
            .any(|key| is_near(*key, region))
    }

    fn cells_near(&self, region: &[Vector2<f64>]) -> Vec<CellKey> {
        let Some((low, high)) = box_round(region, REGION_MARGIN_M) else {
            return Vec::new();
        };
        let keys = self.grid.cells_between(&low, &high).map(|cell| cell.key);
        keys.filter(|key| is_near(*key, region)).collect()
    }

    /// The groups of candidates that are connected to a seed.
    fn sites(&self, seeds: BTreeSet<CellKey>) -> Vec<CandidateSite> {
        let mut left: BTreeSet<CellKey> = seeds;
        let mut taken: BTreeSet<CellKey> = BTreeSet::new();
        let mut sites = Vec::new();
        while let Some(seed) = left.pop_first() {
            let is_candidate = self.grid.get(seed).is_some_and(|cell| cell.candidate);
            if taken.contains(&seed) || !is_candidate {
                continue;
            }
            taken.insert(seed);
            let mut cells = vec![seed];
            let mut next = 0;
            while let Some(&at) = cells.get(next) {
                for near in self.candidates_round(at) {
                    let within = (centre_of(near) - centre_of(seed)).amax() <= SITE_REACH_M;
                    if within && taken.insert(near) {
                        cells.push(near);
                    }
                }
                next += 1;
            }
            if cells.len() >= SITE_CELLS_MIN {
                cells.sort_unstable();
                let cells: Vec<Vector2<f64>> = cells.into_iter().map(centre_of).collect();
                sites.push(CandidateSite {
                    around: self.candidates_around(&cells),
                    cells,
                });
            }
        }
        sites
    }

    fn candidates_around(&self, cells: &[Vector2<f64>]) -> Vec<Vector2<f64>> {
        let Some((low, high)) = box_round(cells, SURROUNDINGS_M) else {
            return Vec::new();
        };
        let cells = self.grid.cells_between(&low, &high);
        let candidates = cells.filter(|cell| cell.candidate);
        candidates.map(|cell| centre_of(cell.key)).collect()
    }

    fn candidates_round(&self, key: CellKey) -> impl Iterator<Item = CellKey> + '_ {
        let reach = (LINK_M / CELL_M).floor() as i32;
        let (low, high) = (
            centre_of((key.0 - reach, key.1 - reach)),
            centre_of((key.0 + reach, key.1 + reach)),
        );
        let is_linked = move |cell: &&CountedCell| {
            let (dx, dy) = (cell.key.0 - key.0, cell.key.1 - key.1);
            cell.candidate && dx * dx + dy * dy <= reach * reach
        };
        let cells = self.grid.cells_between(&low, &high).filter(is_linked);
        cells.map(|cell| cell.key)
    }
}

/// The corners of the box round some points and a margin; `None` without a point.
pub fn box_round(points: &[Vector2<f64>], margin_m: f64) -> Option<(Vector2<f64>, Vector2<f64>)> {
    let first = points.first()?;
    let low = points.iter().fold(*first, |low, point| low.inf(point));
    let high = points.iter().fold(*first, |high, point| high.sup(point));
    let margin = Vector2::repeat(margin_m);
    Some((low - margin, high + margin))
}

/// Whether a cell lies in or near a region.
pub fn is_near(key: CellKey, region: &[Vector2<f64>]) -> bool {
    distance_to_polygon(&centre_of(key), region) <= REGION_MARGIN_M
}
