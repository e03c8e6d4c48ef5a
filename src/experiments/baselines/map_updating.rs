//! The detector of a published map updater for 2D lidars.
//!
//! Stefanini, Ciancolini, Settimi, Pallottino, *Safe and Robust Map Updating for Long-Term
//! Operations in Dynamic Environments* (Sensors, 2023; `lidar_based_map_updating`). A beam agrees
//! with the map if its end is near an occupied cell; each cell remembers its last observations and
//! is changed when most of them disagree. The paper starts from a given map; here a cell's first
//! pass makes it, so that every place has one.

use std::collections::{BTreeMap, HashMap, VecDeque};

use crate::change::{ChangeKind, region_round};
use crate::experiments::alert::ScoredAlert;
use crate::experiments::placed::PlacedScan;
use crate::geometry::{Vector2, angle_difference_rad};
use crate::ids::StampNs;

/// Side of a cell, metres.
const CELL_M: f64 = 0.1;
/// Observations that a cell remembers …
const BUFFER: usize = 10;
/// … and more than this many of them must disagree.
const DISAGREE_MAX: usize = 7;
/// A cell counts an observation once the lidar has moved by this much since the last it counted,
/// metres, …
const MOVED_M: f64 = 0.4;
/// … or turned by this much, radians.
const TURNED_RAD: f64 = std::f64::consts::FRAC_PI_4;
/// A beam's end agrees with an occupied cell within the first distance at the first range and the
/// second at the second, linearly between, metres.
const PAIRED: [(f64, f64); 2] = [(0.2, 0.15), (10.0, 0.28)];
/// Longer beams are left out, metres.
const RANGE_MAX_M: f64 = 18.0;
/// So are scans while the vehicle turns faster, radians a second.
const TURN_RATE_MAX: f64 = 12.0 * std::f64::consts::PI / 180.0;
/// A cell's first pass ends when it has not been observed for so long, seconds, …
const PASS_GAP_S: f64 = 30.0;
/// … or after so long.
const PASS_LENGTH_S: f64 = 120.0;
/// A cell is occupied if at least this share of its first pass hits it, free if nothing does.
const OCCUPIED_SHARE: f64 = 0.3;
/// Changed cells with at most one other between them are one alert's (0.2 m).
const GAP_CELLS: i64 = 2;

type Cell = (i64, i64);

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum State {
    Free,
    Occupied,
}

/// What the first pass over a cell said.
#[derive(Debug, Clone, Copy)]
struct FirstPass {
    began: StampNs,
    last: StampNs,
    over: bool,
    hits: usize,
    passed: usize,
}

impl FirstPass {
    fn of(stamp: StampNs) -> Self {
        Self {
            began: stamp,
            last: stamp,
            over: false,
            hits: 0,
            passed: 0,
        }
    }

    fn add(&mut self, stamp: StampNs, hit: bool) {
        self.over |= stamp.seconds() - self.last.seconds() > PASS_GAP_S
            || stamp.seconds() - self.began.seconds() > PASS_LENGTH_S;
        if self.over {
            return;
        }
        self.last = stamp;
        match hit {
            true => self.hits += 1,
            false => self.passed += 1,
        }
    }

    fn state(&self) -> Option<State> {
        let all = (self.hits + self.passed) as f64;
        if self.hits == 0 {
            Some(State::Free)
        } else if self.hits as f64 >= OCCUPIED_SHARE * all {
            Some(State::Occupied)
        } else {
            None
        }
    }
}

/// What a cell remembers of its observations after the first pass.
#[derive(Debug, Clone, Default)]
struct Memory {
    /// Whether each disagreed, and when, the newest last.
    buffer: VecDeque<(bool, StampNs)>,
    counted_from: Option<(Vector2<f64>, f64)>,
}

impl Memory {
    fn count(&mut self, disagrees: bool, placed: &PlacedScan<'_>) {
        let (eye, theta) = (
            placed.map_from_lidar.translation(),
            placed.map_from_lidar.theta,
        );
        let is_near = self.counted_from.is_some_and(|(before, before_theta)| {
            (eye - before).norm() < MOVED_M
                && angle_difference_rad(theta, before_theta) < TURNED_RAD
        });
        if is_near {
            return;
        }
        self.counted_from = Some((eye, theta));
        if self.buffer.len() == BUFFER {
            self.buffer.pop_front();
        }
        self.buffer.push_back((disagrees, placed.scan.stamp));
    }

    /// When the first of the disagreeing observations was made, if the cell is changed.
    fn changed_since(&self) -> Option<StampNs> {
        let mut disagreeing = self.buffer.iter().filter(|(disagrees, _)| *disagrees);
        let first = disagreeing.next()?.1;
        (disagreeing.count() + 1 > DISAGREE_MAX).then_some(first)
    }
}

/// The alerts that stand after all scans.
pub(crate) fn alerts(scans: &[PlacedScan<'_>]) -> Vec<ScoredAlert> {
    let used = slow_scans(scans);
    let passes = first_passes(&used);
    let map: HashMap<Cell, State> = (passes.iter())
        .filter_map(|(cell, pass)| Some((*cell, pass.state()?)))
        .collect();
    let mut memories: HashMap<Cell, Memory> = HashMap::new();
    for placed in &used {
        for (cell, disagrees) in verdicts(placed, &map) {
            let after = passes
                .get(&cell)
                .is_some_and(|p| placed.scan.stamp > p.last);
            if after {
                memories.entry(cell).or_default().count(disagrees, placed);
            }
        }
    }
    let mut changed: BTreeMap<Cell, (ChangeKind, StampNs)> = BTreeMap::new();
    for (cell, memory) in &memories {
        if let (Some(since), Some(state)) = (memory.changed_since(), map.get(cell)) {
            let kind = match state {
                State::Free => ChangeKind::Appeared,
                State::Occupied => ChangeKind::Disappeared,
            };
            changed.insert(*cell, (kind, since));
        }
    }
    grouped(changed)
}

/// Scans while the vehicle turns slowly.
fn slow_scans<'a>(scans: &'a [PlacedScan<'a>]) -> Vec<&'a PlacedScan<'a>> {
    let slow = |k: usize| {
        let Some(before) = k.checked_sub(1).map(|k| &scans[k]) else {
            return true;
        };
        let now = &scans[k];
        let seconds = now.scan.stamp.seconds() - before.scan.stamp.seconds();
        let turn_rad = angle_difference_rad(now.map_from_base.theta, before.map_from_base.theta);
        turn_rad <= TURN_RATE_MAX * seconds
    };
    (0..scans.len())
        .filter(|k| slow(*k))
        .map(|k| &scans[k])
        .collect()
}

fn first_passes(scans: &[&PlacedScan<'_>]) -> HashMap<Cell, FirstPass> {
    let mut passes: HashMap<Cell, FirstPass> = HashMap::new();
    for placed in scans {
        let stamp = placed.scan.stamp;
        let mut seen: HashMap<Cell, bool> = HashMap::new();
        for (end, range_m, direction) in beams(placed) {
            for cell in cells_before(placed, &direction, range_m) {
                seen.entry(cell).or_insert(false);
            }
            seen.insert(cell_of(&end), true);
        }
        for (cell, hit) in seen {
            passes
                .entry(cell)
                .or_insert_with(|| FirstPass::of(stamp))
                .add(stamp, hit);
        }
    }
    passes
}

/// Whether each cell that a scan observes disagrees with the map; one beam that agrees suffices.
fn verdicts(placed: &PlacedScan<'_>, map: &HashMap<Cell, State>) -> HashMap<Cell, bool> {
    let mut verdicts: HashMap<Cell, bool> = HashMap::new();
    for (end, range_m, direction) in beams(placed) {
        let within_m = paired_within_m(range_m);
        match paired_cells(&end, within_m, map) {
            paired if paired.is_empty() => {
                let cell = cell_of(&end);
                if map.get(&cell) == Some(&State::Free) {
                    verdicts.insert(cell, true);
                }
            }
            paired => {
                for cell in paired {
                    verdicts.insert(cell, false);
                }
            }
        }
        for cell in cells_before(placed, &direction, range_m - within_m) {
            match map.get(&cell) {
                Some(State::Free) => {
                    verdicts.entry(cell).or_insert(false);
                }
                Some(State::Occupied) => {
                    verdicts.entry(cell).or_insert(true);
                }
                None => {}
            }
        }
    }
    verdicts
}

/// Ends, ranges and directions of the beams that are used.
fn beams(placed: &PlacedScan<'_>) -> impl Iterator<Item = (Vector2<f64>, f64, Vector2<f64>)> {
    let eye = placed.map_from_lidar.translation();
    let beams = placed.directions().zip(&placed.scan.ranges_m);
    beams.filter_map(move |(direction, range_m)| {
        let range_m = range_m.filter(|range_m| *range_m <= RANGE_MAX_M)?;
        Some((eye + direction * range_m, range_m, direction))
    })
}

/// The cells along a beam, without that of its end.
fn cells_before(placed: &PlacedScan<'_>, direction: &Vector2<f64>, range_m: f64) -> Vec<Cell> {
    let eye = placed.map_from_lidar.translation();
    let end = cell_of(&(eye + direction * range_m));
    let steps = (range_m.max(0.0) / (0.5 * CELL_M)) as usize;
    let along = (0..steps).map(|k| cell_of(&(eye + direction * (0.5 * CELL_M * k as f64))));
    let mut cells: Vec<Cell> = along.filter(|cell| *cell != end).collect();
    cells.dedup();
    cells
}

fn paired_within_m(range_m: f64) -> f64 {
    let [(near_m, near_within_m), (far_m, far_within_m)] = PAIRED;
    let share = ((range_m - near_m) / (far_m - near_m)).clamp(0.0, 1.0);
    near_within_m + share * (far_within_m - near_within_m)
}

/// The occupied cells nearest to a beam's end, within a distance, metres.
fn paired_cells(end: &Vector2<f64>, within_m: f64, map: &HashMap<Cell, State>) -> Vec<Cell> {
    let middle = cell_of(end);
    let reach = (within_m / CELL_M).ceil() as i64;
    let around = (-reach..=reach).flat_map(|dx| (-reach..=reach).map(move |dy| (dx, dy)));
    let cells = around.map(|(dx, dy)| (middle.0 + dx, middle.1 + dy));
    let occupied = cells.filter(|cell| map.get(cell) == Some(&State::Occupied));
    let near = occupied.filter(|cell| (centre_of(cell) - end).norm() <= within_m);
    near.collect()
}

fn cell_of(point: &Vector2<f64>) -> Cell {
    let cell = |v: f64| (v / CELL_M).floor() as i64;
    (cell(point.x), cell(point.y))
}

fn centre_of(cell: &Cell) -> Vector2<f64> {
    Vector2::new(cell.0 as f64 + 0.5, cell.1 as f64 + 0.5) * CELL_M
}

/// Changed cells of one kind that are near each other as one alert.
fn grouped(mut changed: BTreeMap<Cell, (ChangeKind, StampNs)>) -> Vec<ScoredAlert> {
    let mut alerts = Vec::new();
    while let Some((first, (kind, mut since))) = changed.pop_first() {
        let (mut group, mut next) = (vec![first], 0);
        while let Some(&(x, y)) = group.get(next) {
            next += 1;
            let around = (-GAP_CELLS..=GAP_CELLS)
                .flat_map(|dx| (-GAP_CELLS..=GAP_CELLS).map(move |dy| (x + dx, y + dy)));
            for cell in around {
                if let Some((_, cell_since)) = changed.get(&cell).filter(|(k, _)| *k == kind) {
                    since = since.min(*cell_since);
                    changed.remove(&cell);
                    group.push(cell);
                }
            }
        }
        let centres: Vec<Vector2<f64>> = group.iter().map(centre_of).collect();
        alerts.push(ScoredAlert {
            kind,
            location: centres.iter().sum::<Vector2<f64>>() / centres.len() as f64,
            region: region_round(&centres, 0.5 * CELL_M),
            counterpart: None,
            tier: None,
            passes_when_raised: None,
            batch_when_raised: None,
            since,
        });
    }
    alerts
}

#[cfg(test)]
mod tests {
    use super::super::testing::{posed, room};
    use super::*;
    use crate::experiments::placed::placed_scans;
    use crate::geometry::{Pose2, distance_to_polygon};
    use crate::sim::Shape;

    fn alerts_in(late: Option<&Shape>) -> Vec<ScoredAlert> {
        let recordings = room(480, late);
        alerts(&placed_scans(&recordings, &posed(&recordings)))
    }

    #[test]
    fn a_new_box_is_found_and_an_unchanged_room_is_quiet() {
        assert_eq!(alerts_in(None), []);
        let crate_late = Shape::rectangle(&Pose2::new(4.0, 1.5, 0.3), 0.6, 0.5);
        let found = alerts_in(Some(&crate_late));
        let centre = crate_late.bounding_circle().0;
        assert!(found.iter().any(|alert| {
            alert.kind == ChangeKind::Appeared && distance_to_polygon(&centre, &alert.region) < 0.3
        }));
        let far = |alert: &&ScoredAlert| (alert.location - centre).norm() > 0.6;
        assert_eq!(found.iter().filter(far).count(), 0);
    }

    #[test]
    fn ends_pair_wider_with_range() {
        assert_eq!(paired_within_m(0.1), 0.15);
        assert!((paired_within_m(5.1) - 0.215).abs() < 1e-12);
        assert_eq!(paired_within_m(15.0), 0.28);
    }
}
