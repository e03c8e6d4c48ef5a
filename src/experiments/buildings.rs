//! Maps of floors with long corridors: whether their loops close, and rightly.
//!
//! A vehicle with poor odometry and few scans drives twice round a corridor. That is what large
//! buildings are like on public recordings: loops of hundreds of metres, a metre from scan to scan.

use std::collections::BTreeMap;
use std::f64::consts::PI;
use std::sync::Arc;

use rayon::iter::{IntoParallelIterator, ParallelIterator};
use serde::Serialize;

use super::recording::Recording;
use super::route::{MapRun, MeasuredClosure};
use super::stability::{distances_m, with_noise};
use super::table::Table;
use crate::geometry::{Pose2, Vector2, angle_difference_rad};
use crate::ids::{StampNs, TripId};
use crate::ingest::RecordedScan;
use crate::sim::{FloorPlan, OdometryError, Rooms, SimLidar, SimScan, Vehicle};

/// Width of the corridors, metres.
const CORRIDOR_M: f64 = 2.4;
const LAPS: usize = 2;
/// Raw odometry: 2 % too long, 5 cm and 1° after a metre.
const ODOMETRY: OdometryError = OdometryError {
    scale: 0.02,
    yaw_drift_rad_per_m: 0.0,
    sigma_xy_m: 0.05,
    sigma_theta_rad: PI / 180.0,
};
const SPEED_MPS: f64 = 0.8;
/// Noise that should not move a map, metres.
const NOISE_M: f64 = 0.001;
/// A closure is wrong if it is off by more than this, metres …
const WRONG_M: f64 = 0.3;
/// … or radians.
const WRONG_RAD: f64 = 0.05;
/// … and by more than this many of its own standard deviations: along a corridor it may say nothing.
const WRONG_SIGMAS: f64 = 5.0;
/// A map is right without a wrong closure, and if no keyframe is farther off than this, metres.
const RIGHT_WITHIN_M: f64 = 0.5;
/// The lap is closed by a closure between scans so far apart along the way, as a share of the lap.
const ROUND_SHARE: f64 = 0.75;

/// A kind of building.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Building {
    /// Length of its corridor, which is a loop, metres.
    pub way_m: f64,
    /// Whether it looks the same turned by half.
    pub is_symmetric: bool,
    /// From a scan to the next, metres.
    pub scan_spacing_m: f64,
}

/// Those that are measured.
pub const BUILDINGS: [Building; 9] = {
    const fn building(way_m: f64, is_symmetric: bool, scan_spacing_m: f64) -> Building {
        Building {
            way_m,
            is_symmetric,
            scan_spacing_m,
        }
    }
    [
        building(50.0, false, 0.3),
        building(50.0, false, 1.0),
        building(200.0, false, 0.3),
        building(200.0, false, 1.0),
        building(500.0, false, 0.3),
        building(500.0, false, 1.0),
        building(50.0, true, 1.0),
        building(200.0, true, 1.0),
        building(500.0, true, 1.0),
    ]
};

/// What became of the map of one building.
#[derive(Debug, Clone, Serialize)]
pub struct BuildingCase {
    /// Its kind.
    pub building: Building,
    /// How it was drawn.
    pub seed: u64,
    /// Keyframes that have a place.
    pub keyframes: usize,
    /// How far they are from the truth, once the map is laid onto it: median, metres.
    pub median_m: f64,
    /// The largest, metres.
    pub worst_m: f64,
    /// Closures of the map.
    pub closures: usize,
    /// Of these, between scans at least three quarters of a lap apart.
    pub round: usize,
    /// Of all, those that are off by more than 0.3 m or 0.05 rad.
    pub wrong: usize,
    /// How far a millimetre of noise moves keyframes: median, metres.
    pub moved_median_m: f64,
    /// The farthest, metres.
    pub moved_worst_m: f64,
}

impl BuildingCase {
    /// Whether the map can be used.
    pub fn is_right(&self) -> bool {
        self.wrong == 0 && self.worst_m <= RIGHT_WITHIN_M
    }
}

/// Maps every building with every seed, and once more with a millimetre of noise; calls
/// `after_case` after each.
///
/// # Errors
/// If a building has no route, or its scans no map.
pub fn measure_buildings(
    buildings: &[Building],
    seeds: std::ops::Range<u64>,
    after_case: impl Fn() + Sync,
) -> anyhow::Result<Vec<BuildingCase>> {
    let of_building = |building: Building| seeds.clone().map(move |seed| (building, seed));
    let cases: Vec<_> = buildings.iter().copied().flat_map(of_building).collect();
    let measured = cases.into_par_iter().map(|(building, seed)| {
        let case = measure(building, seed)?;
        after_case();
        Ok(case)
    });
    measured.collect()
}

fn measure(building: Building, seed: u64) -> anyhow::Result<BuildingCase> {
    let (recording, truth) = recorded(building, seed)?;
    let recordings = [recording];
    let run = MapRun::of(&recordings)?;
    let noisy = MapRun::of(&with_noise(&recordings, NOISE_M, seed))?;
    let mut off_m = errors_m(&run.keyframes, &truth);
    let mut moved_m = distances_m(&run.keyframes, &noisy.poses);
    off_m.sort_by(f64::total_cmp);
    moved_m.sort_by(f64::total_cmp);
    let median = |sorted: &[f64]| sorted.get(sorted.len() / 2).copied().unwrap_or(0.0);
    let last = |sorted: &[f64]| sorted.last().copied().unwrap_or(0.0);
    let round_scans = ROUND_SHARE * building.way_m / building.scan_spacing_m;
    let order: BTreeMap<StampNs, usize> = truth.keys().copied().zip(0..).collect();
    let is_round = |closure: &&MeasuredClosure| {
        let place = |stamp: &StampNs| order.get(stamp).copied().unwrap_or(0);
        place(&closure.from).abs_diff(place(&closure.to)) as f64 >= round_scans
    };
    Ok(BuildingCase {
        building,
        seed,
        keyframes: off_m.len(),
        median_m: median(&off_m),
        worst_m: last(&off_m),
        closures: run.closures.len(),
        round: run.closures.iter().filter(is_round).count(),
        wrong: run.closures.iter().filter(|c| is_wrong(c, &truth)).count(),
        moved_median_m: median(&moved_m),
        moved_worst_m: last(&moved_m),
    })
}

/// What is driven in a building: the recording, and where each scan was truly taken.
fn recorded(
    building: Building,
    seed: u64,
) -> anyhow::Result<(Recording, BTreeMap<StampNs, Pose2>)> {
    let plan = FloorPlan {
        is_symmetric: building.is_symmetric,
        ..FloorPlan::round(building.way_m, CORRIDOR_M)
    };
    let vehicle = Vehicle {
        lidar: SimLidar::sector(PI, 181, 30.0, 0.01, Pose2::new(0.2, 0.0, 0.0)),
        odometry: ODOMETRY,
        path_noise_m: 0.2,
        scan_spacing_m: building.scan_spacing_m,
        speed_mps: SPEED_MPS,
    };
    let scans = Rooms::of_plan(&plan, seed)?
        .scene
        .drive(&vehicle, 0..LAPS, seed);
    let stamp = |scan: &SimScan| StampNs((1e9 * scan.time_s) as i64);
    let truth = scans.iter().map(|scan| (stamp(scan), scan.map_from_base));
    let truth = truth.collect();
    let scans = scans.iter().map(|scan| RecordedScan {
        stamp: stamp(scan),
        odom_from_base: scan.odom_from_base,
        ranges_m: scan.ranges_m.clone(),
    });
    let recording = Recording {
        trip: TripId::new("building")?,
        lidar: Arc::new(vehicle.lidar.geometry.clone().validated()?),
        scans: scans.collect(),
    };
    Ok((recording, truth))
}

/// How far poses are from the truth after the rigid motion that lays them best onto it, metres.
fn errors_m(poses: &BTreeMap<StampNs, Pose2>, truth: &BTreeMap<StampNs, Pose2>) -> Vec<f64> {
    let both = poses
        .iter()
        .filter_map(|(stamp, pose)| Some((pose.translation(), truth.get(stamp)?.translation())));
    let both: Vec<(Vector2<f64>, Vector2<f64>)> = both.collect();
    let count = both.len().max(1) as f64;
    let sums = both.iter().fold(
        (Vector2::zeros(), Vector2::zeros()),
        |(a, b): (Vector2<f64>, Vector2<f64>), (pose, true_pose)| (a + pose, b + true_pose),
    );
    let (middle, true_middle) = (sums.0 / count, sums.1 / count);
    let (dot, cross) = both.iter().fold((0.0, 0.0), |(dot, cross), (pose, there)| {
        let (a, b) = (pose - middle, there - true_middle);
        (dot + a.dot(&b), cross + a.perp(&b))
    });
    let turn = Pose2::new(0.0, 0.0, f64::atan2(cross, dot));
    let off_m = |(pose, there): &(Vector2<f64>, Vector2<f64>)| {
        (turn.transform(&(pose - middle)) + true_middle - there).norm()
    };
    both.iter().map(off_m).collect()
}

fn is_wrong(closure: &MeasuredClosure, truth: &BTreeMap<StampNs, Pose2>) -> bool {
    let [Some(from), Some(to)] = [closure.from, closure.to].map(|stamp| truth.get(&stamp)) else {
        return false;
    };
    let there = from.between(to);
    let off = there.between(&closure.measurement);
    let is_far =
        off.translation().norm() > WRONG_M || angle_difference_rad(off.theta, 0.0) > WRONG_RAD;
    let error = Pose2::edge_error(&Pose2::IDENTITY, &there, &closure.measurement);
    is_far && closure.information.squared_norm(&error) > WRONG_SIGMAS.powi(2)
}

/// A row for each kind of building.
pub fn buildings_text(cases: &[BuildingCase]) -> String {
    let head = [
        "loop, m",
        "scans every, m",
        "symmetric",
        "maps right",
        "lap closed",
        "error: median, worst m",
        "closures wrong",
        "moved: median, worst m",
    ];
    let mut table = Table::new("Floors with long corridors", &head);
    for row in cases.chunk_by(|a, b| a.building == b.building) {
        let building = row[0].building;
        let count = |is: fn(&BuildingCase) -> bool| row.iter().filter(|c| is(c)).count();
        let sorted = |value: fn(&BuildingCase) -> f64| {
            let mut values: Vec<f64> = row.iter().map(value).collect();
            values.sort_by(f64::total_cmp);
            values
        };
        let middle_and_last = |median: Vec<f64>, worst: Vec<f64>| {
            let (median, worst) = (median.get(row.len() / 2), worst.last());
            format!(
                "{:.3}, {:.2}",
                median.unwrap_or(&0.0),
                worst.unwrap_or(&0.0)
            )
        };
        let sum = |value: fn(&BuildingCase) -> usize| row.iter().map(value).sum::<usize>();
        table.row([
            building.way_m.to_string(),
            building.scan_spacing_m.to_string(),
            if building.is_symmetric { "yes" } else { "no" }.to_owned(),
            format!("{} of {}", count(BuildingCase::is_right), row.len()),
            format!("{} of {}", count(|c| c.round > 0), row.len()),
            middle_and_last(sorted(|c| c.median_m), sorted(|c| c.worst_m)),
            format!("{} of {}", sum(|c| c.wrong), sum(|c| c.closures)),
            middle_and_last(sorted(|c| c.moved_median_m), sorted(|c| c.moved_worst_m)),
        ]);
    }
    table.remark(
        "Right: no closure is off by more than 0.3 m or 0.05 rad, no keyframe by more than 0.5 m. \
         Moved: by a millimetre of noise on every range. Medians are those of the maps' medians.",
    );
    table.text()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Information;

    #[test]
    fn a_short_loop_is_closed_rightly() {
        let mut building = BUILDINGS[1];
        assert_eq!((building.way_m, building.scan_spacing_m), (50.0, 1.0));
        for is_symmetric in [false, true] {
            building.is_symmetric = is_symmetric;
            let cases = measure_buildings(&[building], 3..4, || ()).unwrap();
            let [case] = cases.as_slice() else {
                panic!("{} cases", cases.len());
            };
            assert!(case.is_right() && case.round > 50, "{case:?}");
            assert!(case.worst_m < 0.05 && case.moved_worst_m < 0.05, "{case:?}");
            assert!(buildings_text(&cases).contains("1 of 1"));
        }
    }

    /// The first closures tie this trip across the corridor only, half a metre off along it.
    #[test]
    fn a_trip_that_is_tied_across_a_corridor_is_still_looked_for_along_it() {
        let building = BUILDINGS[3];
        assert_eq!((building.way_m, building.scan_spacing_m), (200.0, 1.0));
        let cases = measure_buildings(&[building], 95..96, || ()).unwrap();
        assert!(cases[0].is_right(), "{cases:?}");
        assert!(cases[0].worst_m < 0.3, "{cases:?}");
    }

    #[test]
    fn a_closure_is_wrong_if_it_is_off_and_sure_of_it() {
        let truth = [(1, Pose2::IDENTITY), (2, Pose2::new(2.0, 0.0, 0.0))];
        let truth: BTreeMap<_, _> = truth.map(|(s, pose)| (StampNs(s), pose)).into();
        let closure = |x_m: f64, sigma_m: f64| MeasuredClosure {
            from: StampNs(1),
            to: StampNs(2),
            measurement: Pose2::new(x_m, 0.0, 0.0),
            information: Information::from_sigmas(sigma_m, 0.01),
        };
        assert!(is_wrong(&closure(2.4, 0.02), &truth));
        assert!(!is_wrong(&closure(2.4, 0.5), &truth), "it says nothing");
        assert!(!is_wrong(&closure(2.2, 0.02), &truth), "near enough");
    }

    #[test]
    fn a_map_that_lies_turned_and_moved_is_no_error() {
        let pose = |k: i64| Pose2::new(k as f64, 0.1 * (k * k) as f64, 0.0);
        let truth: BTreeMap<_, _> = (0..9).map(|k| (StampNs(k), pose(k))).collect();
        let frame = Pose2::new(3.0, -7.0, 2.0);
        let mut poses: BTreeMap<_, _> = (0..9)
            .map(|k| (StampNs(k), frame.compose(&pose(k))))
            .collect();
        assert!(errors_m(&poses, &truth).iter().all(|off_m| *off_m < 1e-9));
        if let Some(pose) = poses.get_mut(&StampNs(4)) {
            pose.x += 0.5;
        }
        assert!(errors_m(&poses, &truth).iter().any(|off_m| *off_m > 0.4));
    }
}
