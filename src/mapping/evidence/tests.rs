use std::collections::BTreeSet;
use std::sync::Arc;

use super::super::keyframe::Keyframe;
use super::super::route_map::Weighting;
use super::super::settle::{ACTIVE_STRETCHES, FIRST_STRETCHES, Stay};
use super::*;
use crate::calibration::{Estimate, Quantity, VehicleFault};
use crate::change::{ChangeKind, Tier};
use crate::geometry::{Pose2, Vector2};
use crate::ids::{NodeId, StampNs};
use crate::observation::testing::{World, all_round};

const BEAMS: usize = 720;
const SCANS_OF_A_PASS: i64 = 24;
/// Where posts stand in a corridor along x and how wide they are, metres.
const POSTS: [[f64; 3]; 5] = [
    [2.0, 1.0, 0.3],
    [4.0, -1.1, 0.24],
    [6.0, 1.1, 0.3],
    [8.0, -1.0, 0.34],
    [10.0, 1.05, 0.26],
];

/// A corridor with posts, which stand off where they were.
fn corridor(off_m: f64) -> World {
    let walls = World::default()
        .with_side([-30.0, -1.6], [40.0, -1.6])
        .with_side([-30.0, 1.6], [40.0, 1.6]);
    POSTS.iter().fold(walls, |world, [x, y, width]| {
        let (x, half) = (x + off_m, 0.5 * width);
        world.with_rectangle([x - half, y - half], [x + half, y + half])
    })
}

/// Passes of a trip through the corridor, that are held to have been driven elsewhere.
fn passes(trip: &str, stamps_s: &[i64], first_node: i64, off: [f64; 2]) -> Vec<(Pose2, Keyframe)> {
    passes_through(&corridor(0.0), trip, stamps_s, first_node, off)
}

fn passes_through(
    world: &World,
    trip: &str,
    stamps_s: &[i64],
    first_node: i64,
    off: [f64; 2],
) -> Vec<(Pose2, Keyframe)> {
    let lidar = Arc::new(all_round(BEAMS));
    let scans = stamps_s
        .iter()
        .flat_map(|s| (0..SCANS_OF_A_PASS).map(move |k| (s, k)));
    let taken = scans.zip(first_node..).map(|((from_s, k), node)| {
        let at = Pose2::new(0.5 * k as f64, 0.1, 0.0);
        let stamp = StampNs((from_s * 1_000 + 500 * k) * 1_000_000);
        let scan = world.scan(&lidar, BEAMS, &at, || 0.0);
        let trip = TripId::new(trip).unwrap();
        let keyframe = Keyframe::new(NodeId(node), trip, stamp, at, scan);
        (Pose2::new(at.x + off[0], at.y + off[1], 0.0), keyframe)
    });
    taken.collect()
}

fn map_of(nodes: Vec<(Pose2, Keyframe)>) -> RouteMap {
    let next = NodeId(nodes.len() as i64 + 1);
    RouteMap::restore(Weighting::Robust, nodes, [], next, EdgeId(1)).unwrap()
}

fn findings(map: &mut RouteMap, sites: Sites, pending: &[Finding]) -> Vec<Finding> {
    map.findings(&Scope {
        sites,
        pending,
        false_alerts_per_lap: 0.01,
        accepted: &[],
        vehicles: &BTreeMap::new(),
        suspects: &[],
    })
}

/// Three passes of one trip that lie where they were, and three of another that lie off by some
/// metres along the corridor.
fn shifted_map(off_m: f64) -> RouteMap {
    let right = passes("monday", &[0, 1_000, 2_000], 1, [0.0, 0.0]);
    let next = right.len() as i64 + 1;
    let shifted = passes("tuesday", &[100_000, 101_000, 102_000], next, [off_m, 0.0]);
    map_of([right, shifted].concat())
}

#[test]
fn a_trip_that_lies_shifted_along_a_corridor_is_one_mismatch() {
    for off_m in [0.2, 0.4, 0.7] {
        let found = findings(&mut shifted_map(off_m), Sites::All, &[]);
        assert_eq!(found.len(), 1, "{off_m}: {found:?}");
        assert_eq!(found[0].kind, ChangeKind::MapMismatch);
        assert_eq!(found[0].trips, [TripId::new("tuesday").unwrap()]);
        let off = found[0].shift.unwrap() + Vector2::new(off_m, 0.0);
        assert!(off.norm() < 0.02, "{off_m}: {off}");
    }
}

#[test]
fn a_mismatch_stays_until_its_segment_is_judged_anew_as_a_whole() {
    let mut map = shifted_map(0.4);
    let found = findings(&mut map, Sites::All, &[]);
    assert_eq!(findings(&mut map, Sites::Touched, &found), found);
    // A pass where the map is right ends it, and brings no change to light.
    let next = map.keyframes().len() as i64 + 1;
    for (pose, keyframe) in passes("wednesday", &[200_000], next, [0.0, 0.0]) {
        map.insert_keyframe(pose, keyframe).unwrap();
    }
    let later = findings(&mut map, Sites::Touched, &found);
    assert_eq!(later.len(), 1, "{later:?}");
    assert!(later[0].shift.is_some() && later[0].until.is_some());
    assert_eq!(findings(&mut map, Sites::All, &[]), later);
}

/// Monday's trip, and Tuesday's to which a box has come.
fn two_trips() -> [Vec<(Pose2, Keyframe)>; 2] {
    let stamps_s = [0, 1_000, 2_000];
    let before = passes("monday", &stamps_s, 1, [0.0, 0.0]);
    let with_box = corridor(0.0).with_rectangle([5.0, -1.2], [5.4, -0.8]);
    let stamps_s = stamps_s.map(|s| s + 100_000);
    let next = before.len() as i64 + 1;
    let since = passes_through(&with_box, "tuesday", &stamps_s, next, [0.0, 0.0]);
    [before, since]
}

/// A vehicle of which a mount turned before its trip on Tuesday.
fn turned(turn_rad: f64) -> Suspect {
    let (before, now) = (
        Estimate {
            value: 0.0,
            sigma: 0.001,
        },
        Estimate {
            value: turn_rad,
            sigma: 0.001,
        },
    );
    let fault = VehicleFault {
        lidar: None,
        quantity: Some(Quantity::MountYaw),
        before: Some(before),
        now: Some(now),
        text: "turned".to_owned(),
    };
    Suspect {
        vehicle: VehicleId::new("knocked").unwrap(),
        faults: vec![fault],
        trips: vec![TripId::new("tuesday").unwrap()],
        scans: 72,
        sound_until: Some(StampNs(50_000_000_000_000)),
        since: StampNs(100_000_000_000_000),
        last_seen: StampNs(102_000_000_000_000),
        until: None,
        tier: Tier::Tentative,
        significance: 9.0,
    }
}

fn of_kind(findings: &[Finding], kind: ChangeKind) -> Vec<&Finding> {
    findings.iter().filter(|f| f.kind == kind).collect()
}

/// What is found with a suspect, where the trips are of these vehicles.
fn with_suspect(map: &mut RouteMap, suspect: &Suspect, vehicles: [&str; 2]) -> Vec<Finding> {
    let trips = ["monday", "tuesday"].map(|trip| TripId::new(trip).unwrap());
    let vehicles = vehicles.map(|vehicle| VehicleId::new(vehicle).unwrap());
    map.findings(&Scope {
        sites: Sites::All,
        pending: &[],
        false_alerts_per_lap: 0.01,
        accepted: &[],
        vehicles: &trips.into_iter().zip(vehicles).collect(),
        suspects: std::slice::from_ref(suspect),
    })
}

#[test]
fn a_fault_silences_what_it_explains_and_lists_it() {
    let [before, since] = two_trips();
    let mut map = map_of([before, since].concat());
    let sound = findings(&mut map, Sites::All, &[]);
    assert_eq!(sound.len(), 1, "{sound:?}");
    assert_eq!(
        (sound[0].kind, sound[0].tier),
        (ChangeKind::Appeared, Tier::Confirmed)
    );
    // The box is 0.4 m across and stands 0.4 m off the wall: only a large turn puts a wall there.
    for (turn_rad, vehicles, is_silenced) in [
        (0.02, ["other", "knocked"], false),
        (0.5, ["other", "knocked"], true),
        (0.5, ["knocked", "knocked"], true),
        (0.5, ["knocked", "other"], false),
    ] {
        let found = with_suspect(&mut map, &turned(turn_rad), vehicles);
        let [against] = of_kind(&found, ChangeKind::VehicleSuspect)[..] else {
            panic!("{found:?}");
        };
        let evidence = against.suspect.as_ref().unwrap();
        let appeared = of_kind(&found, ChangeKind::Appeared);
        assert_eq!(appeared.is_empty(), is_silenced, "{turn_rad} {vehicles:?}");
        assert_eq!(evidence.silenced.len(), usize::from(is_silenced));
        assert!(
            evidence
                .silenced
                .iter()
                .all(|_| evidence.has_silenced(&sound[0].as_silenced()))
        );
        assert_eq!(against.location, Vector2::new(0.0, 0.1));
    }
    // A vehicle that is known anew is not silenced any more.
    let known = Suspect {
        until: Some(StampNs(103_000_000_000_000)),
        ..turned(0.5)
    };
    let found = with_suspect(&mut map, &known, ["other", "knocked"]);
    assert_eq!(of_kind(&found, ChangeKind::Appeared), [&sound[0]]);
}

/// A side branch that the first three drives saw, the first of them hardly, and then nobody until a
/// box stands there.
fn seldom_visited() -> RouteMap {
    let stamp_s = |trip: i64| 10_000 * trip;
    let mut nodes: Vec<(Pose2, Keyframe)> = Vec::new();
    for trip in 0..3 {
        let of_trip = passes(
            &format!("trip-{trip:02}"),
            &[stamp_s(trip)],
            1 + 100 * trip,
            [0.0, 0.0],
        );
        let seen = if trip == 0 { 9..12 } else { 0..of_trip.len() };
        nodes.extend_from_slice(&of_trip[seen]);
    }
    for (_, keyframe) in &mut nodes[..3] {
        keyframe.reference = true;
    }
    for trip in 3..20 {
        let elsewhere = [0.0, 100.0];
        let name = format!("trip-{trip:02}");
        nodes.extend(passes(&name, &[stamp_s(trip)], 1 + 100 * trip, elsewhere));
    }
    let world = corridor(0.0).with_rectangle([5.0, -1.2], [5.4, -0.8]);
    let last = passes_through(&world, "trip-20", &[stamp_s(20)], 2_001, [0.0, 0.0]);
    nodes.extend(last);
    RouteMap::restore(Weighting::Robust, nodes, [], NodeId(3_000), EdgeId(1)).unwrap()
}

#[test]
fn what_has_left_the_map_is_decided_as_if_it_were_there() {
    let whole = findings(&mut seldom_visited(), Sites::All, &[]);
    assert_eq!(whole.len(), 1, "{whole:?}");
    assert_eq!(whole[0].kind, ChangeKind::Appeared);
    let after_leave = |first_stretches: usize| {
        let mut map = seldom_visited();
        let leaving = map.settled_nodes(&Stay {
            stretches: ACTIVE_STRETCHES,
            first_stretches,
            trip: &TripId::new("trip-20").unwrap(),
            nodes: &BTreeSet::new(),
        });
        assert!(leaving.len() > 3 * SCANS_OF_A_PASS as usize);
        map.release(&leaving).unwrap();
        findings(&mut map, Sites::All, &[])
    };
    assert_eq!(after_leave(FIRST_STRETCHES), whole);
    // References alone saw too little of it.
    assert_eq!(after_leave(0), []);
}
