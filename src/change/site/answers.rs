//! The ray test of every observation against every cell.

use super::Site;
use super::cells::SiteCells;
use crate::change::AcceptedChange;
use crate::change::history::NO_RETURN_WORTH;
use crate::change::pass::Standpoint;
use crate::observation::Outcome;

/// An outcome other than unknown.
#[derive(Debug, Clone, Copy)]
pub struct Answer {
    /// Index of the observation in the site.
    pub observation: u32,
    /// Hit, miss or no return.
    pub outcome: Outcome,
}

/// No-returns do not count for a lidar that loses a larger share of existing surfaces …
const LOST_SHARE_MAX: f64 = 0.03;
/// … or of which fewer outcomes on them are known.
const ANSWERS_MIN: usize = 200;
/// A surface exists in a cell with at least this many hits …
const SOLID_HITS_MIN: usize = 3;
/// … and a larger share of hits than this.
const SOLID_SHARE_MIN: f64 = 0.8;

/// Outcomes by cell, each cell's in the order of the observations: trip and time.
pub struct Answers {
    of_cells: Vec<Vec<Answer>>,
    /// When, by which trip and from where each observation was made.
    pub standpoints: Vec<Standpoint>,
    /// Weight of a no-return of each observation, in misses.
    no_return_worth: Vec<f64>,
}

impl Answers {
    /// Tests some observations, in their order, against all cells.
    pub fn of(
        site: &Site<'_>,
        cells: &SiteCells,
        observations: impl Iterator<Item = usize>,
    ) -> Self {
        let mut of_cells = vec![Vec::new(); cells.len()];
        for k in observations {
            let observed = &site.observations[k];
            for (cell, answers) in of_cells.iter_mut().enumerate() {
                let outcome = observed.observation.test(&cells[cell]);
                if outcome == Outcome::Unknown {
                    continue;
                }
                let is_outdated =
                    |change: &AcceptedChange| change.outdates(observed.stamp, &cells[cell].centre);
                if !site.accepted.iter().any(is_outdated) {
                    answers.push(Answer {
                        observation: k as u32,
                        outcome,
                    });
                }
            }
        }
        let standpoints = site.observations.iter().map(|o| o.standpoint()).collect();
        Self {
            of_cells,
            standpoints,
            no_return_worth: vec![0.0; site.observations.len()],
        }
    }

    /// The observations that hit or missed a cell: they are tested against the surroundings.
    pub fn witnesses(&self) -> Vec<usize> {
        let mut speaks = vec![false; self.standpoints.len()];
        for answer in self.of_cells.iter().flatten() {
            speaks[answer.observation as usize] |= answer.outcome != Outcome::NoReturn;
        }
        (0..speaks.len()).filter(|&k| speaks[k]).collect()
    }

    /// Counts every no-return as `worth` misses.
    pub fn value_no_returns(&mut self, worth: f64) {
        self.no_return_worth.fill(worth);
    }

    /// Drops the outcomes of some observations.
    pub fn drop_observations(&mut self, dropped: &[bool]) {
        for answers in &mut self.of_cells {
            answers.retain(|answer| !dropped[answer.observation as usize]);
        }
    }

    /// Counts no-returns as weak evidence of free space for lidars that hardly ever lose an existing surface,
    /// and as none for others. Lidars are distinguished by trip.
    pub fn weigh_no_returns(&mut self, site: &Site<'_>, surroundings: &Self) {
        let mut lost_and_kept = vec![(0_usize, 0_usize); site.trips.len()];
        for answers in &surroundings.of_cells {
            let count = |outcome| answers.iter().filter(|a| a.outcome == outcome).count();
            let (hits, misses) = (count(Outcome::Hit), count(Outcome::Miss));
            let seen = (hits + misses) as f64;
            if hits < SOLID_HITS_MIN || (hits as f64) <= SOLID_SHARE_MIN * seen {
                continue;
            }
            for answer in answers {
                let trip = self.standpoints[answer.observation as usize].trip;
                match answer.outcome {
                    Outcome::NoReturn => lost_and_kept[trip].0 += 1,
                    Outcome::Hit => lost_and_kept[trip].1 += 1,
                    Outcome::Miss | Outcome::Unknown => {}
                }
            }
        }
        let worth = |&(lost, kept): &(usize, usize)| {
            let all = lost + kept;
            let earns = all >= ANSWERS_MIN && (lost as f64) < LOST_SHARE_MAX * all as f64;
            if earns { NO_RETURN_WORTH } else { 0.0 }
        };
        let of_trips: Vec<f64> = lost_and_kept.iter().map(worth).collect();
        let worth = self.standpoints.iter().map(|s| of_trips[s.trip]);
        self.no_return_worth = worth.collect();
    }

    /// The outcomes of a cell.
    pub fn about(&self, cell: usize) -> &[Answer] {
        &self.of_cells[cell]
    }

    /// How much an outcome counts as a hit and as a miss.
    pub fn counts(&self, answer: &Answer) -> (f64, f64) {
        match answer.outcome {
            Outcome::Hit => (1.0, 0.0),
            Outcome::Miss => (0.0, 1.0),
            Outcome::NoReturn => (0.0, self.no_return_worth[answer.observation as usize]),
            Outcome::Unknown => (0.0, 0.0),
        }
    }
}
