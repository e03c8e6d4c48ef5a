use proptest::prelude::*;

use super::*;
use crate::scan::Reading;

/// A box: its corners, metres, from the point on the floor below the lidar.
type Block = [[f64; 2]; 3];

/// Elevations of evenly spread rings, degrees to radians.
fn rings(count: u32, lowest_deg: f64, step_deg: f64) -> Vec<f64> {
    let ring = |k: u32| (lowest_deg + step_deg * f64::from(k)).to_radians();
    (0..count).map(ring).collect()
}

fn lidar(height_m: f64, elevations_rad: Vec<f64>) -> CloudLidar {
    CloudLidar {
        mount: Pose2::new(0.3, -0.1, 0.4),
        height_m,
        elevations_rad,
        beams: 48,
        range_min_m: 0.05,
        range_max_m: 15.0,
        range_sigma_m: 0.01,
    }
}

fn band(from_m: f64, to_m: f64) -> HeightBand {
    HeightBand::new(from_m, to_m).unwrap()
}

/// How far a ray runs along the floor until it meets a block or the floor; `None` if neither.
fn run_m(blocks: &[Block], height_m: f64, direction_rad: f64, slope: f64) -> Option<f64> {
    let (sin, cos) = direction_rad.sin_cos();
    let steps = [cos, sin, slope];
    let eye = [0.0, 0.0, height_m];
    let into = |block: &Block| {
        let (mut from_m, mut to_m) = (0.0_f64, f64::INFINITY);
        for axis in 0..3 {
            let [low, high] = block[axis];
            let [a, b] = [low, high].map(|side| (side - eye[axis]) / steps[axis]);
            from_m = from_m.max(a.min(b));
            to_m = to_m.min(a.max(b));
        }
        (from_m < to_m).then_some(from_m)
    };
    let floor_m = (slope < 0.0).then(|| -height_m / slope);
    let met = blocks.iter().filter_map(into).chain(floor_m);
    met.min_by(f64::total_cmp)
}

/// The returns of all rings, each with `per_beam` rays in every beam, spread over its middle.
fn cloud(lidar: &CloudLidar, blocks: &[Block], per_beam: usize) -> Vec<[f64; 3]> {
    let mut points = Vec::new();
    for beam in 0..lidar.beams {
        for ray in 0..per_beam {
            let direction_rad = direction_of(lidar, beam, ray, per_beam);
            for elevation_rad in &lidar.elevations_rad {
                let slope = elevation_rad.tan();
                let ran_m = run_m(blocks, lidar.height_m, direction_rad, slope);
                let in_range = |m: &f64| m.hypot(m * slope) < lidar.range_max_m;
                points.extend(ran_m.filter(in_range).map(|ran_m| {
                    let (sin, cos) = direction_rad.sin_cos();
                    [ran_m * cos, ran_m * sin, ran_m * slope]
                }));
            }
        }
    }
    points
}

fn direction_of(lidar: &CloudLidar, beam: usize, ray: usize, per_beam: usize) -> f64 {
    let share = (ray as f64 + 0.5) / per_beam as f64 - 0.5;
    TAU * ((beam as f64 + 0.9 * share) / lidar.beams as f64 - 0.5)
}

/// Whether a block takes up the whole width of a beam at a distance along the floor.
fn spans(block: &Block, lidar: &CloudLidar, beam: usize, at_m: f64) -> bool {
    (0..=8).all(|k| {
        let share = f64::from(k) / 8.0 - 0.5;
        let direction_rad = TAU * ((beam as f64 + share) / lidar.beams as f64 - 0.5);
        let (sin, cos) = direction_rad.sin_cos();
        let holds = |axis: usize, v: f64| block[axis][0] <= v && v <= block[axis][1];
        holds(0, at_m * cos) && holds(1, at_m * sin)
    })
}

fn height_within(block: &Block, band: &HeightBand) -> f64 {
    block[2][1].min(band.to_m) - block[2][0].max(band.from_m)
}

/// Whether something of a band is met at a distance by a ray of a beam.
fn is_met(blocks: &[Block], band: &HeightBand, direction_rad: f64, at_m: f64) -> bool {
    let (sin, cos) = direction_rad.sin_cos();
    blocks.iter().any(|block| {
        let near = |axis: usize, v: f64| block[axis][0] - 2e-3 <= v && v <= block[axis][1] + 2e-3;
        near(0, at_m * cos) && near(1, at_m * sin) && height_within(block, band) >= 0.0
    })
}

/// Claims of a scan that the world contradicts, and how many were looked at: hits and distances.
fn lies(
    lidar: &CloudLidar,
    scanner: &BandScanner,
    least_height_m: f64,
    blocks: &[Block],
    per_beam: usize,
) -> (Vec<String>, usize, usize) {
    let scan = scanner.scan(cloud(lidar, blocks, per_beam)).unwrap();
    let view = scanner.lidar().band.unwrap();
    let (mut lies, mut hits, mut distances) = (Vec::new(), 0, 0);
    for beam in 0..lidar.beams {
        let free_to_m = match scan.reading(beam) {
            Reading::Invalid => continue,
            Reading::NoReturn => view.clear_to_m,
            Reading::Range(range_m) => {
                hits += 1;
                let mut rays = (0..per_beam).map(|ray| direction_of(lidar, beam, ray, per_beam));
                if !rays.any(|ray| is_met(blocks, &view.band, ray, range_m)) {
                    lies.push(format!("beam {beam}: nothing at {range_m}"));
                }
                range_m.min(view.clear_to_m)
            }
        };
        let mut at_m = view.clear_from_m + 1e-3;
        while at_m < free_to_m - 1e-3 {
            distances += 1;
            let stands = |block: &&Block| {
                height_within(block, &view.band) > least_height_m + 1e-6
                    && spans(block, lidar, beam, at_m)
            };
            if let Some(block) = blocks.iter().find(stands) {
                lies.push(format!(
                    "beam {beam}: {block:?} at {at_m}, free to {free_to_m}"
                ));
            }
            at_m += 0.023;
        }
    }
    (lies, hits, distances)
}

fn block() -> impl Strategy<Value = Block> {
    let place = (-6.0..6.0_f64, -6.0..6.0_f64);
    let size = (0.02..3.0_f64, 0.02..3.0_f64);
    let heights = prop_oneof![
        (Just(0.0), 0.02..2.5_f64),
        (0.0..1.2_f64, 0.01..0.1_f64),
        (0.0..1.2_f64, 0.1..1.0_f64),
    ];
    (place, size, heights)
        .prop_map(|((x, y), (dx, dy), (z, dz))| [[x, x + dx], [y, y + dy], [z, z + dz]])
}

fn blocks() -> impl Strategy<Value = Vec<Block>> {
    let is_clear = |block: &Block| {
        let near = |axis: usize| block[axis][0] <= 0.1 && block[axis][1] >= -0.1;
        !(near(0) && near(1))
    };
    let some = prop::collection::vec(block(), 0..14);
    some.prop_map(move |some| some.into_iter().filter(is_clear).collect())
}

fn any_rings() -> impl Strategy<Value = Vec<f64>> {
    prop_oneof![
        (8..40_u32, -30.0..0.0_f64, 0.3..2.5_f64)
            .prop_map(|(count, lowest, step)| rings(count, lowest, step)),
        prop::collection::vec(-0.5..0.4_f64, 4..40),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(192))]

    /// The law: whatever stands around, and whatever the rings, no claim is false.
    #[test]
    fn every_claim_is_true_of_the_world(
        blocks in blocks(), elevations_rad in any_rings(), height_m in 0.1..2.2_f64,
        from_m in 0.02..1.0_f64, band_m in 0.1..0.9_f64, share in 0.1..0.9_f64, per_beam in 1..4_usize,
    ) {
        let lidar = lidar(height_m, elevations_rad);
        let least_height_m = share * band_m;
        if let Ok(scanner) = BandScanner::new(&lidar, band(from_m, from_m + band_m), least_height_m) {
            let (lies, ..) = lies(&lidar, &scanner, least_height_m, &blocks, per_beam);
            prop_assert!(lies.is_empty(), "{lies:?}");
        }
    }

    /// What is left out of a cloud never adds a claim of free space.
    #[test]
    fn fewer_returns_prove_less(blocks in blocks(), kept in prop::collection::vec(any::<bool>(), 64)) {
        let lidar = lidar(0.8, rings(32, -16.0, 1.0));
        let scanner = BandScanner::new(&lidar, band(0.6, 1.0), 0.1).unwrap();
        let all = cloud(&lidar, &blocks, 1);
        let some = all.iter().zip(kept.iter().cycle()).filter(|(_, kept)| **kept);
        let some: Vec<_> = some.map(|(point, _)| *point).collect();
        let (all, some) = (scanner.scan(all).unwrap(), scanner.scan(some).unwrap());
        for beam in 0..lidar.beams {
            let free_to_m = |scan: &LaserScan| match scan.reading(beam) {
                Reading::Range(range_m) => range_m,
                Reading::NoReturn => f64::INFINITY,
                Reading::Invalid => 0.0,
            };
            let (before_m, after_m) = (free_to_m(&all), free_to_m(&some));
            // A nearer hit that is left out must take the claim with it, unless others pass.
            let is_hit = matches!(all.reading(beam), Reading::Range(_));
            prop_assert!(after_m <= before_m || is_hit, "beam {beam}: {before_m} {after_m}");
        }
    }
}

/// The law would hold of a function that says nothing: this one says much.
#[test]
fn much_is_claimed_in_a_furnished_room() {
    let room: [Block; 4] = [
        [[-5.0, 6.0], [4.0, 4.2], [0.0, 2.5]],
        [[-5.0, 6.0], [-4.2, -4.0], [0.0, 2.5]],
        [[6.0, 6.2], [-4.2, 4.2], [0.0, 2.5]],
        [[-5.2, -5.0], [-4.2, 4.2], [0.0, 2.5]],
    ];
    let table: Block = [[1.5, 2.7], [-0.4, 0.4], [0.72, 0.75]];
    let blocks = [room.as_slice(), &[table]].concat();
    let lidar = lidar(0.8, rings(32, -16.0, 1.0));
    for (band, least_height_m) in [(band(0.1, 0.4), 0.15), (band(0.6, 1.0), 0.05)] {
        let scanner = BandScanner::new(&lidar, band, least_height_m).unwrap();
        let (lies, hits, distances) = lies(&lidar, &scanner, least_height_m, &blocks, 1);
        assert!(lies.is_empty(), "{lies:?}");
        assert!(
            hits > 40 && distances > 1_500,
            "{band:?}: {hits} {distances}"
        );
        // The beam that looks ahead: over the table in one band, under it in the other.
        let scan = scanner.scan(cloud(&lidar, &blocks, 1)).unwrap();
        let ahead_m = scan.range_m(24).unwrap();
        let expected = if band.from_m > 0.5 {
            1.5..2.0
        } else {
            5.9..6.1
        };
        assert!(expected.contains(&ahead_m), "{band:?}: {ahead_m}");
    }
}

#[test]
fn where_a_band_is_seen_follows_from_the_rings() {
    let view = |height_m, band, least_height_m| {
        let lidar = lidar(height_m, rings(32, -16.0, 1.0));
        let scanner = BandScanner::new(&lidar, band, least_height_m).unwrap();
        scanner.lidar().band.unwrap()
    };
    // From above: where the lowest ring comes down to near the band's lower end.
    let from_above = view(1.8, band(0.1, 0.4), 0.15);
    let lowest_m = (1.8 - 0.4) / 16.0_f64.to_radians().tan();
    assert!(from_above.clear_from_m > lowest_m, "{from_above:?}");
    assert!(from_above.clear_from_m < lowest_m + 1.0);
    // From within: nearly from the lidar on, and as far as a gap of one degree is low enough.
    let from_within = view(0.25, band(0.1, 0.4), 0.15);
    assert!(from_within.clear_from_m < 0.3, "{from_within:?}");
    let far_m = COVERAGE_MARGIN * 0.15 / 1.0_f64.to_radians().tan();
    assert!((from_within.clear_to_m - far_m).abs() < 0.3, "{far_m}");
    // Thinner objects are not reported so far away.
    let thinner = view(0.25, band(0.1, 0.4), 0.05);
    assert!(thinner.clear_to_m < 0.4 * from_within.clear_to_m);
    // Never, with rings that look up.
    let upwards = lidar(1.8, rings(16, 1.0, 1.0));
    let refused = BandScanner::new(&upwards, band(0.1, 0.4), 0.1).unwrap_err();
    assert!(matches!(refused, CloudError::NeverSeen { .. }), "{refused}");
}

#[test]
fn a_ray_that_a_low_thing_stops_proves_nothing_above_it() {
    // A step that hides the floor behind it, and nothing else: the low rays never come down to the
    // band behind it, and those above have no return.
    let lidar = lidar(0.8, rings(32, -16.0, 1.0));
    let scanner = BandScanner::new(&lidar, band(0.1, 0.4), 0.1).unwrap();
    let step: Block = [[1.2, 1.25], [-3.0, 3.0], [0.0, 0.45]];
    let ahead = 24;
    let open = scanner.scan(cloud(&lidar, &[], 1)).unwrap();
    assert_eq!(open.reading(ahead), Reading::NoReturn);
    let hidden = scanner.scan(cloud(&lidar, &[step], 1)).unwrap();
    let reading = hidden.reading(ahead);
    assert_ne!(reading, Reading::NoReturn, "nobody looked there");
}

#[test]
fn points_that_are_no_directions_say_nothing() {
    let lidar = lidar(0.8, rings(32, -16.0, 1.0));
    let scanner = BandScanner::new(&lidar, band(0.6, 1.0), 0.1).unwrap();
    let odd = [
        [f64::NAN, 1.0, 0.0],
        [0.0, 0.0, 0.0],
        [0.0, 0.0, -0.8],
        [1.0, f64::INFINITY, 0.0],
        [1e300, 1e300, 1e300],
    ];
    let scan = scanner.scan(odd).unwrap();
    assert!((0..lidar.beams).all(|beam| scan.reading(beam) == Reading::Invalid));
}

#[test]
fn points_of_the_base_are_turned_to_the_lidar() {
    let lidar = lidar(0.8, rings(16, -15.0, 2.0));
    let [x, y, z] = [2.0, 1.0, 0.7];
    let ahead = lidar.mount.transform(&Vector2::new(x, y));
    let back = lidar.from_base([ahead.x, ahead.y, z + 0.8]);
    for (is, expected) in back.into_iter().zip([x, y, z]) {
        assert!((is - expected).abs() < 1e-12, "{back:?}");
    }
}

#[test]
fn absurd_lidars_are_refused() {
    let good = lidar(0.8, rings(32, -16.0, 1.0));
    let of = |spoil: &dyn Fn(&mut CloudLidar)| {
        let mut lidar = good.clone();
        spoil(&mut lidar);
        BandScanner::new(&lidar, band(0.6, 1.0), 0.1)
    };
    assert!(of(&|_| {}).is_ok());
    assert!(matches!(
        of(&|l| l.height_m = f64::NAN),
        Err(CloudError::Height(_))
    ));
    assert!(matches!(
        of(&|l| l.elevations_rad[3] = -15.0),
        Err(CloudError::Elevation(_))
    ));
    assert!(matches!(of(&|l| l.beams = 7), Err(CloudError::Beams(7))));
    assert!(matches!(
        of(&|l| l.range_min_m = 0.0),
        Err(CloudError::RangeMin(_))
    ));
    assert!(matches!(
        of(&|l| l.range_max_m = 0.0),
        Err(CloudError::NeverSeen { .. })
    ));
    assert!(matches!(
        of(&|l| l.range_sigma_m = 0.0),
        Err(CloudError::Lidar(_))
    ));
    for least_height_m in [0.0, -0.1, 0.4, f64::NAN] {
        let refused = BandScanner::new(&good, band(0.6, 1.0), least_height_m);
        assert!(matches!(refused, Err(CloudError::LeastHeight { .. })));
    }
}
