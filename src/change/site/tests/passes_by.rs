//! What passes by a box that comes or goes saw of it.

use super::*;
use crate::model::{PassOutcome, PassSide};

use PassOutcome::{CouldNotSee, NewState, OldState};
use PassSide::{Before, Since};

/// The passes by a finding, of the scans that are known.
fn passes_by(scans: &[Taken], finding: &Finding) -> Vec<PassSeen> {
    let trips: Vec<TripId> = (0..10).map(trip_name).collect();
    let mut observations: Vec<Observed> = scans.iter().map(Taken::observed).collect();
    observations.sort_by_key(|o| (o.trip, o.stamp));
    let presences = observations.iter().map(|observed| Presence {
        node: observed.node,
        standpoint: observed.standpoint(),
    });
    let presences: Vec<Presence> = presences.collect();
    let site = Site {
        candidates: &[finding.location],
        changed_around: &[],
        observations,
        accepted: &[],
        trips: &trips,
        support_min: support_min(FALSE_ALERTS_PER_LAP),
    };
    pass_outcomes(finding, &[site], &presences)
}

fn seen(passes: &[PassSeen]) -> Vec<(usize, PassSide, PassOutcome)> {
    let passes = passes.iter();
    passes.map(|p| (p.trip, p.side, p.outcome)).collect()
}

#[test]
fn each_pass_says_what_it_saw() {
    for worlds in [
        [room(), room(), with_box(), with_box()],
        [with_box(), with_box(), room(), room()],
    ] {
        let scans = passes(&worlds);
        let found = passes_by(&scans, &the_box(&scans));
        let expected = [
            (0, Before, OldState),
            (1, Before, OldState),
            (2, Since, NewState),
            (3, Since, NewState),
        ];
        assert_eq!(seen(&found), expected);
        for pass in &found {
            let own = |taken: &&Taken| taken.node == pass.node && taken.trip == pass.trip;
            let best = scans.iter().find(own).unwrap();
            assert!(pass.begins <= best.stamp && best.stamp <= pass.ends);
        }
        assert!(found[2].begins <= the_box(&scans).since);
    }
}

#[test]
fn what_has_left_again_is_seen_as_it_was() {
    let scans = passes(&[room(), with_box(), with_box(), room()]);
    let found = passes_by(&scans, &the_box(&scans));
    assert_eq!(found[2].outcome, NewState);
    assert_eq!((found[3].side, found[3].outcome), (Since, OldState));
}

#[test]
fn an_earlier_episode_is_one_before() {
    let worlds = [room(), with_box(), with_box(), room(), room()];
    let again = [with_box(), with_box()];
    let scans = passes(worlds.iter().chain(&again));
    let found = passes_by(&scans, &the_box(&scans));
    let sides: Vec<PassSide> = found.iter().map(|pass| pass.side).collect();
    assert_eq!(
        sides,
        [Before, Before, Before, Before, Before, Since, Since]
    );
    let outcomes: Vec<PassOutcome> = found.iter().map(|pass| pass.outcome).collect();
    assert_eq!(outcomes[..3], [OldState, NewState, NewState]);
    assert_eq!(outcomes[3..], [OldState, OldState, NewState, NewState]);
}

/// A vehicle in the room while a screen hides the place of the box.
#[test]
fn a_pass_within_reach_that_is_hidden_could_not_see() {
    let screen = |world: World| world.with_rectangle([0.9, 1.7], [5.4, 1.8]);
    let mut scans = passes(&[room(), with_box(), with_box()]);
    let mut hidden = standing(3, &screen(with_box()), 12, 0.5);
    let finding = the_box(&scans);
    scans.append(&mut hidden);
    let found = passes_by(&scans, &finding);
    assert_eq!(seen(&found).last(), Some(&(3, Since, CouldNotSee)));
    assert_eq!(found.len(), 4);
    let earlier = passes_by(&scans[12..], &finding);
    assert_eq!(found[1..], earlier[..], "each pass speaks for itself");
}

#[test]
fn a_pass_whose_scans_disagree_could_not_see() {
    let mut scans = passes(&[room(), with_box(), with_box()]);
    let finding = the_box(&scans);
    let (free, occupied) = (pass(4, &room()), pass(4, &with_box()));
    let every_other = free.into_iter().zip(occupied).enumerate();
    scans.extend(every_other.map(|(k, (free, occupied))| if k % 2 == 0 { free } else { occupied }));
    let found = passes_by(&scans, &finding);
    assert_eq!(seen(&found).last(), Some(&(4, Since, CouldNotSee)));
}

#[test]
fn the_order_of_the_observations_does_not_matter() {
    let scans = passes(&[room(), room(), with_box(), with_box()]);
    let finding = the_box(&scans);
    let mut reversed = scans.clone();
    reversed.reverse();
    assert_eq!(passes_by(&reversed, &finding), passes_by(&scans, &finding));
}
