use super::*;
use crate::sim::Hall;
use crate::sim::tests::worlds;

const CLASSES: [f64; 5] = [0.01, 0.03, 0.1, 0.3, 1.0];

fn changed(mut scene: Scene, path_noise_m: f64, seed: u64) -> Scene {
    let mut changes = Changes::new(&mut scene, 2, path_noise_m, seed);
    for area_share in CLASSES {
        changes.add(2, area_share);
    }
    changes.remove(3);
    changes.displace(2);
    scene
}

/// Points on the lines of a shape.
fn outline(shape: &Shape) -> Vec<Vector2<f64>> {
    match shape {
        Shape::Outline(corners) => (0..corners.len())
            .flat_map(|k| {
                let (a, b) = (corners[k], corners[(k + 1) % corners.len()]);
                (0..20).map(move |i| a + (b - a) * (f64::from(i) / 20.0))
            })
            .collect(),
        Shape::Round { centre, radius_m } => (0..60)
            .map(|k| {
                let (sin, cos) = (f64::from(k) * PI / 30.0).sin_cos();
                centre + Vector2::new(cos, sin) * *radius_m
            })
            .collect(),
    }
}

#[test]
fn changes_leave_room_to_pass_and_overlap_nothing() {
    for (name, original) in worlds(3) {
        for path_noise_m in [0.0, 0.5, 1.0] {
            let scene = changed(original.clone(), path_noise_m, 8);
            let came = original.objects.len()..scene.objects.len();
            assert!(came.len() >= 9, "{name}: {} came", came.len());
            for k in came {
                let object = &scene.objects[k];
                assert_eq!((object.from_lap, object.until_lap), (2, None));
                let points = outline(&object.shape);
                let steps = (scene.route.length_m() * 20.0) as usize;
                for step in 0..steps {
                    let here = scene.route.pose_at(step as f64 * 0.05).translation();
                    let gap = points.iter().map(|p| (p - here).norm());
                    let gap = gap.fold(f64::INFINITY, f64::min);
                    assert!(gap > path_noise_m + 0.45, "{name}: {gap} m left");
                }
                for other in (0..scene.objects.len()).filter(|&other| other != k) {
                    let other = &scene.objects[other].shape;
                    let gap = points.iter().map(|p| other.distance_to(p));
                    assert!(gap.fold(f64::INFINITY, f64::min) > 0.15, "{name}: overlaps");
                }
            }
        }
    }
}

#[test]
fn changes_are_what_was_asked_for() {
    let hall = Hall::generate(5).unwrap();
    let mut scene = Scene::of_hall(&hall, 5);
    let count = scene.objects.len();
    let mean: f64 = scene.objects[1..].iter().map(|o| o.shape.area_m2()).sum();
    let mean = mean / (count - 1) as f64;
    let mut changes = Changes::new(&mut scene, 4, 0.5, 1);
    let added = changes.add(3, 0.1);
    let removed = changes.remove(4);
    let moved = changes.displace(2);
    assert_eq!((added.len(), removed.len(), moved.len()), (3, 4, 2));
    for &k in &added {
        assert!((scene.objects[k].shape.area_m2() / mean - 0.1).abs() < 1e-9);
    }
    for &k in removed.iter().chain(moved.iter().map(|(was, _)| was)) {
        assert!((1..count).contains(&k), "walls stay, what comes stays");
        assert_eq!(scene.objects[k].until_lap, Some(4));
    }
    for &(was, is) in &moved {
        let area = |k: usize| scene.objects[k].shape.area_m2();
        assert!((area(was) - area(is)).abs() < 1e-9);
        assert_eq!(scene.objects[is].from_lap, 4);
    }
    let gone = scene.objects.iter().filter(|o| o.until_lap.is_some());
    assert_eq!(gone.count(), 6);
    assert_eq!(scene.objects.len(), count + 5);
}

#[test]
fn nothing_is_taken_away_twice_or_beyond_what_there_is() {
    let hall = Hall::generate(6).unwrap();
    let mut scene = Scene::of_hall(&hall, 6);
    let standing = scene.objects.iter().filter(|o| o.stands_free()).count();
    let mut changes = Changes::new(&mut scene, 1, 0.5, 1);
    assert_eq!(changes.remove(500).len(), standing);
    assert!(changes.remove(1).is_empty());
    assert!(changes.displace(1).is_empty());
    assert!(Changes::new(&mut scene, 0, 0.5, 1).remove(1).is_empty());
}

#[test]
fn changes_are_a_function_of_their_seed() {
    let scene = || Scene::of_hall(&Hall::generate(7).unwrap(), 7);
    assert_eq!(changed(scene(), 0.5, 1), changed(scene(), 0.5, 1));
    assert_ne!(changed(scene(), 0.5, 1), changed(scene(), 0.5, 2));
}
