//! Layers: what one height band shows is no evidence for or against another.

use std::sync::Arc;

use super::super::drive::{Drive, DriveScan, InitialPose, LidarOfVehicle};
use super::super::keyframe::Keyframe;
use super::super::route_map::Weighting;
use super::*;
use crate::change::{ChangeKind, fold};
use crate::geometry::Pose2;
use crate::ids::{LidarId, NodeId, StampNs};
use crate::observation::testing::{World, all_round};
use crate::scan::{BandView, HeightBand, Lidar};

const BEAMS: usize = 720;
const SCANS_OF_A_PASS: i64 = 24;

fn low() -> HeightBand {
    HeightBand::new(0.1, 0.4).unwrap()
}

fn high() -> HeightBand {
    HeightBand::new(0.6, 1.0).unwrap()
}

/// A corridor with a pillar at either side.
fn corridor() -> World {
    World::default()
        .with_side([-30.0, -1.6], [40.0, -1.6])
        .with_side([-30.0, 1.6], [40.0, 1.6])
        .with_rectangle([2.0, 1.0], [2.4, 1.4])
        .with_rectangle([8.0, -1.3], [8.3, -0.9])
}

fn with_box(world: World) -> World {
    world.with_rectangle([5.0, -1.2], [5.6, -0.7])
}

/// The lidar of a band.
fn lidar(band: Option<HeightBand>) -> Arc<Lidar> {
    Arc::new(Lidar {
        band: band.map(|band| BandView::all_the_way(band, 20.0)),
        ..all_round(BEAMS)
    })
}

/// Passes of a trip through a world, as a band shows it.
fn passes(
    (trip, band): (&str, Option<HeightBand>),
    world: &World,
    stamps_s: &[i64],
    nodes: &mut Vec<(Pose2, Keyframe)>,
) {
    let lidar = lidar(band);
    for from_s in stamps_s {
        for k in 0..SCANS_OF_A_PASS {
            let at = Pose2::new(0.5 * k as f64, 0.1, 0.0);
            let stamp = StampNs((from_s * 1_000 + 500 * k) * 1_000_000);
            let scan = world.scan(&lidar, BEAMS, &at, || 0.0);
            let (node, trip) = (NodeId(nodes.len() as i64 + 1), TripId::new(trip).unwrap());
            nodes.push((at, Keyframe::new(node, trip, stamp, at, scan)));
        }
    }
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

const BEFORE_S: [i64; 3] = [0, 1_000, 2_000];
const AFTER_S: [i64; 3] = [100_000, 101_000, 102_000];

#[test]
fn a_hit_in_one_band_and_a_miss_in_another_are_no_change() {
    // The same world for ever: a shelf that the high band shows and the low one does not, passed by
    // one band after the other.
    for bands in [[Some(low()), Some(high())], [None, Some(high())]] {
        for [first, then] in [bands, [bands[1], bands[0]]] {
            let seen_by = |band| match band == Some(high()) {
                true => with_box(corridor()),
                false => corridor(),
            };
            let mut nodes = Vec::new();
            passes(("first", first), &seen_by(first), &BEFORE_S, &mut nodes);
            passes(("then", then), &seen_by(then), &AFTER_S, &mut nodes);
            let found = findings(&mut map_of(nodes), Sites::All, &[]);
            assert!(found.is_empty(), "{found:?}");
        }
    }
}

#[test]
fn a_change_that_one_band_shows_is_found_in_it_alone() {
    let mut nodes = Vec::new();
    for (trip, band) in [("floor", low()), ("table", high())] {
        passes((trip, Some(band)), &corridor(), &BEFORE_S, &mut nodes);
    }
    passes(
        ("floor-later", Some(low())),
        &corridor(),
        &AFTER_S,
        &mut nodes,
    );
    let changed = with_box(corridor());
    passes(
        ("table-later", Some(high())),
        &changed,
        &AFTER_S,
        &mut nodes,
    );
    let found = findings(&mut map_of(nodes), Sites::All, &[]);
    assert_eq!(found.len(), 1, "{found:?}");
    assert_eq!(
        (found[0].kind, &*found[0].bands),
        (ChangeKind::Appeared, &[high()][..])
    );
    assert_eq!(found[0].trips, [TripId::new("table-later").unwrap()]);
}

/// A trip before and one since a box stands there, both of two bands at once.
fn both_bands(band_of_box: &[HeightBand]) -> RouteMap {
    let mut nodes = Vec::new();
    for (trip, stamps_s) in [("monday", BEFORE_S), ("tuesday", AFTER_S)] {
        for band in [low(), high()] {
            let world = match trip == "tuesday" && band_of_box.contains(&band) {
                true => with_box(corridor()),
                false => corridor(),
            };
            passes((trip, Some(band)), &world, &stamps_s, &mut nodes);
        }
    }
    map_of(nodes)
}

#[test]
fn what_two_bands_show_in_one_pass_is_one_event() {
    let mut map = both_bands(&[low(), high()]);
    let found = findings(&mut map, Sites::All, &[]);
    assert_eq!(found.len(), 1, "{found:?}");
    assert_eq!(found[0].bands, [low(), high()]);
    // Where nothing was touched it stands as it is, and one alert tells of it.
    assert_eq!(findings(&mut map, Sites::Touched, &found), found);
    assert_eq!(fold(&[], &found).len(), 1);
}

#[test]
fn each_band_says_whether_it_changed() {
    for bands in [[low()], [high()]] {
        let found = findings(&mut both_bands(&bands), Sites::All, &[]);
        assert_eq!(found.len(), 1, "{found:?}");
        assert_eq!(found[0].bands, bands);
    }
}

/// A drive along the corridor, and back to where it began.
fn drive((trip, band): (&str, Option<HeightBand>), world: &World, from_s: i64) -> Drive {
    let lidar = lidar(band);
    let scans = (0..40).map(|k: i64| {
        let at = Pose2::new(0.3 * k as f64, 0.1, 0.0);
        DriveScan {
            beam_interval_s: 0.0,
            lidar: LidarOfVehicle::default(),
            stamp: StampNs((from_s * 1_000 + 300 * k) * 1_000_000),
            odom_from_base: at,
            scan: world.scan(&lidar, BEAMS, &at, || 0.0),
        }
    });
    Drive {
        wheels: Default::default(),
        trip: TripId::new(trip).unwrap(),
        initial_pose: Some(InitialPose {
            pose: Pose2::new(0.0, 0.1, 0.0),
            sigma_xy_m: 0.1,
            sigma_theta_rad: 0.02,
        }),
        scans: scans.collect(),
    }
}

/// The bands of the references that a trip is tied to.
fn tied_to(map: &RouteMap, trip: &str) -> Vec<Layer> {
    let keyframe = |node| map.keyframe(node).unwrap();
    let closures = map.graph().edges().iter();
    let closures = closures.filter(|edge| edge.kind == EdgeKind::LoopClosure);
    let of_trip = closures.filter(|edge| keyframe(edge.to).trip.as_str() == trip);
    let mut layers: Vec<Layer> = of_trip.map(|edge| keyframe(edge.from).layer()).collect();
    layers.sort_unstable();
    layers.dedup();
    layers
}

#[test]
fn the_first_trip_of_a_band_is_tied_to_others_and_the_next_to_its_like() {
    for weighting in [Weighting::Robust, Weighting::AllPointsIdentity] {
        let mut map = RouteMap::new(weighting);
        let high_world = with_box(corridor());
        for (trip, band, world) in [
            ("floor", low(), &corridor()),
            ("table", high(), &high_world),
            ("table-again", high(), &high_world),
            ("floor-again", low(), &corridor()),
        ] {
            let from_s = 10_000 * map.keyframes().len() as i64;
            map.extend(&drive((trip, Some(band)), world, from_s))
                .unwrap();
        }
        let crossing = match weighting {
            Weighting::Robust => vec![Some(low())],
            Weighting::AllPointsIdentity | Weighting::Paper => Vec::new(),
        };
        let first = tied_to(&map, "table");
        assert!(
            first.iter().all(|layer| crossing.contains(layer)),
            "{first:?}"
        );
        assert_eq!(first.is_empty(), crossing.is_empty());
        assert_eq!(tied_to(&map, "table-again"), [Some(high())]);
        assert_eq!(tied_to(&map, "floor-again"), [Some(low())]);
        let references = map.keyframes().iter().filter(|keyframe| keyframe.reference);
        let of_high = references.filter(|keyframe| keyframe.layer() == Some(high()));
        assert!(of_high.count() > 5, "each band has references of its own");
    }
}

#[test]
fn of_two_bands_of_one_vehicle_the_first_makes_the_map_and_both_observe() {
    let named = |name: &str, place, drive: Drive| {
        let lidar = LidarOfVehicle {
            name: Some(LidarId::new(name).unwrap()),
            place,
        };
        let scans = drive.scans.into_iter();
        scans.map(move |scan| DriveScan {
            lidar: lidar.clone(),
            ..scan
        })
    };
    let drive_of = |trip: &str, from_s, high_world: &World| {
        let floor = drive((trip, Some(low())), &corridor(), from_s);
        let table = drive((trip, Some(high())), high_world, from_s);
        let scans = named("floor", 0, floor.clone()).zip(named("table", 1, table));
        Drive {
            scans: scans.flat_map(|(floor, table)| [floor, table]).collect(),
            ..floor
        }
    };
    let mut map = RouteMap::new(Weighting::Robust);
    let changed = with_box(corridor());
    for (trip, from_s) in [("first", 0), ("second", 10_000)] {
        map.extend(&drive_of(trip, from_s, &corridor())).unwrap();
    }
    for (trip, from_s) in [("third", 20_000), ("fourth", 30_000)] {
        map.extend(&drive_of(trip, from_s, &changed)).unwrap();
    }
    for keyframe in map.keyframes() {
        assert_eq!(keyframe.layer(), Some(low()));
        // The points of the table's band would be as many again.
        assert!(keyframe.points.len() <= BEAMS);
    }
    let found = findings(&mut map, Sites::All, &[]);
    assert_eq!(found.len(), 1, "{found:?}");
    assert_eq!(
        (found[0].kind, &*found[0].bands),
        (ChangeKind::Appeared, &[high()][..])
    );
}

#[test]
fn a_band_alone_is_judged_as_a_plane_is() {
    let found_by = |band: Option<HeightBand>| {
        let mut nodes = Vec::new();
        passes(("monday", band), &corridor(), &BEFORE_S, &mut nodes);
        passes(
            ("tuesday", band),
            &with_box(corridor()),
            &AFTER_S,
            &mut nodes,
        );
        findings(&mut map_of(nodes), Sites::All, &[])
    };
    let (plane, band) = (found_by(None), found_by(Some(low())));
    assert_eq!(plane.len(), 1);
    let without_band = |finding: &Finding| Finding {
        bands: Vec::new(),
        ..finding.clone()
    };
    assert_eq!(band.iter().map(without_band).collect::<Vec<_>>(), plane);
}
