//! Laws that hold in every world.

use super::*;
use crate::geometry::{Pose2, Vector2};

pub(super) fn worlds(seed: u64) -> [(&'static str, Scene); 4] {
    let hall = Scene::of_hall(&Hall::generate(seed).unwrap(), seed);
    [
        ("hall", hall),
        ("racks", Scene::racks(seed).unwrap()),
        ("rooms", Rooms::generate(seed).unwrap().scene),
        ("street", Scene::street(seed).unwrap()),
    ]
}

/// A vehicle with few beams: quick.
pub(super) fn vehicle(path_noise_m: f64) -> Vehicle {
    let mut vehicle = Vehicle::of_fleet(0, path_noise_m);
    vehicle.lidar = SimLidar::all_round(180, 20.0, 0.01, Pose2::new(0.2, 0.0, 0.0));
    vehicle.scan_spacing_m = 0.5;
    vehicle
}

#[test]
fn worlds_are_clear_to_drive_in() {
    for seed in 0..8 {
        for (name, scene) in worlds(seed) {
            let world = scene.world(0).world;
            let steps = (scene.route.length_m() * 10.0) as usize;
            for k in 0..steps {
                let here = scene.route.pose_at(0.1 * k as f64).translation();
                let nearest = world.shapes().map(|s| s.distance_to(&here));
                let nearest = nearest.fold(f64::INFINITY, f64::min);
                assert!(nearest > 1.4, "{name} {seed}: {nearest} m at {here:?}");
            }
        }
    }
}

#[test]
fn worlds_are_functions_of_their_seeds() {
    for ((name, a), (_, b)) in worlds(3).into_iter().zip(worlds(3)) {
        assert_eq!(a, b, "{name}");
    }
    for ((name, a), (_, b)) in worlds(3).into_iter().zip(worlds(4)) {
        assert_ne!(a.objects, b.objects, "{name}");
    }
}

#[test]
fn worlds_have_what_can_change() {
    for seed in 0..8 {
        for (name, scene) in worlds(seed) {
            let free = scene.objects.iter().filter(|o| o.stands_free()).count();
            assert!((12..=45).contains(&free), "{name} {seed}: {free}");
            let area = scene.mean_object_area_m2();
            assert!((0.3..8.0).contains(&area), "{name} {seed}: {area}");
        }
    }
}

#[test]
fn the_same_seed_is_the_same_drive() {
    for (name, mut scene) in worlds(2) {
        scene.walkers = 2;
        let once = scene.drive(&vehicle(0.5), 1..3, 7);
        assert_eq!(once, scene.drive(&vehicle(0.5), 1..3, 7), "{name}");
        assert_ne!(once, scene.drive(&vehicle(0.5), 1..3, 8), "{name}");
        assert!(once.iter().all(|s| (1..3).contains(&s.lap)));
    }
}

#[test]
fn later_laps_stray_and_are_those_of_a_longer_drive() {
    let [(_, scene), ..] = worlds(1);
    let late = scene.drive(&vehicle(0.5), 2..3, 7);
    let all = scene.drive(&vehicle(0.5), 0..3, 7);
    let way = scene.route.length_m() / late.len() as f64;
    let strays = |scans: &[SimScan]| {
        let off = scans.iter().enumerate().map(|(k, scan)| {
            let on_route = scene.route.pose_at(k as f64 * way).translation();
            (scan.map_from_base.translation() - on_route).norm()
        });
        off.fold(0.0, f64::max)
    };
    assert!(strays(&late) > 0.2 && strays(&late) <= 0.5);
    assert!(strays(&all[..late.len()]) < 1e-9);
    let poses = |scans: &[SimScan]| scans.iter().map(|s| s.map_from_base).collect::<Vec<_>>();
    assert_eq!(poses(&late), poses(&all[2 * late.len()..]));
    assert_eq!(late[0].odom_from_base, Pose2::IDENTITY);
    // Drives of one seed that begin with different laps do not share their noise.
    assert_ne!(late[0].ranges_m, all[0].ranges_m);
}

#[test]
fn what_is_hit_is_where_the_beam_ends() {
    for (name, mut scene) in worlds(5) {
        Changes::new(&mut scene, 1, 0.5, 5).add(4, 0.3);
        Changes::new(&mut scene, 1, 0.5, 6).remove(4);
        let vehicle = vehicle(0.5);
        for scan in scene.drive(&vehicle, 0..2, 5).iter().step_by(7) {
            let map_from_lidar = scan.map_from_base.compose(&vehicle.lidar.geometry.mount);
            for (k, (range, hit)) in scan.ranges_m.iter().zip(&scan.hit_objects).enumerate() {
                assert_eq!(range.is_some(), hit.is_some(), "{name}: nobody walks here");
                let (Some(range), Some(hit)) = (range, hit) else {
                    continue;
                };
                let (sin, cos) = vehicle.lidar.geometry.beam_angle_rad(k).sin_cos();
                let end = map_from_lidar.transform(&(Vector2::new(cos, sin) * *range));
                let object = &scene.objects[*hit];
                assert!(object.is_there(scan.lap), "{name}");
                assert!(object.shape.distance_to(&end) < 0.06, "{name}: beam {k}");
            }
        }
    }
}

#[test]
fn scans_of_a_lap_err_together_and_leave_odometry_as_it_was() {
    let [(_, scene), ..] = worlds(3);
    let plain = vehicle(0.3);
    let mut biased = plain.clone();
    biased.lidar.pass_errors.range_bias_sigma_m = 0.05;
    let (truth, seen) = (scene.drive(&plain, 0..3, 4), scene.drive(&biased, 0..3, 4));
    let mut of_laps = [Vec::new(), Vec::new(), Vec::new()];
    for (a, b) in truth.iter().zip(&seen) {
        assert_eq!(a.odom_from_base, b.odom_from_base);
        for (x, y) in a.ranges_m.iter().zip(&b.ranges_m) {
            of_laps[a.lap].extend(x.zip(*y).map(|(x, y)| y - x));
        }
    }
    let means = of_laps.map(|longer_m| {
        let mean = longer_m.iter().sum::<f64>() / longer_m.len() as f64;
        // To the millimetre of a range.
        assert!(longer_m.iter().all(|l| (l - mean).abs() < 2e-3));
        mean
    });
    assert!((means[0] - means[1]).abs() > 1e-3 && (means[1] - means[2]).abs() > 1e-3);
    let grazing = {
        let mut vehicle = plain.clone();
        vehicle.lidar.pass_errors.grazing_dropout_rate = 1.0;
        scene.drive(&vehicle, 0..1, 4)
    };
    let returns = |scans: &[SimScan]| scans.iter().flat_map(|s| &s.ranges_m).flatten().count();
    let (kept, all) = (returns(&grazing), returns(&truth[..grazing.len()]));
    assert!(kept < all, "grazing beams are lost: {kept} of {all} left");
}

#[test]
fn bystanders_stand_for_one_lap() {
    for (name, mut scene) in worlds(2) {
        let before = scene.objects.len();
        let standing = Changes::new(&mut scene, 1, 0.5, 9).bystanders(3);
        assert_eq!(standing, (before..before + 3).collect::<Vec<_>>(), "{name}");
        for lap in 0..3 {
            let there = |&&k: &&usize| scene.objects[k].is_there(lap);
            let expected = if lap == 1 { 3 } else { 0 };
            assert_eq!(standing.iter().filter(there).count(), expected, "{name}");
        }
    }
}

#[test]
fn doors_stand_ajar_for_one_lap_and_return() {
    let mut rooms = Rooms::generate(4).unwrap();
    let before = rooms.scene.world(0);
    let swung = rooms.swing_doors(3, 2, 1);
    let ajar = rooms.leave_ajar(1..3, 3, 0.1, 5);
    assert!(ajar.len() >= 6, "{} places", ajar.len());
    assert!(
        swung
            .iter()
            .all(|(was, is)| !ajar.contains(was) && !ajar.contains(is))
    );
    assert_eq!(rooms.scene.world(0), before);
    // No door is lost, and none is there twice.
    for lap in 0..4 {
        assert_eq!(
            rooms.scene.world(lap).objects.len(),
            before.objects.len(),
            "lap {lap}"
        );
    }
    let shapes = |lap| -> Vec<Shape> { rooms.scene.world(lap).world.shapes().cloned().collect() };
    let lost = shapes(0).iter().filter(|s| !shapes(3).contains(s)).count();
    assert_eq!(lost, 3, "only those that swing stand elsewhere at the end");
    assert!(shapes(0).iter().filter(|s| !shapes(1).contains(s)).count() >= 2);
}

#[test]
fn doors_swing_between_two_places() {
    let mut rooms = Rooms::generate(4).unwrap();
    let before = rooms.scene.clone();
    let swung = rooms.swing_doors(5, 3, 1);
    assert_eq!(swung.len(), 5);
    for &(was, is) in &swung {
        let (was, is) = (&rooms.scene.objects[was], &rooms.scene.objects[is]);
        assert_eq!((was.until_lap, is.from_lap), (Some(3), 3));
        assert!((was.shape.area_m2() - is.shape.area_m2()).abs() < 1e-9);
        // A quarter turn about a hinge half a leaf away.
        let apart = (was.shape.bounding_circle().0 - is.shape.bounding_circle().0).norm();
        assert!((apart - 0.5 * 2.0_f64.sqrt()).abs() < 1e-6, "{apart}");
    }
    let back = rooms.swing_doors(500, 5, 2);
    assert!(back.len() >= 20, "{} doors", back.len());
    for (was, is) in swung {
        let again = back.iter().find(|(now, _)| *now == is).unwrap().1;
        let shapes = [was, again].map(|k| &rooms.scene.objects[k].shape);
        assert_eq!(shapes[0], shapes[1]);
    }
    assert_eq!(before.world(2), rooms.scene.world(2));
}
