//! Whether a shift of the map explains an apparent change.

use std::collections::BTreeSet;

use super::Site;
use super::cells::SiteCells;
use super::cluster::Cluster;
use super::pooled::Pooled;
use super::surroundings::{Fixing, Surroundings};
use crate::change::history::State;
use crate::change::nearness::Nearness;
use crate::geometry::Vector2;
use crate::observation::{Cell, Outcome};

/// Hits this near to the cluster are compared, metres.
const REACH_M: f64 = 4.0;
/// Hits this near to the cluster's cells are the change itself, metres.
const OWN_M: f64 = 0.25;
/// Shifts are tried in steps of this, metres, …
const STEP_M: f64 = 0.05;
/// … this many to each side along the loose direction …
const STEPS_ALONG: i32 = 30;
/// … and across it.
const STEPS_ACROSS: i32 = 1;
/// Hits this near to each other are of the same surface, metres.
const SAME_M: f64 = 0.07;
/// Resolution of that test, metres.
const PIXEL_M: f64 = 0.02;
/// Fewest hits of the old and the new side that are compared.
const OLD_HITS_MIN: usize = 30;
const NEW_HITS_MIN: usize = 8;
/// A shift explains a change if it lays this much larger a share of the new hits onto old ones, …
const GAIN_MIN: f64 = 0.03;
/// … is at least this long, metres, …
const SHIFT_MIN_M: f64 = 0.1;
/// … and at the shifted place this share of hits and misses are hits, …
const HIT_SHARE_MAX: f64 = 0.25;
/// … or there are fewer than this.
const ANSWERS_MIN: usize = 10;

/// Whether a shift along the direction that the surroundings constrain least aligns the surroundings better,
/// and lays what changed onto something that was always there.
pub fn explains(
    site: &Site<'_>,
    cells: &SiteCells,
    cluster: &Cluster,
    pooled: &Pooled,
    surroundings: &Surroundings,
) -> bool {
    let seen_once = pooled.passes_in_change < 2 || pooled.passes_outside < 2;
    let loose = match surroundings.fixing() {
        _ if !surroundings.are_known() => return false,
        Fixing::Fixed => return false,
        Fixing::Unknown => return seen_once,
        Fixing::Loose(loose) => loose,
    };
    let own: Vec<Vector2<f64>> = cluster.cells.iter().map(|&c| cells[c].centre).collect();
    let old = hits_near(site, &own, pooled.side(false));
    let mut new = hits_near(site, &own, pooled.side(true));
    let to_own = Nearness::to(&own);
    new.retain(|hit| !to_own.holds(hit, OWN_M));
    if old.len() < OLD_HITS_MIN || new.len() < NEW_HITS_MIN {
        return seen_once;
    }
    let old = Raster::of(&old);
    let across = Vector2::new(-loose.y, loose.x);
    let fit = |shift: &Vector2<f64>| {
        let laid = new.iter().filter(|hit| old.holds(&(*hit + shift)));
        laid.count() as f64 / new.len() as f64
    };
    let unshifted = fit(&Vector2::zeros());
    let mut best = (unshifted, Vector2::zeros(), 0);
    for along in -STEPS_ALONG..=STEPS_ALONG {
        for aside in -STEPS_ACROSS..=STEPS_ACROSS {
            let shift = STEP_M * (f64::from(along) * loose + f64::from(aside) * across);
            let share = fit(&shift);
            let better = |share: f64, steps: i32| share - 1e-3 * f64::from(steps.abs());
            if better(share, along) > better(best.0, best.2) {
                best = (share, shift, along);
            }
        }
    }
    let (share, shift, _) = best;
    if share <= unshifted + GAIN_MIN || shift.norm() < SHIFT_MIN_M {
        return false;
    }
    let (hits, answers) = answers_there(site, cells, cluster, pooled, &shift);
    answers < ANSWERS_MIN || hits as f64 > HIT_SHARE_MAX * answers as f64
}

fn hits_near(
    site: &Site<'_>,
    own: &[Vector2<f64>],
    observations: impl Iterator<Item = usize>,
) -> Vec<Vector2<f64>> {
    let centre = own.iter().sum::<Vector2<f64>>() / own.len().max(1) as f64;
    let observations = observations.map(|k| &site.observations[k].observation);
    thinned(observations.flat_map(|o| o.hits_near(&centre, REACH_M)))
}

/// One of the points in each square of [`STEP_M`].
fn thinned(points: impl Iterator<Item = Vector2<f64>>) -> Vec<Vector2<f64>> {
    let mut taken = BTreeSet::new();
    points
        .filter(|point| {
            let key = |v: f64| (v / STEP_M).floor() as i32;
            taken.insert((key(point.x), key(point.y)))
        })
        .collect()
}

/// A raster of [`PIXEL_M`], set within [`SAME_M`] of a point.
struct Raster {
    origin: Vector2<f64>,
    columns: usize,
    rows: usize,
    near: Vec<bool>,
}

impl Raster {
    fn of(points: &[Vector2<f64>]) -> Self {
        let margin = Vector2::repeat(SAME_M + PIXEL_M);
        let (low, high) = Nearness::to(points).bounds();
        let origin = low - margin;
        let size = ((high + margin - origin) / PIXEL_M).map(|pixels| pixels.ceil() as usize + 1);
        let mut raster = Self {
            origin,
            columns: size.x,
            rows: size.y,
            near: vec![false; size.x * size.y],
        };
        let reach = (SAME_M / PIXEL_M).ceil() as usize;
        for point in points {
            let Some((column, row)) = raster.pixel(point) else {
                continue;
            };
            for column in column.saturating_sub(reach)..=(column + reach).min(raster.columns - 1) {
                for row in row.saturating_sub(reach)..=(row + reach).min(raster.rows - 1) {
                    let middle = Vector2::new(column as f64 + 0.5, row as f64 + 0.5) * PIXEL_M;
                    let offset = raster.origin + middle - point;
                    raster.near[column * raster.rows + row] |=
                        offset.norm_squared() < SAME_M * SAME_M;
                }
            }
        }
        raster
    }

    fn pixel(&self, point: &Vector2<f64>) -> Option<(usize, usize)> {
        let at = (point - self.origin) / PIXEL_M;
        let (column, row) = (at.x as usize, at.y as usize);
        let is_inside = at.x >= 0.0 && at.y >= 0.0 && column < self.columns && row < self.rows;
        is_inside.then_some((column, row))
    }

    fn holds(&self, at: &Vector2<f64>) -> bool {
        let pixel = self.pixel(at);
        pixel.is_some_and(|(column, row)| self.near[column * self.rows + row])
    }
}

/// Hits, and hits and misses, of the observations that saw the place free, at the cells shifted as the newer
/// observations would be.
fn answers_there(
    site: &Site<'_>,
    cells: &SiteCells,
    cluster: &Cluster,
    pooled: &Pooled,
    shift: &Vector2<f64>,
) -> (usize, usize) {
    let (free_side_is_new, offset) = match pooled.baseline {
        State::Free => (false, *shift),
        State::Occupied => (true, -shift),
    };
    let (mut hits, mut answers) = (0, 0);
    for k in pooled.side(free_side_is_new) {
        for &cell in &cluster.cells {
            let shifted = Cell::of_grid(cells[cell].centre + offset, 0.0);
            match site.observations[k].observation.test(&shifted) {
                Outcome::Hit => {
                    hits += 1;
                    answers += 1;
                }
                Outcome::Miss => answers += 1,
                Outcome::NoReturn | Outcome::Unknown => {}
            }
        }
    }
    (hits, answers)
}
