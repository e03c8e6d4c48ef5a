//! Vehicles with a lidar at the front and one at the rear.

use std::f64::consts::PI;
use std::sync::Arc;

use mapshift::change::{ChangeKind, Finding};
use mapshift::geometry::{Pose2, Vector2};
use mapshift::ids::{LidarId, StampNs, TripId};
use mapshift::mapping::{Drive, DriveScan, LidarOfVehicle, RouteMap, Scope, Sites, Weighting};
use mapshift::scan::{LaserScan, surface_points};
use mapshift::sim::{Scene, SceneObject, Shape, SimLidar, SimScan, Vehicle};

use crate::restored::put_away;
use crate::scans::apart;
use crate::support::{Trip, assert_equal, assert_sound, largest, vehicle, workshop};

const NAMES: [&str; 2] = ["front", "rear"];
const BATCH_SCANS: usize = 50;

/// Laps of a vehicle whose two lidars see half of the surroundings each.
struct TwoLidars {
    trip: TripId,
    /// Of the front lidar, and of the rear one at the same moments.
    drives: [Vec<SimScan>; 2],
    lidars: [SimLidar; 2],
}

fn two_lidars(trip: &str, scene: &Scene, laps: std::ops::Range<usize>, seed: u64) -> TwoLidars {
    let lidars = SimLidar::front_and_rear(PI, 181, 20.0, 0.01);
    let vehicle = Vehicle {
        lidar: lidars[0].clone(),
        ..vehicle()
    };
    let rear = scene.drive_of_companion(&vehicle, (1, &lidars[1]), laps.clone(), seed);
    TwoLidars {
        trip: TripId::new(trip).unwrap(),
        drives: [scene.drive(&vehicle, laps, seed), rear],
        lidars,
    }
}

fn shop(seed: u64) -> Scene {
    let (world, route) = workshop();
    Scene::lasting(route, world.shapes().cloned(), seed)
}

impl TwoLidars {
    fn scan(&self, place: usize, k: usize) -> DriveScan {
        let geometry = Arc::new(self.lidars[place].geometry.clone());
        let scan = &self.drives[place][k];
        DriveScan {
            stamp: StampNs((scan.time_s * 1e9) as i64),
            odom_from_base: scan.odom_from_base,
            beam_interval_s: 0.0,
            lidar: LidarOfVehicle {
                name: Some(LidarId::new(NAMES[place]).unwrap()),
                place,
            },
            scan: LaserScan::new(geometry, scan.ranges_m.clone()).unwrap(),
        }
    }

    /// Both lidars' scans, of each the k-th where it takes them.
    fn scans(&self, takes: impl Fn(usize, usize) -> bool) -> Vec<DriveScan> {
        let both = (0..self.drives[0].len()).flat_map(|k| [(0, k), (1, k)]);
        let taken = both.filter(|&(place, k)| takes(place, k));
        taken.map(|(place, k)| self.scan(place, k)).collect()
    }

    fn batches(&self, scans: &[DriveScan]) -> Vec<Drive> {
        let start = Trip {
            id: self.trip.clone(),
            scans: Vec::new(),
            truth: vec![self.drives[0][0].map_from_base],
            laps: Vec::new(),
        };
        let batch = |(k, scans): (usize, &[DriveScan])| Drive {
            wheels: Default::default(),
            trip: self.trip.clone(),
            initial_pose: start.start().filter(|_| k == 0),
            scans: scans.to_vec(),
        };
        scans.chunks(BATCH_SCANS).enumerate().map(batch).collect()
    }

    fn truth_at(&self, stamp: StampNs) -> Pose2 {
        let scans = self.drives[0].iter();
        let mut at = scans.filter(|scan| (scan.time_s * 1e9) as i64 == stamp.0);
        at.next().unwrap().map_from_base
    }
}

fn extended(drives: &[Drive]) -> RouteMap {
    let mut map = RouteMap::new(Weighting::Robust);
    for drive in drives {
        map.extend(drive).unwrap();
    }
    assert_sound(&map);
    map
}

/// How far the ends of a companion's beams are from the world, metres, in the order of size.
fn companions_off_m(map: &RouteMap, scene: &Scene) -> Vec<f64> {
    let world = scene.world(0).world;
    let mut off_m = Vec::new();
    for (keyframe, node) in map.keyframes().iter().zip(map.graph().nodes()) {
        assert_eq!(keyframe.lidar.as_ref().unwrap().as_str(), "front");
        for following in &keyframe.intermediate {
            let Some(scan) = following.companion_lidar().and(following.scan.as_ref()) else {
                continue;
            };
            let map_from_base = node.pose.compose(&following.keyframe_from_base);
            for point in surface_points(scan) {
                let at: Vector2<f64> = map_from_base.transform(&point.position);
                let away = world.shapes().map(|shape| shape.distance_to(&at));
                off_m.push(away.fold(f64::INFINITY, f64::min));
            }
        }
    }
    off_m.sort_by(f64::total_cmp);
    off_m
}

#[test]
fn what_companions_see_lies_on_the_walls() {
    let scene = shop(21);
    let drive = two_lidars("t", &scene, 0..2, 21);
    // At the same moments, and in turn, a quarter of a second apart.
    for (name, in_turn) in [("together", false), ("in turn", true)] {
        let scans = drive.scans(|place, k| !in_turn || k % 2 == place);
        let map = extended(&drive.batches(&scans));
        let off_m = companions_off_m(&map, &scene);
        assert!(off_m.len() > 10_000, "{}", off_m.len());
        let at = |share: f64| off_m[(share * off_m.len() as f64) as usize];
        let said = format!("{name}: {:.3} {:.3} m", at(0.5), at(0.95));
        assert!(at(0.5) < 0.02 && at(0.95) < 0.06, "{said}");
        let lends = map.keyframes().iter().map(|keyframe| {
            let lent = keyframe.intermediate.iter().filter(|s| s.lent().is_some());
            let own = surface_points(keyframe.scan.as_ref().unwrap()).len();
            assert_eq!(keyframe.points.len() > own, lent.clone().count() > 0);
            lent.count()
        });
        let (most, least) = lends.fold((0, 9), |(most, least), n| (n.max(most), n.min(least)));
        assert_eq!(
            (most, least),
            if in_turn { (0, 0) } else { (1, 1) },
            "{name}"
        );
        let poses = map.keyframes().iter().zip(map.graph().nodes());
        let errors: Vec<f64> = poses
            .map(|(keyframe, node)| apart(&drive.truth_at(keyframe.stamp), &node.pose).0)
            .collect();
        assert!(largest(&errors) < 0.05, "{name}: {}", largest(&errors));
    }
}

#[test]
fn a_map_of_two_lidars_is_restored_to_the_bit() {
    let drive = two_lidars("t", &shop(22), 0..2, 22);
    let scans = drive.scans(|_, _| true);
    let mut kept = RouteMap::new(Weighting::Robust);
    let mut restored = RouteMap::new(Weighting::Robust);
    let mut companions = 0;
    for batch in drive.batches(&scans) {
        let added = kept.extend(&batch).unwrap();
        restored = put_away(&restored, Weighting::Robust);
        assert_eq!(restored.extend(&batch).unwrap(), added);
        assert_equal(&kept, &restored);
        companions += added.intermediate.len();
    }
    assert!(companions > 80, "{companions}");
}

#[test]
fn one_that_falls_silent_leaves_its_place_to_the_other() {
    let drive = two_lidars("t", &shop(23), 0..1, 23);
    let half = drive.drives[0].len() / 2;
    let scans = drive.scans(|place, k| place == 1 || k < half);
    let map = extended(&drive.batches(&scans));
    let lidar = |k: usize| map.keyframes()[k].lidar.clone().unwrap();
    let nodes = map.keyframes().len();
    assert_eq!(lidar(0).as_str(), "front");
    assert_eq!(lidar(nodes - 1).as_str(), "rear");
    let poses = map.keyframes().iter().zip(map.graph().nodes());
    let errors = poses.map(|(keyframe, node)| apart(&drive.truth_at(keyframe.stamp), &node.pose).0);
    let errors: Vec<f64> = errors.collect();
    assert!(largest(&errors) < 0.15, "{}", largest(&errors));
}

fn findings(map: &mut RouteMap) -> Vec<Finding> {
    map.findings(&Scope {
        sites: Sites::All,
        pending: &[],
        false_alerts_per_lap: 1.0,
        accepted: &[],
        vehicles: &Default::default(),
        suspects: &[],
    })
}

/// A lidar that looks back over 180° sees the side of a thing that faces the way it came from only
/// once it has passed it. A thing is put where a vehicle without it never looks: beside the way, the
/// front lidar's fan being narrow.
#[test]
fn what_the_rear_lidar_alone_sees_is_found() {
    let mut scene = shop(24);
    let thing = Shape::rectangle(&Pose2::new(6.0, 3.7, 0.2), 0.5, 0.5);
    scene.objects.push(SceneObject {
        shape: thing.clone(),
        from_lap: 2,
        until_lap: None,
        heights_m: (0.0, f64::INFINITY),
    });
    let mut map_without = RouteMap::new(Weighting::Robust);
    let mut map_with = RouteMap::new(Weighting::Robust);
    for lap in 0..5 {
        let drive = two_lidars(&format!("lap-{lap}"), &scene, lap..lap + 1, 24);
        // What the front lidar has of the thing is taken out of its scans: its beams say nothing.
        let thing_at = scene.objects.len() - 1;
        let mut scans = drive.scans(|_, _| true);
        for (k, scan) in scans.iter_mut().enumerate().filter(|(k, _)| k % 2 == 0) {
            let struck = &drive.drives[0][k / 2].hit_objects;
            let ranges = scan.scan.ranges_m().enumerate().map(|(beam, range_m)| {
                let direction_rad = scan.scan.lidar().beam_angle_rad(beam);
                let sees = struck[beam] == Some(thing_at)
                    || looks_at(&drive, k / 2, direction_rad, &thing);
                if sees { Some(f64::NAN) } else { range_m }
            });
            let ranges: Vec<_> = ranges.collect();
            scan.scan = LaserScan::new(scan.scan.lidar().clone(), ranges).unwrap();
        }
        for batch in drive.batches(&scans) {
            map_with.extend(&batch).unwrap();
        }
        let front: Vec<DriveScan> = scans.iter().step_by(2).cloned().collect();
        for batch in drive.batches(&front) {
            map_without.extend(&batch).unwrap();
        }
    }
    let reports = |finding: &Finding| {
        finding.kind == ChangeKind::Appeared && thing.distance_to(&finding.location) < 0.35
    };
    let found = findings(&mut map_with);
    assert!(found.iter().any(reports), "{found:?}");
    assert!(!findings(&mut map_without).iter().any(reports));
}

/// Whether a beam of the front lidar goes through where the thing stands or will stand.
fn looks_at(drive: &TwoLidars, k: usize, direction_rad: f64, thing: &Shape) -> bool {
    let eye = drive.drives[0][k]
        .map_from_base
        .compose(&drive.lidars[0].geometry.mount);
    let (middle, radius_m) = thing.bounding_circle();
    let to_thing = eye.inverse().transform(&middle);
    let (sin, cos) = direction_rad.sin_cos();
    let along_m = to_thing.dot(&Vector2::new(cos, sin));
    let beside_m = (to_thing.norm_squared() - along_m * along_m)
        .max(0.0)
        .sqrt();
    along_m > 0.0 && beside_m < radius_m + 0.2
}
