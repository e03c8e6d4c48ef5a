use proptest::prelude::*;

use super::*;

/// Looks of one trip, a visit apart from each other's: `X` struck, `.` passed, ` ` a new visit.
fn seen(trips: &[&str]) -> Vec<Seen> {
    let mut all = Vec::new();
    for (trip, text) in trips.iter().enumerate() {
        let mut order = 0;
        for c in text.chars() {
            let sight = match c {
                'X' => Sight::Struck,
                '.' => Sight::Passed,
                _ => {
                    order += VISIT_KEYFRAMES;
                    continue;
                }
            };
            let number = 1000 * trip as i64 + order as i64;
            all.push(Seen {
                node: NodeId(number),
                trip,
                order,
                stamp: StampNs(number),
                sight,
            });
            order += 1;
        }
    }
    all
}

fn kind_of(trips: &[&str]) -> Option<(State, bool)> {
    last_departure(seen(trips)).map(|d| (d.baseline, d.until.is_none()))
}

#[test]
fn what_comes_and_what_goes() {
    assert_eq!(
        kind_of(&["...... ......", "XXXXXX XXXXXX"]),
        Some((State::Free, true))
    );
    assert_eq!(
        kind_of(&["XXXXXX XXXXXX", "...... ......"]),
        Some((State::Occupied, true))
    );
    assert_eq!(kind_of(&["...... ......", "...... ......"]), None);
    assert_eq!(kind_of(&["XXXXXX XXXXXX"]), None);
    assert_eq!(kind_of(&[]), None);
}

#[test]
fn what_stays_for_a_while_ends() {
    let parked = last_departure(seen(&["...... ......", "XXXXXX XXXXXX", "...... ......"]));
    let parked = parked.unwrap();
    assert_eq!(parked.baseline, State::Free);
    assert_eq!(
        (parked.since, parked.last_seen),
        (StampNs(1000), StampNs(1035))
    );
    assert_eq!(parked.until, Some(StampNs(2000)));
    assert_eq!(parked.trips, [1]);
    assert_eq!(parked.nodes.len(), 12);
}

#[test]
fn what_returns_counts_from_its_return() {
    let back = last_departure(seen(&["........", "XXXXXXXX", "........", "XXXXXXXX"])).unwrap();
    assert_eq!((back.since, back.until), (StampNs(3000), None));
}

#[test]
fn who_walks_by_leaves_no_trace() {
    assert_eq!(kind_of(&["......", "..X...", "XX....", "...X.."]), None);
    assert_eq!(kind_of(&["XX....", "......", "......"]), None);
    assert_eq!(kind_of(&["......", "......", "XX"]), None);
}

#[test]
fn beams_that_pass_beside_a_thin_thing_do_not_hide_it() {
    assert_eq!(
        kind_of(&[
            "........ ........",
            "XX.XX.X. X.XX.XX.",
            "XX.X.XX. XXX.X.XX"
        ]),
        Some((State::Free, true))
    );
}

#[test]
fn one_visit_alone_is_not_believed_beyond_its_limit() {
    let one = last_departure(seen(&[
        "................ ................",
        &"X".repeat(20),
    ]));
    let two = last_departure(seen(&[
        "................ ................",
        "XXXXXXXXXX XXXXXXXXXX",
    ]));
    let (one, two) = (one.unwrap().support, two.unwrap().support);
    assert!((one - (VISIT_LIMIT - CHANGE_COST)).abs() < 1e-9, "{one}");
    assert!(
        (two - (2.0 * VISIT_LIMIT - CHANGE_COST)).abs() < 1e-9,
        "{two}"
    );
}

proptest! {
    /// The recursion against all histories there are.
    #[test]
    fn the_most_likely_history_beats_all_others(
        evidence in prop::collection::vec(-9.0..9.0_f64, 1..10),
    ) {
        let visits: Vec<Visit> = evidence
            .iter()
            .enumerate()
            .map(|(k, &occupied_over_free)| Visit {
                first: StampNs(k as i64),
                looks: (k, k + 1),
                occupied_over_free,
            })
            .collect();
        let score = |states: u32| {
            let occupied = |k: usize| states >> k & 1 == 1;
            let gains = (0..visits.len()).map(|k| {
                let half = 0.5 * evidence[k];
                if occupied(k) { half } else { -half }
            });
            let changes = (1..visits.len()).filter(|&k| occupied(k) != occupied(k - 1)).count();
            gains.sum::<f64>() - CHANGE_COST * changes as f64
        };
        let all = (0..1_u32 << visits.len()).map(score).fold(f64::NEG_INFINITY, f64::max);
        let constant = score(0).max(score((1 << visits.len()) - 1));
        let (states, support) = most_likely(&visits);
        let found = states.iter().enumerate().fold(0_u32, |bits, (k, state)| {
            bits | u32::from(*state == State::Occupied) << k
        });
        prop_assert!((score(found) - all).abs() < 1e-9);
        prop_assert!((support - (all - constant)).abs() < 1e-9);
    }

    #[test]
    fn the_order_of_arrival_does_not_matter(
        sights in prop::collection::vec((0..4_usize, any::<bool>()), 0..60),
        seed in any::<u64>(),
    ) {
        let mut orders = [0; 4];
        let looks: Vec<Seen> = sights
            .iter()
            .map(|&(trip, struck)| {
                orders[trip] += 3;
                let number = 1000 * trip as i64 + orders[trip] as i64;
                Seen {
                    node: NodeId(number),
                    trip,
                    order: orders[trip],
                    stamp: StampNs(number),
                    sight: if struck { Sight::Struck } else { Sight::Passed },
                }
            })
            .collect();
        let mut shuffled = looks.clone();
        let count = shuffled.len().max(1);
        for k in 0..shuffled.len() {
            shuffled.swap(k, (seed as usize).wrapping_mul(k + 1) % count);
        }
        prop_assert_eq!(last_departure(looks), last_departure(shuffled));
    }
}
