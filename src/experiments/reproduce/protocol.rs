//! Which cases are run (section 5.1).

use super::case::{Acceptance, Case, Seeds};

/// The paper's ρ, metres.
pub(super) const PATH_NOISES_M: [f64; 3] = [0.0, 0.5, 1.0];
const MAPS: usize = 3;
/// Changes of a case, and in how many cases on each map.
const CHANGES: [(usize, usize); 8] = [
    (0, 1),
    (1, 1),
    (2, 1),
    (5, 1),
    (10, 2),
    (20, 2),
    (50, 1),
    (100, 1),
];
/// Laps before and after, in turn: each between 2 and 10.
const LAPS: [(usize, usize); 8] = [
    (2, 2),
    (3, 2),
    (4, 3),
    (2, 4),
    (5, 5),
    (3, 3),
    (10, 3),
    (2, 10),
];
const SCAN_SPACING_M: f64 = 1.0;
const SHORT_LAPS: (usize, usize) = (3, 2);
const SHORT_SCAN_SPACING_M: f64 = 2.0;
/// Changes and laps of the cases with another closure rule.
const SWEPT: (usize, (usize, usize)) = (5, (4, 3));

/// The whole protocol, or a few cases that only test that everything runs.
pub(super) fn cases(short: bool, seeds: Seeds) -> Vec<Case> {
    if short {
        return short_cases(seeds);
    }
    let mut cases = Vec::new();
    for path_noise_m in PATH_NOISES_M {
        let mut turn = 0;
        for (changes, repetitions) in CHANGES {
            for map in 1..=MAPS {
                for _ in 0..repetitions {
                    let laps = LAPS[turn % LAPS.len()];
                    turn += 1;
                    cases.push(case(seeds, map, path_noise_m, changes, laps, turn));
                }
            }
        }
        for acceptance in [Acceptance::Low, Acceptance::High] {
            for map in 1..=MAPS {
                turn += 1;
                let swept = case(seeds, map, path_noise_m, SWEPT.0, SWEPT.1, turn);
                cases.push(Case {
                    acceptance,
                    ..swept
                });
            }
        }
    }
    cases
}

fn short_cases(seeds: Seeds) -> Vec<Case> {
    let coarse = |path_noise_m, changes, turn| Case {
        scan_spacing_m: SHORT_SCAN_SPACING_M,
        ..case(seeds, 2, path_noise_m, changes, SHORT_LAPS, turn)
    };
    vec![coarse(0.0, 0, 1), coarse(0.0, 5, 2), coarse(0.5, 5, 3)]
}

/// A case; `turn` distinguishes cases with equal parameters.
fn case(
    seeds: Seeds,
    map: usize,
    path_noise_m: f64,
    changes: usize,
    (laps_before, laps_after): (usize, usize),
    turn: usize,
) -> Case {
    let map_seed = seeds.of_map(map);
    let noise_cm = (100.0 * path_noise_m).round() as u64;
    Case {
        map,
        map_seed,
        seed: 1_000_000 * map_seed + 1_000 * noise_cm + turn as u64,
        path_noise_m,
        changes,
        laps_before,
        laps_after,
        acceptance: Acceptance::Medium,
        scan_spacing_m: SCAN_SPACING_M,
    }
}

/// Figure 3: map 2, ρ 0.5 m, 5 changes, 10 laps before and 5 after (section 4.3).
pub(super) fn figure_3(short: bool, seeds: Seeds) -> Case {
    figure_case(short, seeds, 0.5, 5, (10, 5))
}

/// Figure 4: nothing strays, nothing changes.
pub(super) fn figure_4(short: bool, seeds: Seeds) -> Case {
    figure_case(short, seeds, 0.0, 0, (10, 5))
}

/// Figure 5: 5 + 5 laps over one path, as the forklift drove them (section 5.2).
pub(super) fn figure_5(short: bool, seeds: Seeds) -> Case {
    figure_case(short, seeds, 0.0, 5, (5, 5))
}

fn figure_case(
    short: bool,
    seeds: Seeds,
    path_noise_m: f64,
    changes: usize,
    laps: (usize, usize),
) -> Case {
    let laps = if short { SHORT_LAPS } else { laps };
    let case = case(seeds, 2, path_noise_m, changes, laps, 900);
    Case {
        scan_spacing_m: if short {
            SHORT_SCAN_SPACING_M
        } else {
            SCAN_SPACING_M
        },
        ..case
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn the_protocol_is_as_large_as_the_paper_s() {
        let cases = cases(false, Seeds::Scoring);
        for path_noise_m in PATH_NOISES_M {
            let at_level = cases.iter().filter(|c| c.path_noise_m == path_noise_m);
            let usual: Vec<_> = at_level
                .filter(|c| c.acceptance == Acceptance::Medium)
                .collect();
            // Those with 100 are left out, as too much change.
            let few = usual.iter().filter(|c| c.changes < 100);
            assert!(few.map(|c| c.changes).sum::<usize>() >= 300);
            let maps: BTreeSet<_> = usual.iter().map(|c| c.map).collect();
            assert_eq!(maps.len(), 3);
        }
        assert!(cases.iter().map(|c| c.laps()).sum::<usize>() >= 2 * 330);
        let laps = cases.iter().flat_map(|c| [c.laps_before, c.laps_after]);
        assert!(laps.clone().all(|l| (2..=10).contains(&l)));
        assert!(laps.clone().any(|l| l == 2) && laps.clone().any(|l| l == 10));
    }

    #[test]
    fn no_two_cases_and_no_two_sets_share_seeds() {
        let mut seeds = BTreeSet::new();
        let mut maps = [BTreeSet::new(), BTreeSet::new()];
        for (k, set) in [Seeds::Tuning, Seeds::Scoring].into_iter().enumerate() {
            for case in cases(false, set) {
                assert!(seeds.insert(case.seed), "{}", case.name());
                maps[k].insert(case.map_seed);
            }
        }
        assert!(maps[0].is_disjoint(&maps[1]));
    }
}
