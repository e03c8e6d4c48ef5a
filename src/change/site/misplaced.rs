//! Misplaced observations: they miss what other passes hit.

use super::Observed;

/// Poses of neighbours are wrong together: this many before and after are considered.
const NEIGHBOURS: usize = 8;

/// Which of a site's observations are misplaced: their own pose is wrong, or those of most of their
/// neighbours in the trip are.
pub fn misplaced_observations(observations: &[Observed]) -> Vec<bool> {
    let is_known = |k: &usize| observations[*k].agreement.is_known();
    let known: Vec<usize> = (0..observations.len()).filter(is_known).collect();
    let is_wrong = |k: usize| observations[k].agreement.is_wrong();
    let is_void = |k: usize| {
        let at = known.partition_point(|&other| other < k);
        let near = at.saturating_sub(NEIGHBOURS)..(at + NEIGHBOURS + 1).min(known.len());
        let same_trip = |n: &&usize| observations[**n].trip == observations[k].trip;
        let near = known[near].iter().filter(same_trip);
        let (all, wrong) = near.fold((0, 0), |(all, wrong), &n| {
            (all + 1, wrong + usize::from(is_wrong(n)))
        });
        is_wrong(k) || 2 * wrong > all
    };
    (0..observations.len()).map(is_void).collect()
}
