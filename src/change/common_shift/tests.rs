use proptest::prelude::*;

use super::*;
use crate::change::testing::{self, SECOND_NS};
use crate::change::{Counterpart, join_counterparts};
use crate::ids::{EdgeId, NodeId, TripId};

use ChangeKind::{Appeared, Disappeared, MapMismatch};

/// What stood at the first place stands at the second one, metres.
const DISPLACEMENT: [f64; 2] = [0.4, -0.1];

/// A square of 0.3 m round a place, seen from second `since_s` on.
fn finding(kind: ChangeKind, place: [f64; 2], since_s: i64) -> Finding {
    testing::finding(kind, place, 0.15, since_s)
}

/// Both sides of something at a place that was displaced.
fn displaced(place: [f64; 2], by: [f64; 2], since_s: i64) -> [Finding; 2] {
    let there = [place[0] + by[0], place[1] + by[1]];
    [
        finding(Disappeared, place, since_s),
        finding(Appeared, there, since_s + 1),
    ]
}

/// Things 3 m apart along x, all displaced alike.
fn row(count: i64) -> Vec<Finding> {
    let things = (0..count).map(|k| displaced([3.0 * k as f64, 0.0], DISPLACEMENT, 4 * k));
    things.flatten().collect()
}

fn of_trip(trip: &str, findings: impl IntoIterator<Item = Finding>) -> Vec<Finding> {
    let trips = vec![TripId::new(trip).unwrap()];
    let named = findings.into_iter().map(|finding| Finding {
        trips: trips.clone(),
        ..finding
    });
    named.collect()
}

/// The observations say what the outlines say.
fn explain(findings: Vec<Finding>) -> Vec<Finding> {
    explain_by_shift(
        findings,
        |_| true,
        |mismatch| mismatch.shift.map(ShiftFit::known),
    )
}

fn assert_unexplained(findings: Vec<Finding>) {
    assert_eq!(explain(findings.clone()), findings);
}

/// The only mismatch of what is left, and how much else there is.
fn only_mismatch(findings: Vec<Finding>) -> (Finding, usize) {
    let (mut mismatches, others): (Vec<Finding>, Vec<Finding>) =
        (explain(findings).into_iter()).partition(|f| f.kind == MapMismatch);
    assert_eq!(mismatches.len(), 1);
    (mismatches.remove(0), others.len())
}

#[test]
fn three_things_displaced_alike_are_one_mismatch() {
    let findings = row(3);
    let (mismatch, others) = only_mismatch(findings.clone());
    assert_eq!(others, 0);
    // What was observed is moved back onto the map.
    let shift = mismatch.shift.unwrap();
    assert!((shift + Vector2::from(DISPLACEMENT)).norm() < 1e-9);
    for corner in findings.iter().flat_map(|finding| &finding.region) {
        assert!(distance_to_polygon(corner, &mismatch.region) < 1e-9);
    }
    assert!((mismatch.location - Vector2::new(3.2, -0.05)).norm() < 0.1);
    assert_eq!(mismatch.tier, Tier::Tentative);
    assert_eq!(mismatch.trips, findings[0].trips);
    assert_eq!(mismatch.edges, [0, 1, 4, 5, 8, 9].map(EdgeId));
    assert_eq!(mismatch.nodes, [0, 1, 2, 4, 5, 6, 8, 9, 10].map(NodeId));
    assert_eq!(mismatch.since, StampNs(0));
    assert_eq!(mismatch.last_seen, StampNs(18 * SECOND_NS));
    assert_eq!(mismatch.until, None);
}

#[test]
fn displacements_need_not_be_equal_to_the_millimetre() {
    let mut findings = row(2);
    findings.extend(displaced([6.0, 0.0], [0.48, -0.05], 8));
    findings.extend(displaced([9.0, 0.0], [0.35, -0.17], 12));
    let (mismatch, others) = only_mismatch(findings);
    assert_eq!(others, 0);
    let off = mismatch.shift.unwrap() + Vector2::from(DISPLACEMENT);
    assert!(off.norm() < 0.05, "{off}");
}

#[test]
fn the_observations_have_the_last_word() {
    let measured = Vector2::new(-0.35, 0.05);
    let explained = explain_by_shift(row(3), |_| true, |_| Some(ShiftFit::known(measured)));
    assert_eq!((explained.len(), explained[0].shift), (1, Some(measured)));
    assert_eq!(explain_by_shift(row(3), |_| true, |_| None), row(3));
}

#[test]
fn what_else_the_measured_shift_explains_joins_the_mismatch() {
    // A wall's end that appeared, though the wall itself hides where it was.
    let end = finding(Appeared, [3.0, 1.5], 4);
    let other = finding(Appeared, [6.0, 1.5], 4);
    let shift = -Vector2::from(DISPLACEMENT);
    let of = |findings: &[Finding]| -> Vec<Vector2<f64>> {
        let sides = findings.iter().flat_map(|finding| {
            let inside = |k: i32, n: i32| Vector2::new(f64::from(k), f64::from(n)) * 0.06;
            (-2..=2).flat_map(move |k| (-2..=2).map(move |n| finding.location + inside(k, n)))
        });
        sides.collect()
    };
    let (gone, come): (Vec<_>, Vec<_>) = row(3).into_iter().partition(|f| f.kind == Disappeared);
    let mut old = of(&gone);
    old.extend(
        of(std::slice::from_ref(&end))
            .iter()
            .map(|point| point + shift),
    );
    let new = [of(&come), of(&[end.clone(), other.clone()])].concat();
    let findings = [row(3), vec![end, other.clone()]].concat();
    let explained = explain_by_shift(
        findings,
        |_| true,
        |mismatch| {
            let expected = mismatch.shift.unwrap_or_default();
            ShiftFit::of(old.iter().copied(), new.iter().copied(), &expected)
        },
    );
    assert_eq!((explained.len(), &explained[0]), (2, &other));
    assert!((explained[1].shift.unwrap() - shift).norm() < 0.02);
}

#[test]
fn two_things_are_too_few() {
    assert_unexplained(row(2));
}

#[test]
fn things_displaced_by_different_vectors_were_moved() {
    let by = [[0.4, -0.1], [0.0, 0.5], [-0.6, 0.2], [0.7, 0.1]];
    let things = (0..).zip(by);
    let things = things.map(|(k, by)| displaced([3.0 * f64::from(k), 0.0], by, 4));
    assert_unexplained(things.flatten().collect());
}

#[test]
fn what_hardly_moved_or_moved_far_is_not_explained() {
    for by in [[0.05, 0.05], [1.3, -0.8]] {
        let things = (0..4).map(|k| displaced([4.0 * f64::from(k), 0.0], by, 4));
        assert_unexplained(things.flatten().collect());
    }
}

#[test]
fn the_legs_of_a_table_that_was_moved_stay() {
    let legs = [[0.0, 0.0], [1.8, 0.0], [1.8, 0.8], [0.0, 0.8]];
    let sides = legs.map(|leg| displaced(leg, [0.5, 0.3], 4));
    assert_unexplained(sides.into_iter().flatten().collect());
}

#[test]
fn a_row_of_doors_that_were_opened_stays() {
    let leaf = |length: f64, width: f64| {
        let (x, y) = (0.5 * length, 0.5 * width);
        [[-x, -y], [x, -y], [x, y], [-x, y]].map(Vector2::from)
    };
    let doors = (0..5).flat_map(|k| {
        let [mut shut, mut open] = displaced([3.0 * f64::from(k), 0.0], [-0.4, 0.4], 4);
        shut.region = leaf(0.9, 0.1).map(|c| shut.location + c).to_vec();
        open.region = leaf(0.1, 0.9).map(|c| open.location + c).to_vec();
        [shut, open]
    });
    assert_unexplained(doors.collect());
}

#[test]
fn a_door_stays_one_event() {
    let door = displaced([0.0, 0.0], [0.5, 0.5], 4).to_vec();
    assert_unexplained(door.clone());
    let joined = join_counterparts(explain(door));
    assert_eq!(joined.len(), 1);
    let [gone, _] = displaced([0.0, 0.0], [0.5, 0.5], 4);
    let counterpart = Counterpart {
        kind: Disappeared,
        region: gone.region,
    };
    assert_eq!(joined[0].counterpart, Some(counterpart));
    // One that has been joined is left alone, though a shift goes by.
    let far_away = displaced([3.0, 20.0], DISPLACEMENT, 4);
    let joined_there = join_counterparts(far_away.to_vec());
    let left = explain([row(3), joined_there.clone()].concat());
    assert_eq!(left[..1], joined_there);
    assert_eq!((left.len(), left[1].kind), (2, MapMismatch));
}

#[test]
fn trips_are_not_mixed() {
    let [first, second, third] = [0.0, 3.0, 6.0].map(|x| displaced([x, 0.0], DISPLACEMENT, 4));
    let two_of_monday = [first, second].concat();
    assert_unexplained([two_of_monday, of_trip("tuesday", third)].concat());
    // What a second trip shows too has changed.
    let mut shown_twice = row(3);
    for finding in &mut shown_twice {
        finding.trips.push(TripId::new("tuesday").unwrap());
    }
    assert_unexplained(shown_twice);
    // Each trip may have a shift of its own.
    let other_shift = |k| displaced([3.0 * f64::from(k), 0.0], [-0.3, 0.3], 4);
    let tuesday = of_trip("tuesday", (0..3).flat_map(other_shift));
    let both = explain([tuesday, row(3)].concat());
    let shifts: Vec<_> = both.iter().filter_map(|f| f.shift).collect();
    assert_eq!((both.len(), shifts.len()), (2, 2));
    assert!(both.iter().all(|finding| finding.trips.len() == 1));
}

/// As of a trip that never ends: what the next lap shows too has changed.
#[test]
fn what_a_second_pass_shows_is_a_change() {
    let of_first_lap = |finding: &Finding| finding.laps == 1;
    let explain = |findings| {
        let by = |mismatch: &Finding| mismatch.shift.map(ShiftFit::known);
        explain_by_shift(findings, of_first_lap, by)
    };
    assert_eq!(explain(row(3)).len(), 1);
    let mut shown_twice = row(3);
    for finding in &mut shown_twice {
        finding.laps = 2;
    }
    assert_eq!(explain(shown_twice.clone()), shown_twice);
}

#[test]
fn passes_are_not_mixed() {
    let things = [0, 200, 400].map(|since_s| {
        let x = 0.01 * since_s as f64;
        displaced([x, 0.0], DISPLACEMENT, since_s)
    });
    assert_unexplained(things.into_iter().flatten().collect());
}

#[test]
fn things_far_from_each_other_are_no_segment() {
    let things = (0..3).map(|k| displaced([9.0 * f64::from(k), 0.0], DISPLACEMENT, 4));
    assert_unexplained(things.flatten().collect());
}

#[test]
fn a_true_change_of_the_same_pass_stays() {
    let change = finding(Appeared, [30.0, 5.0], 20);
    let left = explain([vec![change.clone()], row(4)].concat());
    assert_eq!((left.len(), &left[0]), (2, &change));
    assert_eq!(left[1].kind, MapMismatch);
    // Near by it stays too, …
    let near = finding(Disappeared, [3.0, 2.0], 20);
    assert_eq!(explain([vec![near.clone()], row(4)].concat())[0], near);
    // … and where much else has changed nothing is explained away.
    let many = |count: i64| {
        let others = (0..count).map(|k| finding(Appeared, [2.0 * k as f64, 2.5], 20));
        [row(3), others.collect()].concat()
    };
    assert_eq!(only_mismatch(many(3)).1, 3);
    assert_unexplained(many(4));
}

#[test]
fn each_finding_is_in_one_pair_only() {
    // Three things stood where one came near to all of them.
    let old = [[0.0, 0.0], [0.1, 0.05], [0.05, 0.1]].map(|at| finding(Disappeared, at, 4));
    let far = displaced([4.0, 0.0], DISPLACEMENT, 4);
    let one = finding(Appeared, [0.45, -0.05], 5);
    assert_unexplained([old.to_vec(), far.to_vec(), vec![one]].concat());
}

#[test]
fn among_things_at_equal_distances_the_shortest_shift_is_taken() {
    // Posts 1 m apart: what appeared lies 0.3 m after one and 0.7 m before the next.
    let posts = (0..6).flat_map(|k| displaced([f64::from(k), 0.0], [0.3, 0.0], 4));
    let (mismatch, others) = only_mismatch(posts.collect());
    assert_eq!(others, 0);
    assert!((mismatch.shift.unwrap() - Vector2::new(-0.3, 0.0)).norm() < 1e-9);
}

#[test]
fn it_ends_when_all_that_it_explains_has_ended() {
    let mut findings = row(3);
    for (finding, end) in findings.iter_mut().zip(100..) {
        finding.until = Some(StampNs(end));
    }
    assert_eq!(only_mismatch(findings.clone()).0.until, Some(StampNs(105)));
    findings[2].until = None;
    assert_eq!(only_mismatch(findings).0.until, None);
}

/// Things at places in a room, displaced by nearly one vector or by any.
fn some_findings() -> impl Strategy<Value = Vec<Finding>> {
    let thing = (0.0..12.0_f64, 0.0..3.0_f64, 0..300_i64, any::<bool>());
    let by = (-0.8..0.8_f64, -0.8..0.8_f64);
    let common = prop_oneof![3 => Just(true), 1 => Just(false)];
    prop::collection::vec((thing, by, common), 0..10).prop_map(|things| {
        let sides = things
            .into_iter()
            .map(|((x, y, since_s, tuesday), by, common)| {
                let by = if common {
                    [0.4 + 0.1 * by.0, 0.1 * by.1]
                } else {
                    [by.0, by.1]
                };
                let trip = if tuesday { "tuesday" } else { "monday" };
                of_trip(trip, displaced([x, y], by, since_s))
            });
        sides.flatten().collect()
    })
}

fn sorted(mut findings: Vec<Finding>) -> Vec<Finding> {
    findings.sort_by(in_order);
    findings
}

proptest! {
    #[test]
    fn the_order_of_the_findings_does_not_matter(
        (findings, shuffled) in some_findings()
            .prop_flat_map(|findings| (Just(findings.clone()), Just(findings).prop_shuffle())),
    ) {
        let explained = sorted(explain(findings));
        prop_assert_eq!(explained, sorted(explain(shuffled)));
    }

    #[test]
    fn what_is_left_stays_as_it_was_and_nothing_else_is_explained(findings in some_findings()) {
        let explained = explain(findings.clone());
        let is_mismatch = |finding: &&Finding| finding.kind == MapMismatch;
        let left: Vec<&Finding> = explained.iter().filter(|f| !is_mismatch(f)).collect();
        let mut rest = findings.iter();
        prop_assert!(left.iter().all(|finding| rest.any(|of_all| of_all == *finding)));
        for mismatch in explained.iter().filter(is_mismatch) {
            let shift = mismatch.shift.unwrap_or_default();
            prop_assert!(shift.norm() >= SHIFT_MIN_M && shift.norm() <= SHIFT_MAX_M);
            prop_assert_eq!(mismatch.trips.len(), 1);
        }
        prop_assert_eq!(explain(explained.clone()), explained);
    }
}
