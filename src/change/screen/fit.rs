//! How an observation fits what the other passes found, and where it fits better.

use super::counted_cell::PassKey;
use super::{ObservationKey, Screen, box_in_reach};
use crate::geometry::Pose2;
use crate::observation::{Cell, Observation, Outcome};
use crate::scan::LaserScan;

/// Spans of a trip that are so near to each other are of one pass: they err together.
const SPANS_OF_A_PASS: i64 = 4;
/// One in so many cells is asked.
const CELLS_EVERY: i32 = 4;
/// An observation must have been asked about so many cells that other passes call solid …
const ASKED_MIN: u32 = 15;
/// … and have hit this share of them, or another pose is looked for.
const HIT_SHARE_MIN: f64 = 0.75;
/// Where none is better, half of what stood there may be gone; but some of it must be left.
const HIT_SHARE_LEAST: f64 = 0.35;
/// One that was moved must fit better, as a share.
const MOVED_HIT_SHARE_MIN: f64 = 0.85;
/// Poses are tried in steps of this at first, and then of half, a quarter, …, metres and radians,
/// …
const FIRST_STEP_M: f64 = 0.16;
const FIRST_STEP_RAD: f64 = 0.06;
/// … so often halved …
const HALVINGS: u32 = 4;
/// … and at most so many of each length.
const STEPS_MAX: usize = 4;

/// How an observation fits what the other passes found.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Agreement {
    /// Cells that other passes call solid and that it says something about.
    pub asked: u32,
    /// Those of them that it hits.
    pub hits: u32,
}

impl Agreement {
    /// Whether enough was asked to say so.
    pub fn is_known(self) -> bool {
        self.asked >= ASKED_MIN
    }

    /// Whether it misses next to everything that is there: its pose is wrong.
    pub fn is_wrong(self) -> bool {
        self.is_known() && !self.hits_share(HIT_SHARE_LEAST)
    }

    /// Whether it misses so much of what is there that its pose may be wrong.
    fn may_be_wrong(self) -> bool {
        self.is_known() && !self.hits_share(HIT_SHARE_MIN)
    }

    fn hits_share(self, share: f64) -> bool {
        f64::from(self.hits) >= share * f64::from(self.asked)
    }

    fn score(self) -> i64 {
        2 * i64::from(self.hits) - i64::from(self.asked)
    }
}

/// A pose of an observation and how it fits there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fit {
    /// Where the base was.
    pub map_from_base: Pose2,
    /// How the observation fits there.
    pub agreement: Agreement,
}

impl Screen {
    /// How an observation fits what other passes found solid, over all that it saw. If its pose is
    /// wrong and another one near by is right, that one is returned.
    pub fn fit(&self, key: &ObservationKey, scan: &LaserScan, map_from_base: &Pose2) -> Fit {
        let solid = self.solid_to_others(key, &Observation::new(scan, map_from_base));
        let agreement_at = |pose: &Pose2| agreement(&solid, &Observation::new(scan, pose));
        let given = Fit {
            map_from_base: *map_from_base,
            agreement: agreement_at(map_from_base),
        };
        if !given.agreement.may_be_wrong() {
            return given;
        }
        // The middles of the cells leave less room than the cells do.
        let middles = solid.iter().map(|cell| Cell::of_grid(cell.centre, 0.0));
        let middles: Vec<Cell> = middles.collect();
        let score_at = |pose: &Pose2| agreement(&middles, &Observation::new(scan, pose)).score();
        let map_from_base = best_near(map_from_base, score_at);
        let moved = Fit {
            map_from_base,
            agreement: agreement_at(&map_from_base),
        };
        match moved.agreement.is_known() && moved.agreement.hits_share(MOVED_HIT_SHARE_MIN) {
            true => moved,
            false => given,
        }
    }

    /// Cells within reach that passes other than the observation's own call solid.
    fn solid_to_others(&self, key: &ObservationKey, observation: &Observation) -> Vec<Cell> {
        let Some(pass) = self.recorded.get(key).map(|recorded| recorded.pass) else {
            return Vec::new();
        };
        let is_other = |other: &PassKey| {
            other.trip != pass.trip || (other.span - pass.span).abs() > SPANS_OF_A_PASS
        };
        let (low, high) = box_in_reach(observation);
        let cells = self.grid.cells_between(&low, &high).filter(|cell| {
            let (x, y) = cell.key;
            (x + 2 * y).rem_euclid(CELLS_EVERY) == 0 && cell.is_solid_to(is_other)
        });
        cells.map(|cell| cell.geometry()).collect()
    }
}

fn agreement(solid: &[Cell], observation: &Observation) -> Agreement {
    let mut agreement = Agreement::default();
    for cell in solid {
        match observation.test(cell) {
            Outcome::Hit => {
                agreement.asked += 1;
                agreement.hits += 1;
            }
            Outcome::Miss => agreement.asked += 1,
            Outcome::NoReturn | Outcome::Unknown => {}
        }
    }
    agreement
}

/// Goes uphill from a pose, by steps along x, y and the heading that grow shorter.
fn best_near(given: &Pose2, score_at: impl Fn(&Pose2) -> i64) -> Pose2 {
    let mut best = (score_at(given), *given);
    for halvings in 0..=HALVINGS {
        let scale = 0.5_f64.powi(halvings.cast_signed());
        let (step_m, step_rad) = (scale * FIRST_STEP_M, scale * FIRST_STEP_RAD);
        for _ in 0..STEPS_MAX {
            let (score, pose) = best;
            for (x, y, turn_rad) in [
                (step_m, 0.0, 0.0),
                (-step_m, 0.0, 0.0),
                (0.0, step_m, 0.0),
                (0.0, -step_m, 0.0),
                (0.0, 0.0, step_rad),
                (0.0, 0.0, -step_rad),
            ] {
                let tried = Pose2::new(pose.x + x, pose.y + y, pose.theta + turn_rad);
                let tried_score = score_at(&tried);
                if tried_score > best.0 {
                    best = (tried_score, tried);
                }
            }
            if best.0 == score {
                break;
            }
        }
    }
    best.1
}
