//! Which places may have changed: a grid of counts that every observation goes through once.
//!
//! A cell is counted while two observations have a hit in it; it keeps, for each pass, how many
//! observations hit it and how many missed it. That is a sum over pairs of cell and observation,
//! each a function of the two alone, so the counts depend neither on the order of arrival nor on
//! what was moved or removed in between. Whether something changed is decided elsewhere: here
//! nothing may be missed, and what is named too often costs time.

mod counted_cell;
mod fit;
mod reliability;

use std::collections::{BTreeMap, BTreeSet};

use self::counted_cell::{CountedCell, MAKERS_MIN, PassCounts, PassKey, Signature};
pub use self::fit::{Agreement, Fit};
pub use self::reliability::Reliability;
use crate::geometry::{Pose2, Vector2, distance_to_polygon};
use crate::ids::{NodeId, StampNs, TripId};
use crate::observation::{Observation, Outcome, REACH_M, Sight};
use crate::scan::LaserScan;

/// Width of a cell, metres.
const CELL_M: f64 = 0.08;
/// Cells along a tile.
const TILE_CELLS: i32 = 16;
/// From a tile's middle to the middles of its cells, metres, at most.
const TILE_RADIUS_M: f64 = 0.5 * std::f64::consts::SQRT_2 * TILE_CELLS as f64 * CELL_M;
/// Observations are found by tiles of this width, metres.
const EYE_TILE_M: f64 = 4.0;
/// Poses are taken to whole steps of these, so that what a solve moves by a hair stays where it
/// is: metres, radians.
const POSE_STEP_M: f64 = 0.03;
const POSE_STEP_RAD: f64 = 0.005;
/// What a trip observed within so many seconds is counted together: far less than a pass may last,
/// so that what changes while it is looked at shows.
const SPAN_NS: i64 = 30_000_000_000;
/// Candidates this near to each other belong to one site, metres.
const LINK_M: f64 = 0.25;
/// A site reaches no farther than this from its first cell, metres.
const SITE_REACH_M: f64 = 4.0;
/// Fewest candidates of a site.
const SITE_CELLS_MIN: usize = 2;
/// Surroundings of a site go this far from its cells, metres.
pub const SURROUNDINGS_M: f64 = 3.0;
/// What lies this near to an alert's region belongs to it, metres.
const REGION_MARGIN_M: f64 = 0.3;

/// Which observation: a keyframe's own (0), or its first, second … intermediate scan.
pub type ObservationKey = (NodeId, u32);

/// An observation as the screen is given it.
pub struct Screened<'a> {
    /// Which.
    pub key: ObservationKey,
    /// Its trip.
    pub trip: &'a TripId,
    /// When.
    pub stamp: StampNs,
    /// Where the base was.
    pub map_from_base: Pose2,
    /// What was seen.
    pub scan: &'a LaserScan,
}

/// The grid.
#[derive(Default)]
pub struct Screen {
    /// Where each observation stands in `eyes`.
    poses: BTreeMap<ObservationKey, RecordedPose>,
    /// Observations by where the lidar was, in no order.
    eyes: BTreeMap<(i32, i32), Vec<Recorded>>,
    tiles: BTreeMap<(i32, i32), Tile>,
    /// Cells that were counted anew, with what they said before.
    touched: BTreeMap<CellKey, Signature>,
}

/// An observation that has gone through the grid.
struct Recorded {
    key: ObservationKey,
    pass: PassKey,
    observation: Observation,
}

struct RecordedPose {
    pose: PoseSteps,
    eye_tile: (i32, i32),
}

/// A pose in whole steps.
type PoseSteps = [i64; 3];
/// A cell, in cells from the map's origin.
type CellKey = (i32, i32);

/// The counted cells of a square.
#[derive(Default)]
struct Tile {
    /// Ascending by key.
    cells: Vec<CountedCell>,
}

impl Tile {
    fn cell_mut(&mut self, key: CellKey) -> &mut CountedCell {
        let at = self.cells.partition_point(|cell| cell.key < key);
        if self.cells.get(at).is_none_or(|cell| cell.key != key) {
            self.cells.insert(at, CountedCell::new(key));
        }
        &mut self.cells[at]
    }
}

/// Candidate cells that lie together.
#[derive(Debug, Clone, PartialEq)]
pub struct CandidateSite {
    /// Centres of the cells, map frame, metres.
    pub cells: Vec<Vector2<f64>>,
    /// Centres of all candidates in its surroundings, its own among them.
    pub around: Vec<Vector2<f64>>,
}

impl Screen {
    /// Brings the grid up to date with all observations of a map.
    pub fn update<'a>(&mut self, observations: impl Iterator<Item = Screened<'a>>) {
        let mut gone: BTreeSet<ObservationKey> = self.poses.keys().copied().collect();
        let mut come = Vec::new();
        for screened in observations {
            let pose = steps_of(&screened.map_from_base);
            let known = self.poses.get(&screened.key);
            if known.is_some_and(|known| known.pose == pose) {
                gone.remove(&screened.key);
            } else {
                come.push((screened, pose));
            }
        }
        for key in gone {
            self.remove(key);
        }
        for (screened, pose) in come {
            self.add(&screened, pose);
        }
        let tiles = &mut self.tiles;
        self.touched.retain(|key, before| {
            cell_mut(tiles, *key).is_none_or(|cell| {
                cell.candidate = cell.has_change();
                cell.signature() != *before
            })
        });
    }

    /// What has been touched counts as judged.
    pub fn settle(&mut self) {
        self.touched.clear();
    }

    fn add(&mut self, screened: &Screened<'_>, pose: PoseSteps) {
        let observation = Observation::new(screened.scan, &pose_of(&pose));
        let pass = PassKey {
            span: screened.stamp.0.div_euclid(SPAN_NS),
            trip: hash_of(screened.trip),
        };
        for key in hit_cells(&observation) {
            let tile = self.tiles.entry(tile_of(key)).or_default();
            let cell = tile.cell_mut(key);
            cell.makers += 1;
            if cell.makers == MAKERS_MIN {
                self.touched.insert(key, cell.signature());
                // What came before answers for the new cell.
                let geometry = cell.geometry();
                for before in recorded_near(&self.eyes, &geometry.centre) {
                    cell.count(before.pass, before.observation.test(&geometry), true);
                }
            }
        }
        self.count_all(&observation, pass, true);
        let eye_tile = eye_tile(&observation.eye());
        self.poses
            .insert(screened.key, RecordedPose { pose, eye_tile });
        self.eyes.entry(eye_tile).or_default().push(Recorded {
            key: screened.key,
            pass,
            observation,
        });
    }

    fn remove(&mut self, key: ObservationKey) {
        let Some(recorded) = self.take(&key) else {
            return;
        };
        self.count_all(&recorded.observation, recorded.pass, false);
        for key in hit_cells(&recorded.observation) {
            let Some(tile) = self.tiles.get_mut(&tile_of(key)) else {
                continue;
            };
            if let Ok(at) = tile.cells.binary_search_by_key(&key, |cell| cell.key) {
                let cell = &mut tile.cells[at];
                cell.makers -= 1;
                if cell.makers == 0 {
                    tile.cells.remove(at);
                } else if cell.makers < MAKERS_MIN {
                    *cell = CountedCell {
                        makers: cell.makers,
                        ..CountedCell::new(key)
                    };
                }
            }
            if tile.cells.is_empty() {
                self.tiles.remove(&tile_of(key));
            }
        }
    }

    fn take(&mut self, key: &ObservationKey) -> Option<Recorded> {
        let eye_tile = self.poses.remove(key)?.eye_tile;
        let there = self.eyes.get_mut(&eye_tile)?;
        let at = there.iter().position(|recorded| recorded.key == *key)?;
        let recorded = there.swap_remove(at);
        if there.is_empty() {
            self.eyes.remove(&eye_tile);
        }
        Some(recorded)
    }

    fn recorded(&self, key: &ObservationKey) -> Option<&Recorded> {
        let there = self.eyes.get(&self.poses.get(key)?.eye_tile)?;
        there.iter().find(|recorded| recorded.key == *key)
    }

    /// Counts what an observation says about every cell within reach, or takes that back.
    fn count_all(&mut self, observation: &Observation, pass: PassKey, adds: bool) {
        let (low, high) = tiles_in_reach(observation);
        for column in low.0..=high.0 {
            let tiles = self.tiles.range_mut((column, low.1)..=(column, high.1));
            for (tile_key, tile) in tiles {
                let middle = middle_of(*tile_key);
                if observation.sight_of(&middle, TILE_RADIUS_M, 0.5 * CELL_M) == Sight::Blind {
                    continue;
                }
                for cell in tile.cells.iter_mut().filter(|cell| cell.is_counted()) {
                    let outcome = observation.test(&cell.geometry());
                    if outcome != Outcome::Unknown {
                        let signature = || cell.signature();
                        self.touched.entry(cell.key).or_insert_with(signature);
                        cell.count(pass, outcome, adds);
                    }
                }
            }
        }
    }

    /// The sites that were touched since the last [`Screen::settle`], by their first cells;
    /// `regions` are those of alerts that wait, which are judged anew when anything near them was
    /// touched.
    pub fn touched_sites(&self, regions: &[Vec<Vector2<f64>>]) -> Vec<CandidateSite> {
        let mut seeds: BTreeSet<CellKey> = self.touched.keys().copied().collect();
        for region in regions.iter().filter(|region| self.is_touched(region)) {
            seeds.extend(self.cells_near(region));
        }
        self.sites(seeds)
    }

    /// Every site.
    pub fn all_sites(&self) -> Vec<CandidateSite> {
        let cells = self.tiles.values().flat_map(|tile| &tile.cells);
        self.sites(cells.map(|cell| cell.key).collect())
    }

    /// Whether anything was touched in or near a region since the last [`Screen::settle`]: cells
    /// that are gone count too.
    pub fn is_touched(&self, region: &[Vector2<f64>]) -> bool {
        let Some((low, high)) = bounds(region) else {
            return false;
        };
        let (low, high) = (key_of(&low), key_of(&high));
        let columns = self.touched.range((low.0, i32::MIN)..=(high.0, i32::MAX));
        columns
            .filter(|((_, row), _)| (low.1..=high.1).contains(row))
            .any(|(key, _)| is_near(*key, region))
    }

    /// The observations from which a site may have been seen, and some that are too far away.
    pub fn observations_near(&self, site: &CandidateSite) -> Vec<ObservationKey> {
        let mut near = BTreeSet::new();
        for cell in &site.cells {
            near.extend(recorded_near(&self.eyes, cell).map(|recorded| recorded.key));
        }
        near.into_iter().collect()
    }

    /// About how much memory it takes, bytes.
    pub fn size_bytes(&self) -> usize {
        let cells = self.tiles.values().flat_map(|tile| &tile.cells);
        let cells: usize = cells
            .map(|cell| size_of::<CountedCell>() + cell.passes.capacity() * size_of::<PassCounts>())
            .sum();
        cells + self.poses.len() * (size_of::<Recorded>() + OBSERVATION_BYTES)
    }

    fn cells_near(&self, region: &[Vector2<f64>]) -> Vec<CellKey> {
        let Some((low, high)) = bounds(region) else {
            return Vec::new();
        };
        let (low, high) = (tile_of(key_of(&low)), tile_of(key_of(&high)));
        let columns = low.0..=high.0;
        let tiles = columns.flat_map(|x| self.tiles.range((x, low.1)..=(x, high.1)));
        let keys = tiles.flat_map(|(_, tile)| tile.cells.iter().map(|cell| cell.key));
        keys.filter(|key| is_near(*key, region)).collect()
    }

    fn is_candidate(&self, key: CellKey) -> bool {
        self.tiles.get(&tile_of(key)).is_some_and(|tile| {
            let at = tile.cells.binary_search_by_key(&key, |cell| cell.key);
            at.is_ok_and(|at| tile.cells[at].candidate)
        })
    }

    /// Candidates that hang together with a seed.
    fn sites(&self, seeds: BTreeSet<CellKey>) -> Vec<CandidateSite> {
        let mut left: BTreeSet<CellKey> = seeds;
        let mut taken: BTreeSet<CellKey> = BTreeSet::new();
        let mut sites = Vec::new();
        while let Some(seed) = left.pop_first() {
            if taken.contains(&seed) || !self.is_candidate(seed) {
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
                sites.push(CandidateSite {
                    around: self.candidates_around(&cells),
                    cells: cells.into_iter().map(centre_of).collect(),
                });
            }
        }
        sites
    }

    fn candidates_around(&self, cells: &[CellKey]) -> Vec<Vector2<f64>> {
        let reach = (SURROUNDINGS_M / CELL_M).ceil() as i32;
        let first = (i32::MAX, i32::MAX, i32::MIN, i32::MIN);
        let (x, y, to_x, to_y) = cells.iter().fold(first, |(x, y, to_x, to_y), key| {
            (x.min(key.0), y.min(key.1), to_x.max(key.0), to_y.max(key.1))
        });
        let low = tile_of((x.saturating_sub(reach), y.saturating_sub(reach)));
        let high = tile_of((to_x.saturating_add(reach), to_y.saturating_add(reach)));
        let tiles = (low.0..=high.0).flat_map(|x| self.tiles.range((x, low.1)..=(x, high.1)));
        let cells = tiles.flat_map(|(_, tile)| &tile.cells);
        let candidates = cells.filter(|cell| cell.candidate);
        candidates.map(|cell| centre_of(cell.key)).collect()
    }

    fn candidates_round(&self, key: CellKey) -> impl Iterator<Item = CellKey> + '_ {
        let reach = (LINK_M / CELL_M).floor() as i32;
        let (low, high) = (
            tile_of((key.0 - reach, key.1 - reach)),
            tile_of((key.0 + reach, key.1 + reach)),
        );
        let columns = low.0..=high.0;
        let tiles = columns.flat_map(move |x| self.tiles.range((x, low.1)..=(x, high.1)));
        let cells = tiles.flat_map(|(_, tile)| &tile.cells);
        let is_linked = move |cell: &&CountedCell| {
            let (dx, dy) = (cell.key.0 - key.0, cell.key.1 - key.1);
            cell.candidate && dx * dx + dy * dy <= reach * reach
        };
        cells.filter(is_linked).map(|cell| cell.key)
    }
}

/// An observation in the indices; its ranges are the map's.
const OBSERVATION_BYTES: usize = 128;

/// The corners of the box round a region and its margin; `None` without a region.
fn bounds(region: &[Vector2<f64>]) -> Option<(Vector2<f64>, Vector2<f64>)> {
    let first = region.first()?;
    let low = region.iter().fold(*first, |low, corner| low.inf(corner));
    let high = region.iter().fold(*first, |high, corner| high.sup(corner));
    let margin = Vector2::repeat(REGION_MARGIN_M);
    Some((low - margin, high + margin))
}

fn is_near(key: CellKey, region: &[Vector2<f64>]) -> bool {
    distance_to_polygon(&centre_of(key), region) <= REGION_MARGIN_M
}

fn cell_mut(tiles: &mut BTreeMap<(i32, i32), Tile>, key: CellKey) -> Option<&mut CountedCell> {
    let tile = tiles.get_mut(&tile_of(key))?;
    let at = tile
        .cells
        .binary_search_by_key(&key, |cell| cell.key)
        .ok()?;
    tile.cells.get_mut(at)
}

/// Observations whose eye is within reach of a place, ascending by tiles.
fn recorded_near<'a>(
    eyes: &'a BTreeMap<(i32, i32), Vec<Recorded>>,
    place: &Vector2<f64>,
) -> impl Iterator<Item = &'a Recorded> + 'a {
    let low = eye_tile(&(place - Vector2::repeat(REACH_M)));
    let high = eye_tile(&(place + Vector2::repeat(REACH_M)));
    let columns = low.0..=high.0;
    let tiles = columns.flat_map(move |x| eyes.range((x, low.1)..=(x, high.1)));
    tiles.flat_map(|(_, there)| there)
}

/// The first and the last tile that an observation may say something about.
fn tiles_in_reach(observation: &Observation) -> ((i32, i32), (i32, i32)) {
    let (eye, reach) = (observation.eye(), Vector2::repeat(observation.reach_m()));
    let tile = |corner: Vector2<f64>| tile_of(key_of(&corner));
    (tile(eye - reach), tile(eye + reach))
}

fn hit_cells(observation: &Observation) -> BTreeSet<CellKey> {
    observation.hits().map(|hit| key_of(&hit)).collect()
}

fn key_of(point: &Vector2<f64>) -> CellKey {
    let key = |v: f64| (v / CELL_M).floor() as i32;
    (key(point.x), key(point.y))
}

fn centre_of(key: CellKey) -> Vector2<f64> {
    let centre = |k: i32| (f64::from(k) + 0.5) * CELL_M;
    Vector2::new(centre(key.0), centre(key.1))
}

/// The middle of a tile, map frame, metres.
fn middle_of(tile: (i32, i32)) -> Vector2<f64> {
    let middle = |k: i32| (f64::from(k) + 0.5) * f64::from(TILE_CELLS) * CELL_M;
    Vector2::new(middle(tile.0), middle(tile.1))
}

fn tile_of(key: CellKey) -> (i32, i32) {
    (key.0.div_euclid(TILE_CELLS), key.1.div_euclid(TILE_CELLS))
}

fn eye_tile(eye: &Vector2<f64>) -> (i32, i32) {
    let tile = |v: f64| (v / EYE_TILE_M).floor() as i32;
    (tile(eye.x), tile(eye.y))
}

fn steps_of(pose: &Pose2) -> PoseSteps {
    let steps = |v: f64, step: f64| (v / step).round() as i64;
    [
        steps(pose.x, POSE_STEP_M),
        steps(pose.y, POSE_STEP_M),
        steps(pose.theta, POSE_STEP_RAD),
    ]
}

fn pose_of(steps: &PoseSteps) -> Pose2 {
    let [x, y, theta] = steps.map(|steps| steps as f64);
    Pose2::new(x * POSE_STEP_M, y * POSE_STEP_M, theta * POSE_STEP_RAD)
}

/// FNV-1a: the same for every run, whatever the order in which trips came.
fn hash_of(trip: &TripId) -> u32 {
    let mix = |sum: u32, byte: u8| (sum ^ u32::from(byte)).wrapping_mul(0x0100_0193);
    trip.as_str().bytes().fold(0x811c_9dc5, mix)
}

#[cfg(test)]
mod tests;
