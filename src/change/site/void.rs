//! Observations whose pose is wrong: they miss what everybody else hits.

use super::answers::Answers;
use super::cells::SiteCells;
use crate::change::pass::passes;
use crate::observation::Outcome;

/// A cell is solid to a pass of which a larger share hits it, …
const SOLID_SHARE_MIN: f64 = 0.7;
/// … and free to one of which a smaller share does.
const FREE_SHARE_MAX: f64 = 0.3;
/// An observation must have been asked about so many cells that other passes call solid …
const ASKED_MIN: u32 = 10;
/// … and have hit this share of them.
const HIT_SHARE_MIN: f64 = 0.75;
/// What is nearer than this to a candidate may have changed, metres.
const CHANGED_WITHIN_M: f64 = 0.25;
/// Poses of neighbours go wrong together: so many before and after are asked.
const NEIGHBOURS: usize = 8;

/// Which observations say nothing.
pub fn void_observations(cells: &SiteCells, answers: &Answers) -> Vec<bool> {
    let count = answers.standpoints.len();
    let pass_of = pass_of_observations(answers);
    let mut asked = vec![(0_u32, 0_u32); count];
    let is_unchanged = |cell: &usize| cells.to_candidate_m(*cell) > CHANGED_WITHIN_M;
    for cell in (0..cells.len()).filter(is_unchanged) {
        let seen = || {
            let seen = answers.about(cell).iter();
            seen.filter(|answer| answer.outcome != Outcome::NoReturn)
        };
        // Hits and all answers of each pass, in runs: answers come by trip and time.
        let mut states: Vec<(usize, u32, u32)> = Vec::new();
        for answer in seen() {
            let pass = pass_of[answer.observation as usize];
            let is_hit = u32::from(answer.outcome == Outcome::Hit);
            match states.last_mut() {
                Some((last, hits, all)) if *last == pass => {
                    *hits += is_hit;
                    *all += 1;
                }
                _ => states.push((pass, is_hit, 1)),
            }
        }
        let state = |&(_, hits, all): &(usize, u32, u32)| {
            let share = f64::from(hits) / f64::from(all);
            if share > SOLID_SHARE_MIN {
                1
            } else if share < FREE_SHARE_MAX {
                -1
            } else {
                0
            }
        };
        let sum: i32 = states.iter().map(state).sum();
        let mut at = 0;
        for answer in seen() {
            while states[at].0 != pass_of[answer.observation as usize] {
                at += 1;
            }
            if sum - state(&states[at]) > 0 {
                let (asked, hits) = &mut asked[answer.observation as usize];
                *asked += 1;
                *hits += u32::from(answer.outcome == Outcome::Hit);
            }
        }
    }
    let disagrees = |&(asked, hits): &(u32, u32)| {
        asked >= ASKED_MIN && f64::from(hits) < HIT_SHARE_MIN * f64::from(asked)
    };
    let void: Vec<bool> = asked.iter().map(disagrees).collect();
    spread(&asked, &void, answers)
}

fn pass_of_observations(answers: &Answers) -> Vec<usize> {
    let mut pass_of = vec![0; answers.standpoints.len()];
    for (number, pass) in passes(&answers.standpoints).into_iter().enumerate() {
        pass_of[pass].fill(number);
    }
    pass_of
}

/// An observation is void too if more than half of the nearest that were asked are, before and
/// after it in its trip.
fn spread(asked: &[(u32, u32)], void: &[bool], answers: &Answers) -> Vec<bool> {
    let trip_of = |k: usize| answers.standpoints[k].trip;
    let were_asked: Vec<usize> = (0..asked.len())
        .filter(|&k| asked[k].0 >= ASKED_MIN)
        .collect();
    let is_void = |k: usize| {
        let at = were_asked.partition_point(|&other| other < k);
        let near = at.saturating_sub(NEIGHBOURS)..(at + NEIGHBOURS + 1).min(were_asked.len());
        let near = were_asked[near]
            .iter()
            .filter(|&&n| trip_of(n) == trip_of(k));
        let (all, voids) = near.fold((0, 0), |(all, voids), &n| {
            (all + 1, voids + usize::from(void[n]))
        });
        void[k] || 2 * voids > all
    };
    (0..void.len()).map(is_void).collect()
}
