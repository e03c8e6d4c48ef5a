//! How far a map moves if little of what its makers saw is different.
//!
//! Ranges that differ by a millimetre, and a few objects that come and go, are nothing to the
//! building: its map must stay where it is. Where it does not, a loop closes in one run and not in
//! the other, or closes falsely.

use std::collections::BTreeMap;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use serde::Serialize;

use super::drawn::{altered, choose_objects};
use super::recording::Recording;
use super::route::MapRun;
use super::table::Table;
use crate::geometry::Pose2;
use crate::ids::StampNs;
use crate::sim::normal;

/// What is different in a run.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Disturbance {
    /// Every range has so much more noise, metres.
    RangeNoise(f64),
    /// This many objects are drawn in.
    Objects(usize),
}

/// How far the keyframes of a run are from where they were in the untouched one.
#[derive(Debug, Clone, Serialize)]
pub struct Moved {
    /// What was different.
    pub disturbance: Disturbance,
    /// How it was drawn.
    pub seed: u64,
    /// Keyframes of the untouched run that have a place in this one too, as keyframes or between
    /// them.
    pub keyframes: usize,
    /// Batches that found no place, although they had one in the untouched run, or the reverse.
    pub batches_otherwise: usize,
    /// Median distance, metres.
    pub median_m: f64,
    /// Largest distance, metres.
    pub worst_m: f64,
}

/// Runs recordings as they are, and then with each disturbance for each of the seeds; calls
/// `after_run` after each run.
///
/// # Errors
/// If the recordings could not be run at all.
pub fn measure_stability(
    recordings: &[Recording],
    disturbances: &[Disturbance],
    seeds: std::ops::Range<u64>,
    mut after_run: impl FnMut(&Moved),
) -> anyhow::Result<Vec<Moved>> {
    let untouched = MapRun::of(recordings)?;
    let mut all = Vec::new();
    for &disturbance in disturbances {
        for seed in seeds.clone() {
            let disturbed = disturbance.applied_to(recordings, &untouched, seed);
            let run = MapRun::of(&disturbed)?;
            let moved = Moved::between(&untouched, &run, disturbance, seed);
            after_run(&moved);
            all.push(moved);
        }
    }
    Ok(all)
}

impl Disturbance {
    fn applied_to(self, recordings: &[Recording], untouched: &MapRun, seed: u64) -> Vec<Recording> {
        match self {
            Self::RangeNoise(sigma_m) => with_noise(recordings, sigma_m, seed),
            Self::Objects(count) => {
                let objects = choose_objects(recordings, &untouched.poses, count, seed);
                altered(recordings, &untouched.poses, &objects, seed)
            }
        }
    }
}

pub(super) fn with_noise(recordings: &[Recording], sigma_m: f64, seed: u64) -> Vec<Recording> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut noisy = recordings.to_vec();
    let scans = noisy.iter_mut().flat_map(|r| &mut r.scans);
    for range_m in scans.flat_map(|scan| scan.ranges_m.iter_mut().flatten()) {
        *range_m = (*range_m + normal(&mut rng, sigma_m)).max(0.0);
    }
    noisy
}

impl Moved {
    fn between(before: &MapRun, since: &MapRun, disturbance: Disturbance, seed: u64) -> Self {
        let mut ways_m = distances_m(&before.keyframes, &since.poses);
        ways_m.sort_by(f64::total_cmp);
        Self {
            disturbance,
            seed,
            keyframes: ways_m.len(),
            batches_otherwise: before.batches_not_merged.abs_diff(since.batches_not_merged),
            median_m: ways_m.get(ways_m.len() / 2).copied().unwrap_or(0.0),
            worst_m: ways_m.last().copied().unwrap_or(0.0),
        }
    }
}

/// Of the scans that both have.
pub(super) fn distances_m(a: &BTreeMap<StampNs, Pose2>, b: &BTreeMap<StampNs, Pose2>) -> Vec<f64> {
    let both = a
        .iter()
        .filter_map(|(stamp, pose)| Some((pose, b.get(stamp)?)));
    both.map(|(a, b)| (a.translation() - b.translation()).norm())
        .collect()
}

/// The measure as text, a line for each run.
pub fn stability_text(all: &[Moved]) -> String {
    let head = [
        "different",
        "seed",
        "keyframes",
        "median, m",
        "worst, m",
        "batches",
    ];
    let mut table = Table::new("How far keyframes moved", &head);
    for moved in all {
        let different = match moved.disturbance {
            Disturbance::RangeNoise(sigma_m) => format!("noise of {} mm", 1e3 * sigma_m),
            Disturbance::Objects(count) => format!("{count} objects"),
        };
        table.row([
            different,
            moved.seed.to_string(),
            moved.keyframes.to_string(),
            format!("{:.3}", moved.median_m),
            format!("{:.3}", moved.worst_m),
            moved.batches_otherwise.to_string(),
        ]);
    }
    table.remark("Batches: how many more or fewer found a place than in the untouched run.");
    table.text()
}

#[cfg(test)]
mod tests {
    use super::super::baselines::testing::room;
    use super::*;

    #[test]
    fn a_room_stands_and_a_wrong_map_would_show() {
        let recordings = room(120, None);
        let disturbances = [Disturbance::RangeNoise(0.001), Disturbance::Objects(2)];
        let mut runs = 0;
        let all = measure_stability(&recordings, &disturbances, 5..7, |_| runs += 1).unwrap();
        assert_eq!((all.len(), runs), (4, 4));
        assert!(all.iter().all(|moved| moved.keyframes > 0));
        assert!(all.iter().all(|moved| moved.worst_m < 0.02), "{all:?}");
        let noise = Disturbance::RangeNoise(0.5);
        let wild = measure_stability(&recordings, &[noise], 5..6, |_| ()).unwrap();
        assert!(wild[0].worst_m > 0.02, "{wild:?}");
    }
}
