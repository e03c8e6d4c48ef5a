use std::f64::consts::{FRAC_PI_2, PI, TAU};
use std::sync::Arc;

use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::observation::testing::{World, all_round, lidar};
use crate::scan::{BandView, HeightBand};

const HALF_WIDTH_M: f64 = 0.03;

fn observe(world: &World, lidar: &Lidar, beams: usize, map_from_base: &Pose2) -> Observation {
    let scan = world.scan(&Arc::new(lidar.clone()), beams, map_from_base, || 0.0);
    Observation::new(&scan, map_from_base)
}

fn observe_ranges(lidar: &Lidar, ranges_m: impl Iterator<Item = f64>) -> Observation {
    let scan = LaserScan::new(Arc::new(lidar.clone()), ranges_m.map(Some)).unwrap();
    Observation::new(&scan, &Pose2::IDENTITY)
}

fn cell_at(x: f64, y: f64) -> Cell {
    Cell::of_grid(Vector2::new(x, y), 0.0)
}

fn polar(range_m: f64, bearing_rad: f64) -> Cell {
    cell_at(range_m * bearing_rad.cos(), range_m * bearing_rad.sin())
}

/// A wall 3 m ahead, and nothing else.
fn wall_ahead() -> World {
    World::default().with_side([3.0, -10.0], [3.0, 10.0])
}

fn with_face(cell: Cell, normal: [f64; 2], seen_from: [f64; 2]) -> Cell {
    Cell {
        normal: Some(normal.into()),
        seen_from: seen_from.into(),
        ..cell
    }
}

#[test]
fn a_wall_is_hit_the_space_before_it_missed_and_what_is_behind_it_unknown() {
    let seen = observe(&wall_ahead(), &all_round(720), 720, &Pose2::IDENTITY);
    for y in [-1.5, -0.4, 0.0, 0.7, 2.0] {
        assert_eq!(seen.test(&cell_at(3.0, y)), Outcome::Hit, "{y}");
        assert_eq!(seen.test(&cell_at(2.0, y)), Outcome::Miss, "{y}");
        assert_eq!(seen.test(&cell_at(4.0, y)), Outcome::Unknown, "{y}");
        assert_eq!(seen.test(&cell_at(-2.0, y)), Outcome::NoReturn, "{y}");
        // Between a hit and a miss nothing is said.
        assert_eq!(seen.test(&cell_at(2.89, 0.0)), Outcome::Unknown);
    }
}

#[test]
fn a_height_band_is_missed_only_where_the_lidar_sees_enough_of_it() {
    let band = HeightBand::new(0.6, 1.0).unwrap();
    let lidar = Lidar {
        band: Some(BandView {
            band,
            clear_from_m: 0.8,
            clear_to_m: 2.0,
        }),
        ..all_round(720)
    };
    let seen = observe(&wall_ahead(), &lidar, 720, &Pose2::IDENTITY);
    for (x, outcome) in [
        (0.6, Outcome::Unknown),
        (1.0, Outcome::Miss),
        (1.9, Outcome::Miss),
        (2.1, Outcome::Unknown),
        (3.0, Outcome::Hit),
        (-0.6, Outcome::Unknown),
        (-1.5, Outcome::NoReturn),
        (-2.5, Outcome::Unknown),
    ] {
        assert_eq!(seen.test(&cell_at(x, 0.0)), outcome, "{x}");
    }
}

#[test]
fn nothing_is_said_from_too_near_or_too_far() {
    let wall_at = |x: f64| World::default().with_side([x, -5.0], [x, 5.0]);
    let from_origin =
        |world: &World, beams: usize| observe(world, &all_round(beams), beams, &Pose2::IDENTITY);
    let far = wall_at(8.1);
    let seen = from_origin(&far, 360);
    assert_eq!(seen.test(&cell_at(8.1, 0.0)), Outcome::Unknown);
    assert_eq!(seen.test(&cell_at(7.0, 0.0)), Outcome::Miss);
    assert_eq!(seen.test(&cell_at(0.19, 0.0)), Outcome::Unknown);
    assert_eq!(seen.test(&cell_at(0.0, 0.0)), Outcome::Unknown);
    // Beams that are near to each other see farther, but not for ever.
    assert_eq!(
        from_origin(&far, 1_440).test(&cell_at(8.1, 0.0)),
        Outcome::Hit
    );
    let farther = from_origin(&wall_at(14.1), 1_440);
    assert_eq!(farther.test(&cell_at(14.1, 0.0)), Outcome::Unknown);
    let short_sighted = lidar(TAU, 720, 4.0, 0.01);
    let seen = observe(&far, &short_sighted, 720, &Pose2::IDENTITY);
    assert_eq!(seen.test(&cell_at(3.7, 0.0)), Outcome::NoReturn);
    assert_eq!(seen.test(&cell_at(3.9, 0.0)), Outcome::Unknown);
}

#[test]
fn an_invalid_reading_says_nothing_and_a_lost_one_no_return() {
    let lidar = lidar(PI, 180, 10.0, 0.01);
    let all = |range_m: f64| observe_ranges(&lidar, std::iter::repeat_n(range_m, 180));
    for (range_m, outcome) in [
        (0.01, Outcome::Unknown),
        (-1.0, Outcome::Unknown),
        (f64::NAN, Outcome::Unknown),
        (f64::NEG_INFINITY, Outcome::Unknown),
        (10.0, Outcome::NoReturn),
        (f64::INFINITY, Outcome::NoReturn),
    ] {
        assert_eq!(all(range_m).test(&cell_at(2.0, 0.3)), outcome, "{range_m}");
        assert_eq!(all(range_m).hits().count(), 0);
    }
    // One invalid reading among those towards a cell is enough to take a no-return away.
    let middle = |k: usize| if k == 90 { 0.01 } else { 10.0 };
    let seen = observe_ranges(&lidar, (0..180).map(middle));
    assert_eq!(seen.test(&cell_at(2.0, 0.0)), Outcome::Unknown);
    assert_eq!(
        seen.test(&cell_at(0.0, 2.0)),
        Outcome::Unknown,
        "the border"
    );
    assert_eq!(seen.test(&polar(2.0, 1.0)), Outcome::NoReturn);
}

#[test]
fn one_beam_makes_a_hit_and_all_must_go_by_for_a_miss() {
    let lidar = lidar(PI, 720, 10.0, 0.01);
    let one_at = |range_m: f64| {
        let seen = observe_ranges(
            &lidar,
            (0..720).map(|k| if k == 361 { range_m } else { 5.0 }),
        );
        seen.test(&cell_at(2.0, 0.0))
    };
    assert_eq!(one_at(2.0), Outcome::Hit);
    assert_eq!(one_at(5.0), Outcome::Miss);
    assert_eq!(one_at(1.0), Outcome::Unknown, "blocked");
    assert_eq!(one_at(10.0), Outcome::Miss, "most went by");
    let most_lost = observe_ranges(
        &lidar,
        (0..720).map(|k| if k % 3 == 0 { 5.0 } else { 10.0 }),
    );
    assert_eq!(most_lost.test(&cell_at(2.0, 0.0)), Outcome::Unknown);
}

#[test]
fn a_surface_at_a_grazing_angle_is_not_missed_but_may_be_hit() {
    let seen = observe(&wall_ahead(), &all_round(720), 720, &Pose2::IDENTITY);
    let facing = [-1.0, 0.0];
    let aside = [0.0, 1.0];
    let before = |normal| with_face(cell_at(2.0, 0.0), normal, [0.0, 0.0]);
    assert_eq!(seen.test(&before(facing)), Outcome::Miss);
    assert_eq!(seen.test(&before(aside)), Outcome::Unknown);
    assert_eq!(seen.test(&before([0.0, -1.0])), Outcome::Unknown);
    // cos 69° = 0.358, cos 70° = 0.342.
    for (slant_deg, outcome) in [(69.0_f64, Outcome::Miss), (70.0, Outcome::Unknown)] {
        let (sin, cos) = slant_deg.to_radians().sin_cos();
        assert_eq!(seen.test(&before([cos, sin])), outcome, "{slant_deg}");
    }
    let on = with_face(cell_at(3.0, 0.0), aside, [0.0, 0.0]);
    assert_eq!(seen.test(&on), Outcome::Hit);
}

#[test]
fn a_wall_met_from_behind_is_not_missed_by_beams_that_end_on_its_other_face() {
    let seen = observe(&wall_ahead(), &all_round(720), 720, &Pose2::IDENTITY);
    let face = |x: f64, seen_from: [f64; 2]| with_face(cell_at(x, 0.0), [1.0, 0.0], seen_from);
    let (this_side, other_side) = ([-1.0, 0.0], [1.0, 0.0]);
    assert_eq!(seen.test(&face(2.7, other_side)), Outcome::Unknown);
    assert_eq!(seen.test(&face(2.7, this_side)), Outcome::Miss);
    assert_eq!(seen.test(&face(2.7, [0.0, 0.0])), Outcome::Miss);
    assert_eq!(seen.test(&face(2.7, [0.1, 0.0])), Outcome::Miss);
    // No wall is so thick.
    assert_eq!(seen.test(&face(2.4, other_side)), Outcome::Miss);
}

#[test]
fn beams_of_a_full_turn_meet_across_the_seam() {
    let ring = World::default().with_rectangle([-2.0, -2.0], [2.0, 2.0]);
    for beams in [90, 361, 1_440] {
        for first_rad in [-TAU, -PI, -1.0, 0.0, 0.3, PI, 6.0, TAU] {
            let lidar = Lidar {
                angle_min_rad: first_rad,
                ..all_round(beams)
            };
            let seen = observe(&ring, &lidar, beams, &Pose2::IDENTITY);
            for k in -3..=3 {
                let bearing_rad = first_rad + 0.3 * lidar.angle_increment_rad * f64::from(k);
                let wall_m = ring.range_m(&Vector2::zeros(), bearing_rad).unwrap();
                let outcome = |range_m| seen.test(&polar(range_m, bearing_rad));
                let what = format!("{beams} beams from {first_rad}, {k}");
                assert_eq!(outcome(wall_m), Outcome::Hit, "{what}");
                assert_eq!(outcome(0.5 * wall_m), Outcome::Miss, "{what}");
                assert_eq!(outcome(1.5 * wall_m), Outcome::Unknown, "{what}");
            }
        }
    }
}

#[test]
fn a_mount_carries_the_eye_and_the_field_of_view() {
    // Looks to the left, from half a metre ahead of the base.
    let lidar = Lidar {
        mount: Pose2::new(0.5, 0.0, FRAC_PI_2),
        ..lidar(FRAC_PI_2, 180, 20.0, 0.01)
    };
    let world = World::default().with_rectangle([-3.0, -3.0], [3.0, 3.0]);
    let seen = observe(&world, &lidar, 180, &Pose2::new(1.0, 0.0, PI));
    assert!((seen.eye() - Vector2::new(0.5, 0.0)).norm() < 1e-12);
    assert_eq!(seen.test(&cell_at(0.5, -3.0)), Outcome::Hit);
    assert_eq!(seen.test(&cell_at(0.5, -1.0)), Outcome::Miss);
    assert_eq!(seen.test(&cell_at(0.5, 3.0)), Outcome::Unknown);
    assert_eq!(seen.test(&cell_at(3.0, 0.0)), Outcome::Unknown);
}

#[test]
fn noise_of_the_stated_size_leaves_a_wall_hit_and_the_space_before_it_missed() {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    for sigma_m in [0.01, 0.02, 0.03, 0.04, 0.047, 0.05] {
        for range_m in [1.0, 3.0, 7.5] {
            let world = World::default().with_side([range_m, -9.0], [range_m, 9.0]);
            let lidar = Arc::new(lidar(PI, 181, 20.0, sigma_m));
            let mut error_m = || {
                let (u, v) = (1.0 - rng.random::<f64>(), rng.random::<f64>());
                sigma_m * (-2.0 * u.ln()).sqrt() * (TAU * v).cos()
            };
            let (mut hits, mut misses) = (0, 0);
            for _ in 0..100 {
                let scan = world.scan(&lidar, 181, &Pose2::IDENTITY, &mut error_m);
                let seen = Observation::new(&scan, &Pose2::IDENTITY);
                hits += u32::from(seen.test(&cell_at(range_m, 0.1)) == Outcome::Hit);
                misses += u32::from(seen.test(&cell_at(0.4 * range_m, 0.1)) == Outcome::Miss);
            }
            assert!(hits >= 95, "{hits} hits at {range_m} m, σ = {sigma_m}");
            assert!(
                misses >= 95,
                "{misses} misses at {range_m} m, σ = {sigma_m}"
            );
        }
    }
}

#[test]
fn reach_does_not_shrink_with_noise() {
    for (beams, reach_m) in [(9, 8.0), (4_000, 14.0)] {
        for sigma_m in [0.001, 0.01, 0.047, 0.2, 1.0] {
            let lidar = lidar(PI, beams, 20.0, sigma_m);
            let seen = observe(&wall_ahead(), &lidar, beams, &Pose2::IDENTITY);
            assert_eq!(seen.reach_m(), reach_m, "{beams} beams, σ = {sigma_m}");
        }
    }
}

#[test]
fn absurd_geometry_neither_panics_nor_hangs() {
    for increment_rad in [1e-4, TAU / 8_192.0] {
        for angle_min_rad in [-TAU, 0.0, TAU] {
            let lidar = Lidar {
                angle_min_rad,
                angle_increment_rad: increment_rad,
                ..all_round(8_192)
            };
            let seen = observe(
                &wall_ahead(),
                &lidar.validated().unwrap(),
                8_192,
                &Pose2::IDENTITY,
            );
            assert_eq!(seen.test(&cell_at(3.0, 1e-14)), Outcome::Hit);
            let near = |x: f64| seen.hits_near(&Vector2::new(x, 0.0), 0.1).count();
            assert!(near(3.0) > 0, "{increment_rad} {angle_min_rad}");
            assert_eq!(near(-3.0), 0);
        }
    }
    let one_beam = observe_ranges(&lidar(0.7, 1, 20.0, 0.01), std::iter::once(2.0));
    assert_eq!(one_beam.test(&polar(2.0, -0.35)), Outcome::Hit);
    assert_eq!(one_beam.test(&polar(2.0, 2.0)), Outcome::Unknown);
}

#[derive(Debug, Clone)]
struct Setting {
    lidar: Lidar,
    beams: usize,
    map_from_base: Pose2,
    world: World,
}

/// A room of 8 m with a box in it, and a lidar somewhere in the room; some rooms are open to one
/// side.
fn any_setting() -> impl Strategy<Value = Setting> {
    let pose = |reach: f64| {
        (-reach..reach, -reach..reach, -PI..PI).prop_map(|(x, y, theta)| Pose2::new(x, y, theta))
    };
    (
        (0.5..TAU, 100..720_usize, -TAU..TAU, 0.01..0.05_f64),
        pose(0.3),
        pose(3.0),
        (-3.0..3.0_f64, -3.0..3.0_f64),
        proptest::bool::ANY,
    )
        .prop_map(
            |((field_rad, beams, first_rad, sigma_m), mount, base, (x, y), is_open)| {
                let geometry = Lidar {
                    angle_min_rad: first_rad,
                    mount,
                    ..lidar(field_rad, beams, 20.0, sigma_m)
                };
                let world = if is_open {
                    World::default().with_side([4.0, -4.0], [4.0, 4.0])
                } else {
                    World::default().with_rectangle([-4.0, -4.0], [4.0, 4.0])
                };
                Setting {
                    lidar: geometry,
                    beams,
                    map_from_base: base,
                    world: world.with_rectangle([x - 0.3, y - 0.2], [x + 0.3, y + 0.2]),
                }
            },
        )
}

/// What must be said of a place, by casting many rays towards it; `None` where both sides of a
/// border are near and the tolerances decide.
fn oracle(setting: &Setting, place: &Vector2<f64>) -> Option<Outcome> {
    let map_from_lidar = setting.map_from_base.compose(&setting.lidar.mount);
    let eye = map_from_lidar.translation();
    let towards = place - eye;
    let range_m = towards.norm();
    let margin_m = 0.01;
    let increment_rad = setting.lidar.angle_increment_rad;
    let reach_m = (0.07 / increment_rad).clamp(8.0, 14.0);
    if range_m < 0.2 - margin_m || range_m > reach_m + margin_m {
        return Some(Outcome::Unknown);
    }
    if range_m < 0.2 + margin_m || range_m > reach_m - margin_m {
        return None;
    }
    let bearing_rad = towards.y.atan2(towards.x);
    let beside_rad = (0.008 + (0.025 + 0.5 * HALF_WIDTH_M) / range_m).max(increment_rad);
    let window_rad = beside_rad + increment_rad;
    // How far the place's direction is past the first beam.
    let first_rad = map_from_lidar.theta + setting.lidar.angle_min_rad;
    let past_rad = (bearing_rad - first_rad).rem_euclid(TAU);
    let field_rad = (setting.beams - 1) as f64 * increment_rad;
    let is_full_turn = field_rad + 1.5 * increment_rad > TAU;
    if past_rad > field_rad + window_rad && past_rad < TAU - window_rad {
        return Some(Outcome::Unknown);
    }
    let is_within = past_rad > window_rad && past_rad < field_rad - window_rad;
    if !is_within && !is_full_turn {
        return None;
    }
    let rays = -100..=100;
    let met: Vec<Option<f64>> = rays
        .map(|k| bearing_rad + window_rad * f64::from(k) / 100.0)
        .map(|direction_rad| setting.world.range_m(&eye, direction_rad))
        .collect();
    if met.iter().all(Option::is_none) {
        return Some(Outcome::NoReturn);
    }
    let depths: Vec<f64> = met
        .iter()
        .map(|met| Some((*met)? - range_m))
        .collect::<Option<_>>()?;
    let sigma_m = setting.lidar.range_sigma_m;
    let hit_m = 0.07 + 2.0 * sigma_m + 0.006 * range_m + HALF_WIDTH_M;
    let miss_m = 0.10 + 3.0 * sigma_m + 0.012 * range_m + HALF_WIDTH_M;
    let all = |is: &dyn Fn(f64) -> bool| depths.iter().all(|&depth| is(depth));
    if all(&|depth| depth.abs() < hit_m - margin_m) {
        Some(Outcome::Hit)
    } else if all(&|depth| depth > miss_m + margin_m) {
        Some(Outcome::Miss)
    } else if all(&|depth| depth < -hit_m - margin_m) {
        Some(Outcome::Unknown)
    } else {
        None
    }
}

proptest! {
    #[test]
    fn what_is_said_is_what_rays_through_the_world_say(
        setting in any_setting(),
        places in proptest::collection::vec((-6.0..6.0_f64, -6.0..6.0_f64), 8),
        directions in proptest::collection::vec((-PI..PI, 0.3..1.6_f64), 8),
    ) {
        let seen = observe(&setting.world, &setting.lidar, setting.beams, &setting.map_from_base);
        let eye = seen.eye();
        // Places anywhere, and places on, before and behind what is met.
        let met = directions.iter().flat_map(|&(direction_rad, share)| {
            let range_m = setting.world.range_m(&eye, direction_rad);
            let direction = Vector2::new(direction_rad.cos(), direction_rad.sin());
            let places = [1.0, share].map(|share| Some(eye + range_m? * share * direction));
            places.into_iter().flatten()
        });
        for place in places.iter().map(|&(x, y)| Vector2::new(x, y)).chain(met) {
            if let Some(expected) = oracle(&setting, &place) {
                let outcome = seen.test(&Cell::of_grid(place, HALF_WIDTH_M));
                prop_assert_eq!(outcome, expected, "{}", place);
            }
        }
    }

    #[test]
    fn hits_near_a_place_are_all_hits_that_are_near(
        setting in any_setting(),
        place in (-6.0..6.0_f64, -6.0..6.0_f64),
        within_m in 0.05..5.0_f64,
    ) {
        let seen = observe(&setting.world, &setting.lidar, setting.beams, &setting.map_from_base);
        let place = Vector2::new(place.0, place.1);
        let is_near = |hit: &Vector2<f64>| (hit - place).norm() <= within_m;
        let sorted = |mut hits: Vec<Vector2<f64>>| {
            hits.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
            hits
        };
        let near = sorted(seen.hits_near(&place, within_m).collect());
        let expected = sorted(seen.hits().filter(is_near).collect());
        prop_assert_eq!(near.len(), expected.len());
        for (hit, expected) in near.iter().zip(&expected) {
            prop_assert!((hit - expected).norm() < 1e-9);
        }
    }

    #[test]
    fn where_the_map_lies_does_not_matter(
        setting in any_setting(),
        place in (-6.0..6.0_f64, -6.0..6.0_f64),
        moved in (-500.0..500.0_f64, -500.0..500.0_f64, -PI..PI),
    ) {
        let moved = Pose2::new(moved.0, moved.1, moved.2);
        let seen = observe(&setting.world, &setting.lidar, setting.beams, &setting.map_from_base);
        let elsewhere = Observation::new(seen.scan(), &moved.compose(&setting.map_from_base));
        let place = Vector2::new(place.0, place.1);
        let there = moved.transform(&place);
        // On a border of the tolerances a hair decides; the oracle says where there is none.
        if oracle(&setting, &place).is_some() {
            let test = |seen: &Observation, place| seen.test(&Cell::of_grid(place, HALF_WIDTH_M));
            prop_assert_eq!(test(&seen, place), test(&elsewhere, there));
        }
    }
}
