mod passes_by;

use std::sync::Arc;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::answers::{Answer, Answers};
use super::cells::SiteCells;
use super::*;
use crate::change::screen::SURROUNDINGS_M;
use crate::change::testing::gaussian;
use crate::change::{ChangeKind, FALSE_ALERTS_PER_LAP, Finding, Screen, Screened, Tier};
use crate::geometry::{Pose2, distance_to_polygon};
use crate::ids::{AlertId, EdgeId};
use crate::observation::Outcome;
use crate::observation::testing::{World, all_round};
use crate::scan::LaserScan;

const BEAMS: usize = 360;
const SIGMA_M: f64 = 0.01;
const BOX: [[f64; 2]; 2] = [[3.0, 2.4], [3.5, 2.9]];
/// What a pass says of a cluster at most, less the cost of a change, in nats.
const SUPPORT_OF_ONE_PASS: f64 = 12.0 - 4.6;

fn room() -> World {
    World::default()
        .with_rectangle([0.0, 0.0], [6.0, 4.5])
        .with_rectangle([0.8, 3.4], [1.8, 4.1])
}

fn with_box() -> World {
    room().with_rectangle(BOX[0], BOX[1])
}

fn box_region() -> Vec<Vector2<f64>> {
    let [[x, y], [to_x, to_y]] = BOX;
    let corners = [[x, y], [to_x, y], [to_x, to_y], [x, to_y]];
    corners.map(Vector2::from).to_vec()
}

/// A scan as a map has it.
#[derive(Clone)]
struct Taken {
    node: NodeId,
    trip: usize,
    stamp: StampNs,
    map_from_base: Pose2,
    scan: LaserScan,
}

impl Taken {
    fn observed(&self) -> Observed {
        Observed {
            node: self.node,
            place: 0,
            trip: self.trip,
            stamp: self.stamp,
            map_from_base: self.map_from_base,
            observation: Observation::new(&self.scan, &self.map_from_base),
            agreement: Agreement::default(),
        }
    }
}

fn take(world: &World, trip: usize, seconds: f64, map_from_base: &Pose2) -> Taken {
    let stamp = StampNs((seconds * 1e9) as i64);
    let mut rng = ChaCha8Rng::seed_from_u64(stamp.0 as u64);
    let error_m = || SIGMA_M * gaussian(&mut rng);
    Taken {
        // No two scans are taken at one time.
        node: NodeId(stamp.0 / 1_000_000),
        trip,
        stamp,
        map_from_base: *map_from_base,
        scan: world.scan(&Arc::new(all_round(BEAMS)), BEAMS, map_from_base, error_m),
    }
}

/// A drive through the room, a trip of its own: 12 scans in 6 s, 1,000 s after the trip before.
fn pass(trip: usize, world: &World) -> Vec<Taken> {
    let view = |k: u32| {
        let k = f64::from(k);
        let along = Pose2::new(1.0 + 0.3 * k, 1.0 + 0.1 * trip as f64, 0.05 * k);
        take(world, trip, 1_000.0 * trip as f64 + 0.5 * k, &along)
    };
    (0..12).map(view).collect()
}

fn passes<'a>(worlds: impl IntoIterator<Item = &'a World>) -> Vec<Taken> {
    let worlds = worlds.into_iter().enumerate();
    worlds.flat_map(|(trip, world)| pass(trip, world)).collect()
}

/// A robot that stands beside the box's place, a scan every `every_s`.
fn standing(trip: usize, world: &World, scans: u32, every_s: f64) -> Vec<Taken> {
    let from_s = 1_000.0 * trip as f64;
    let view = |k| {
        take(
            world,
            trip,
            from_s + every_s * f64::from(k),
            &Pose2::new(3.1, 1.2, 0.3),
        )
    };
    (0..scans).map(view).collect()
}

/// The same scans, held to have been taken elsewhere.
fn misplaced(scans: Vec<Taken>, x: f64, y: f64) -> Vec<Taken> {
    let misplaced = scans.into_iter().map(|taken| {
        let pose = taken.map_from_base;
        let map_from_base = Pose2::new(pose.x + x, pose.y + y, pose.theta);
        Taken {
            map_from_base,
            ..taken
        }
    });
    misplaced.collect()
}

fn trip_name(trip: usize) -> TripId {
    TripId::new(format!("trip-{trip}")).unwrap()
}

/// What is found if places are chosen by the screen, as a map does it.
fn judge_with(scans: &[Taken], accepted: &[AcceptedChange]) -> Vec<Finding> {
    let trips: Vec<TripId> = (0..10).map(trip_name).collect();
    let mut screen = Screen::default();
    screen.update(scans.iter().map(|taken| Screened {
        key: (taken.node, 0),
        trip: &trips[taken.trip],
        stamp: taken.stamp,
        map_from_base: taken.map_from_base,
        scan: &taken.scan,
    }));
    let mut findings = Vec::new();
    for candidates in screen.all_sites() {
        let asked = screen.observations_of(&candidates);
        let asked = scans.iter().filter(|t| asked.contains(&(t.node, 0)));
        let mut observations: Vec<Observed> = asked.map(Taken::observed).collect();
        observations.sort_by_key(|o| (o.trip, o.stamp));
        let mut site = Site {
            candidates: &candidates.cells,
            changed_around: &candidates.around,
            observations,
            accepted,
            trips: &trips,
            support_min: support_min(FALSE_ALERTS_PER_LAP),
        };
        findings.extend(state_changes(&mut site, |observed| {
            let scan = observed.observation.scan();
            screen.fit(&(observed.node, 0), scan, &observed.map_from_base)
        }));
    }
    findings
}

fn judge(scans: &[Taken]) -> Vec<Finding> {
    judge_with(scans, &[])
}

/// The one finding there is, which must be the box.
fn the_box(scans: &[Taken]) -> Finding {
    let mut findings = judge(scans);
    assert_eq!(findings.len(), 1, "{findings:#?}");
    let finding = findings.remove(0);
    assert!(
        distance_to_polygon(&finding.location, &box_region()) < 0.05,
        "{finding:?}"
    );
    let is_near = |corner: &Vector2<f64>| distance_to_polygon(corner, &box_region()) < 0.12;
    assert!(finding.region.iter().all(is_near), "{finding:?}");
    finding
}

fn first_stamp(scans: &[Taken], trip: usize) -> StampNs {
    let of_trip = scans.iter().filter(|taken| taken.trip == trip);
    of_trip.map(|taken| taken.stamp).min().unwrap()
}

#[test]
fn a_room_that_stays_as_it_is_raises_nothing() {
    for count in [0, 1, 3] {
        assert_eq!(judge(&passes(&vec![room(); count])), []);
        assert_eq!(judge(&passes(&vec![with_box(); count])), []);
    }
}

#[test]
fn one_pass_against_one_is_found_and_tentative() {
    for (worlds, kind) in [
        ([room(), with_box()], ChangeKind::Appeared),
        ([with_box(), room()], ChangeKind::Disappeared),
    ] {
        let scans = passes(&worlds);
        let found = the_box(&scans);
        assert_eq!(found.kind, kind);
        assert_eq!((found.tier, found.laps), (Tier::Tentative, 1));
        assert_eq!(found.trips, [trip_name(1)]);
        assert_eq!(found.since, first_stamp(&scans, 1));
        assert!(found.last_seen > found.since);
        assert_eq!(found.until, None);
        assert!(found.views >= 10, "{}", found.views);
        assert!(found.confidence <= 1.0 / (1.0 + (-SUPPORT_OF_ONE_PASS).exp()));
    }
}

#[test]
fn two_passes_confirm_a_change() {
    for (worlds, kind) in [
        (vec![room(), with_box(), with_box()], ChangeKind::Appeared),
        (
            vec![room(), room(), with_box(), with_box()],
            ChangeKind::Appeared,
        ),
        (
            vec![with_box(), with_box(), room(), room()],
            ChangeKind::Disappeared,
        ),
    ] {
        let scans = passes(&worlds);
        let found = the_box(&scans);
        assert_eq!(found.kind, kind);
        assert_eq!((found.tier, found.laps), (Tier::Confirmed, 2));
        let since = first_stamp(&scans, worlds.len() - 2);
        assert_eq!((found.since, found.until), (since, None));
        let once = the_box(&scans[..scans.len() - 12]);
        assert!(found.confidence >= once.confidence);
    }
}

#[test]
fn a_change_that_ended_says_when() {
    let scans = passes(&[room(), with_box(), with_box(), room()]);
    let found = the_box(&scans);
    assert_eq!((found.kind, found.laps), (ChangeKind::Appeared, 2));
    assert_eq!(found.since, first_stamp(&scans, 1));
    assert_eq!(found.until, Some(first_stamp(&scans, 3)));
    assert!(found.last_seen < first_stamp(&scans, 3));
    assert_eq!(found.trips, [trip_name(1), trip_name(2)]);
}

#[test]
fn what_stood_there_for_one_pass_and_is_gone_is_no_change() {
    assert_eq!(judge(&passes(&[room(), with_box(), room()])), []);
}

#[test]
fn what_stands_there_again_begins_anew() {
    let worlds = [
        room(),
        with_box(),
        with_box(),
        room(),
        room(),
        with_box(),
        with_box(),
    ];
    let scans = passes(&worlds);
    let found = the_box(&scans);
    assert_eq!((found.since, found.until), (first_stamp(&scans, 5), None));
}

/// A cell needs two hits, so one scan is never enough; and the observations of the old state must
/// be worth a change (4.6 nats) and the support that an alert needs (4.5): six views of two nats
/// each, but for the noise.
#[test]
fn what_was_seen_from_one_standpoint_and_is_gone_is_asked_for() {
    let gone_after = |scans: u32, every_s: f64| {
        let before = standing(0, &with_box(), scans, every_s);
        judge(&[before, pass(1, &room())].concat())
    };
    for scans in [1, 2, 5] {
        assert_eq!(gone_after(scans, 0.5), [], "{scans}");
    }
    let found = gone_after(8, 0.5);
    assert_eq!(found.len(), 1, "{found:?}");
    assert_eq!(
        (found[0].kind, found[0].tier),
        (ChangeKind::Disappeared, Tier::Tentative)
    );
    // Eight views in a moment are hardly more than one.
    assert_eq!(gone_after(8, 0.01), []);
}

#[test]
fn a_robot_that_stands_says_no_more_than_a_pass_can() {
    let seen = |scans: u32| {
        let since = standing(1, &with_box(), scans, 0.1);
        let found = judge(&[pass(0, &room()), since].concat());
        assert_eq!(found.len(), 1, "{found:?}");
        assert_eq!((found[0].tier, found[0].laps), (Tier::Tentative, 1));
        found[0].confidence
    };
    let limit = 1.0 / (1.0 + (-SUPPORT_OF_ONE_PASS).exp());
    let (seventy, twice) = (seen(70), seen(140));
    assert!(seventy <= limit && twice <= limit);
    assert!((seventy - twice).abs() < 1e-3, "{seventy} {twice}");
}

/// A corridor that runs on out of sight, with pillars along its walls.
fn corridor() -> World {
    let walls = World::default()
        .with_side([-20.0, 0.0], [30.0, 0.0])
        .with_side([-20.0, 2.2], [30.0, 2.2]);
    let at = [-6.1, -3.0, 0.4, 2.9, 4.7, 8.2, 11.4, 15.0];
    at.iter().enumerate().fold(walls, |world, (k, &x)| {
        let y = if k % 2 == 0 { 0.0 } else { 2.0 };
        world.with_rectangle([x, y], [x + 0.4, y + 0.2])
    })
}

/// Along the corridor, a trip of its own.
fn along_corridor(trip: usize, world: &World) -> Vec<Taken> {
    let view = |k: u32| {
        let k = f64::from(k);
        let along = Pose2::new(1.0 + 0.4 * k, 1.0 + 0.05 * trip as f64, 0.0);
        take(world, trip, 1_000.0 * trip as f64 + 0.5 * k, &along)
    };
    (0..14).map(view).collect()
}

#[test]
fn a_pass_that_is_shifted_along_a_corridor_raises_nothing() {
    for (shift_m, old) in [(0.3, 1), (-0.3, 2), (0.45, 1)] {
        let mut scans = misplaced(along_corridor(old, &corridor()), shift_m, 0.0);
        scans.extend((0..old).flat_map(|trip| along_corridor(trip, &corridor())));
        assert_eq!(judge(&scans), [], "{shift_m} m after {old}");
    }
}

#[test]
fn a_change_in_a_corridor_is_found_where_the_poses_are_right() {
    let since = corridor().with_rectangle([3.6, 0.0], [4.1, 0.4]);
    let scans = [along_corridor(0, &corridor()), along_corridor(1, &since)].concat();
    let found = judge(&scans);
    assert_eq!(found.len(), 1, "{found:?}");
    assert_eq!(found[0].kind, ChangeKind::Appeared);
    assert!((found[0].location - Vector2::new(3.85, 0.3)).norm() < 0.25);
}

#[test]
fn observations_with_a_wrong_pose_raise_nothing() {
    for (x, y) in [(0.5, 0.0), (0.35, 0.35)] {
        let mut scans = passes(&vec![with_box(); 3]);
        scans.extend(misplaced(pass(3, &with_box()), x, y));
        assert_eq!(judge(&scans), [], "{x} {y}");
    }
}

#[test]
fn observations_with_a_wrong_pose_hide_no_change() {
    let scans = passes(&[room(), room(), with_box(), with_box()]);
    let right = the_box(&scans);
    let worlds = [(room(), false), (with_box(), true)];
    let shifts = [(0.0, 0.5), (0.4, 0.4)];
    for ((world, shows_box), (x, y)) in worlds.iter().flat_map(|w| shifts.map(|s| (w, s))) {
        // Between the others in time, and by a trip of its own.
        let wrong = misplaced(pass(4, world), x, y).into_iter();
        let wrong = wrong.map(|taken| Taken {
            stamp: StampNs(taken.stamp.0 - 2_500_000_000_000),
            ..taken
        });
        let found = the_box(&scans.iter().cloned().chain(wrong).collect::<Vec<_>>());
        assert_eq!((found.kind, found.tier), (right.kind, right.tier));
        assert_eq!(found.until, right.until);
        // It is left out, or matched again and speaks for the box where it saw it.
        let is_left_out = found.since == right.since && found.trips == right.trips;
        let speaks = found.since < right.since && found.trips.contains(&trip_name(4));
        assert!(is_left_out || (*shows_box && speaks), "{found:?}");
        assert!((found.location - right.location).norm() < 0.05);
    }
}

fn accepted(region: Vec<Vector2<f64>>, since: StampNs) -> AcceptedChange {
    AcceptedChange {
        alert_id: AlertId(uuid::Uuid::nil()),
        region,
        since,
        map_version: 2,
        nodes: Vec::new(),
        first_edge_id: EdgeId(0),
    }
}

#[test]
fn an_accepted_change_silences_what_was_before_and_nothing_else() {
    let scans = passes(&[room(), room(), with_box(), with_box()]);
    let found = the_box(&scans);
    let accept = |region, since| judge_with(&scans, &[accepted(region, since)]);
    assert_eq!(accept(found.region.clone(), found.since), []);
    // Neither elsewhere nor since.
    let elsewhere = found.region.iter().map(|c| c + Vector2::new(1.5, 0.0));
    assert_eq!(
        accept(elsewhere.collect(), found.since),
        std::slice::from_ref(&found)
    );
    assert_eq!(
        accept(found.region.clone(), StampNs(0)),
        std::slice::from_ref(&found)
    );
    // What leaves afterwards is a change of its own.
    let mut later = scans.clone();
    later.extend(pass(4, &room()));
    later.extend(pass(5, &room()));
    let gone = judge_with(&later, &[accepted(found.region.clone(), found.since)]);
    assert_eq!(gone.len(), 1, "{gone:?}");
    assert_eq!(gone[0].kind, ChangeKind::Disappeared);
    assert_eq!(gone[0].since, first_stamp(&later, 4));
}

#[test]
fn what_is_found_depends_on_neither_arrival_nor_the_names_of_trips() {
    let worlds = [
        room(),
        with_box(),
        with_box(),
        room(),
        with_box(),
        with_box(),
    ];
    for worlds in [&worlds[..4], &worlds] {
        let scans = passes(worlds);
        let found = judge(&scans);
        assert_eq!(found.len(), 1);
        let mut reversed = scans.clone();
        reversed.reverse();
        assert_eq!(judge(&reversed), found);
        // Trips sort by name, time does not.
        let renamed = scans.iter().map(|taken| Taken {
            trip: worlds.len() - 1 - taken.trip,
            ..taken.clone()
        });
        let renamed = judge(&renamed.collect::<Vec<_>>());
        assert_eq!(renamed.len(), 1, "{renamed:?}");
        let said = |f: &Finding| {
            (
                f.kind,
                f.tier,
                f.laps,
                f.views,
                f.since,
                f.last_seen,
                f.until,
            )
        };
        assert_eq!(said(&renamed[0]), said(&found[0]));
        assert_eq!(renamed[0].nodes, found[0].nodes);
        assert!((renamed[0].location - found[0].location).norm() < 1e-9);
        assert!((renamed[0].confidence - found[0].confidence).abs() < 1e-9);
    }
}

#[test]
fn a_no_return_counts_only_where_the_lidar_rarely_loses_a_surface() {
    // The second trip's lidar loses a tenth of every scan, the third one said next to nothing.
    let mut scans = passes(&[room(), room(), room()]);
    scans.truncate(25);
    for (k, taken) in scans.iter_mut().enumerate().filter(|(_, t)| t.trip == 1) {
        let lost = |beam: usize| (beam + BEAMS - 30 * (k % 12)) % BEAMS < BEAMS / 10;
        let ranges = taken.scan.ranges_m().enumerate();
        let ranges: Vec<_> = ranges.map(|(beam, r)| r.filter(|_| !lost(beam))).collect();
        taken.scan = LaserScan::new(taken.scan.lidar().clone(), ranges).unwrap();
    }
    let trips: Vec<TripId> = (0..3).map(trip_name).collect();
    let site = Site {
        candidates: &[Vector2::new(3.0, 0.0)],
        changed_around: &[],
        observations: scans.iter().map(Taken::observed).collect(),
        accepted: &[],
        trips: &trips,
        support_min: support_min(FALSE_ALERTS_PER_LAP),
    };
    let all = || 0..scans.len();
    let cells = SiteCells::of(&site, all(), SURROUNDINGS_M, 2);
    let around = Answers::of(&site, &cells, all());
    let mut answers = Answers::of(&site, &cells, all());
    let counts = |answers: &Answers, observation, outcome| {
        answers.counts(&Answer {
            observation,
            outcome,
        })
    };
    let (of_good, of_bad, of_third) = (0, 12, 24);
    assert_eq!(counts(&answers, of_good, Outcome::NoReturn), (0.0, 0.0));
    answers.weigh_no_returns(&site, &around);
    assert_eq!(counts(&answers, of_good, Outcome::NoReturn), (0.0, 0.3));
    assert_eq!(counts(&answers, of_bad, Outcome::NoReturn), (0.0, 0.0));
    assert_eq!(counts(&answers, of_third, Outcome::NoReturn), (0.0, 0.0));
    for observation in [of_good, of_bad, of_third] {
        assert_eq!(counts(&answers, observation, Outcome::Hit), (1.0, 0.0));
        assert_eq!(counts(&answers, observation, Outcome::Miss), (0.0, 1.0));
    }
}
