//! How an observation fits what other passes observed, and the nearby pose at which it fits better.

use super::counted_cell::PassKey;
use super::{ObservationKey, Screen, box_in_reach};
use crate::geometry::Pose2;
use crate::observation::{Cell, Observation, Outcome};
use crate::scan::LaserScan;

/// Spans of a trip this near to each other count as one pass: their errors are correlated.
const SPANS_OF_A_PASS: i64 = 4;
/// One in this many cells is tested.
const CELLS_EVERY: i32 = 4;
/// Another pose is searched for if an observation was tested against this many cells that other passes found
/// occupied …
const ASKED_MIN: u32 = 15;
/// … and hits a smaller share of them than this.
const HIT_SHARE_MIN: f64 = 0.75;
/// If no pose is better, the world may have changed; but this share must still be hit.
const HIT_SHARE_LEAST: f64 = 0.35;
/// A moved observation must hit at least this share.
const MOVED_HIT_SHARE_MIN: f64 = 0.85;
/// First step of the search, metres and radians, …
const FIRST_STEP_M: f64 = 0.16;
const FIRST_STEP_RAD: f64 = 0.06;
/// … how often it is halved, …
const HALVINGS: u32 = 4;
/// … and how many steps of each length are made at most.
const STEPS_MAX: usize = 4;

/// How an observation fits what other passes observed.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Agreement {
    /// Cells occupied by other passes that it hits or misses.
    pub asked: u32,
    /// Those of them that it hits.
    pub hits: u32,
}

impl Agreement {
    /// Whether enough cells were tested.
    pub fn is_known(self) -> bool {
        self.asked >= ASKED_MIN
    }

    /// Whether it misses nearly everything: its pose is wrong.
    pub fn is_wrong(self) -> bool {
        self.is_known() && !self.hits_share(HIT_SHARE_LEAST)
    }

    /// Whether it misses so much that its pose may be wrong.
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
    /// How an observation fits the cells that other passes found occupied, over its whole range. If its pose
    /// is wrong and a nearby one is right, that one is returned.
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
        // Points localise better than cells.
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

    /// Cells within reach that passes other than the observation's own found occupied.
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

/// Hill climbing from a pose along x, y and heading, with ever shorter steps.
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
