//! Whether a shift of the map explains what looks like a change.

use std::collections::BTreeSet;

use super::Site;
use super::cells::SiteCells;
use super::cluster::Cluster;
use super::pooled::Pooled;
use super::surroundings::{Fixing, Surroundings};
use crate::change::history::State;
use crate::geometry::Vector2;
use crate::observation::{Cell, Outcome};

/// Hits this near to the cluster are laid onto each other, metres.
const REACH_M: f64 = 4.0;
/// Hits this near to the cluster's cells are the change itself, metres.
const OWN_M: f64 = 0.25;
/// Shifts are tried in steps of this, metres, …
const STEP_M: f64 = 0.05;
/// … so many to each side along the loose direction …
const STEPS_ALONG: i32 = 30;
/// … and across it.
const STEPS_ACROSS: i32 = 1;
/// A hit this near to another has met the same thing, metres.
const SAME_M: f64 = 0.07;
/// Fewest hits of the old and the new side that tell.
const OLD_HITS_MIN: usize = 30;
const NEW_HITS_MIN: usize = 8;
/// A shift explains something if it lays so many more of the new hits onto old ones, as a share, …
const GAIN_MIN: f64 = 0.03;
/// … and is at least so long, metres.
const SHIFT_MIN_M: f64 = 0.1;
/// The change is explained if this share of answers at the shifted place are hits, …
const HIT_SHARE_MAX: f64 = 0.25;
/// … or if fewer can say.
const ANSWERS_MIN: usize = 10;

/// Whether some shift along the direction that the surroundings fix least lays the surroundings
/// better onto each other, and what changed onto something that was there all the time.
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
    let old = PointSet::of(hits_near(site, &own, pooled.side(false)));
    let new = hits_near(site, &own, pooled.side(true));
    let is_own = |hit: &Vector2<f64>| own.iter().any(|c| (c - hit).norm() < OWN_M);
    let new = thinned(new.into_iter().filter(|hit| !is_own(hit)));
    if old.len() < OLD_HITS_MIN || new.len() < NEW_HITS_MIN {
        return seen_once;
    }
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
        .filter(|point| taken.insert(key_of(point, STEP_M)))
        .collect()
}

fn key_of(point: &Vector2<f64>, width_m: f64) -> (i32, i32) {
    let key = |v: f64| (v / width_m).floor() as i32;
    (key(point.x), key(point.y))
}

/// Points that others are laid onto.
struct PointSet {
    /// By squares of [`SAME_M`].
    points: Vec<((i32, i32), Vector2<f64>)>,
}

impl PointSet {
    fn of(points: Vec<Vector2<f64>>) -> Self {
        let keyed = points
            .into_iter()
            .map(|point| (key_of(&point, SAME_M), point));
        let mut points: Vec<_> = keyed.collect();
        points.sort_by_key(|(key, _)| *key);
        Self { points }
    }

    fn len(&self) -> usize {
        self.points.len()
    }

    fn holds(&self, at: &Vector2<f64>) -> bool {
        let (x, y) = key_of(at, SAME_M);
        (x - 1..=x + 1).any(|x| {
            let first = self.points.partition_point(|(key, _)| *key < (x, y - 1));
            let column = self.points[first..].iter();
            column
                .take_while(|(key, _)| *key <= (x, y + 1))
                .any(|(_, point)| (point - at).norm_squared() < SAME_M * SAME_M)
        })
    }
}

/// Hits and answers of those who saw the place free, asked where what stands there would be if the
/// newer observations were shifted.
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
