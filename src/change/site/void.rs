//! Observations whose pose is wrong: they miss what everybody else hits.

use super::Site;
use crate::change::Agreement;

/// An observation must have been asked about so many cells that other passes call solid …
const ASKED_MIN: u32 = 15;
/// … and have hit this share of them.
const HIT_SHARE_MIN: f64 = 0.75;
/// Poses of neighbours go wrong together: so many before and after are asked.
const NEIGHBOURS: usize = 8;

/// Which of a site's observations say nothing; some of them are asked, and speak for the others.
pub fn void_observations(site: &Site<'_>, asked: &[usize]) -> Vec<bool> {
    let agreements = asked.iter().map(|&k| (k, (site.agreement)(site.observations[k])));
    let agreements: Vec<(usize, Agreement)> = agreements
        .filter(|(_, agreement)| agreement.asked >= ASKED_MIN)
        .collect();
    let disagrees =
        |a: &Agreement| f64::from(a.hits) < HIT_SHARE_MIN * f64::from(a.asked);
    let is_void = |k: usize| {
        let trip_of = |k: usize| site.observations[k].trip;
        let at = agreements.partition_point(|&(other, _)| other < k);
        let is_itself = |(other, a): &(usize, Agreement)| *other == k && disagrees(a);
        if agreements.get(at).is_some_and(is_itself) {
            return true;
        }
        let near = at.saturating_sub(NEIGHBOURS)..(at + NEIGHBOURS + 1).min(agreements.len());
        let near = agreements[near].iter().filter(|(n, _)| trip_of(*n) == trip_of(k));
        let (all, voids) = near.fold((0, 0), |(all, voids), (_, agreement)| {
            (all + 1, voids + usize::from(disagrees(agreement)))
        });
        2 * voids > all
    };
    (0..site.observations.len()).map(is_void).collect()
}
