//! The effect of an odometry fault in one trip on the map and on the sound trips.
//!
//! Three trips through a simulated world, the second or the first of them with a fault half-way.
//! The world does not change: every alert is false.

use rayon::iter::{IntoParallelIterator, ParallelIterator};
use serde::Serialize;

use super::recording::Recording;
use super::route::RouteRun;
use super::table::Table;
use super::world_conditions::{Condition, PLAIN, WorldKind};
use super::worlds::{Setting, recordings_of};
use crate::geometry::{Pose2, angle_difference_rad};
use crate::sim::SimScan;

/// A fault of a vehicle's odometry.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Fault {
    /// One step turns by 80° too much.
    Turn,
    /// One step is 5 m too long.
    Jump,
    /// The wheels slip: along 3 m they report three times the way.
    Slip,
    /// The vehicle is carried over a third of the lap, with its odometry running.
    Carried,
    /// The odometry restarts from zero.
    Restart,
    /// The wheels report nothing, for the whole trip.
    Silent,
}

impl Fault {
    /// All of them, in the order of the table.
    pub const ALL: [Self; 6] = [
        Self::Turn,
        Self::Jump,
        Self::Slip,
        Self::Carried,
        Self::Restart,
        Self::Silent,
    ];

    fn name(self) -> &'static str {
        match self {
            Self::Turn => "a step turns by 80°",
            Self::Jump => "a step of 5 m",
            Self::Slip => "slip, 3 m",
            Self::Carried => "carried",
            Self::Restart => "odometry starts anew",
            Self::Silent => "no odometry",
        }
    }

    /// Puts the fault into a trip at one of its scans. Returns the first scan of what comes after.
    fn apply(self, recording: &mut Recording, at: usize) -> usize {
        let scans = &mut recording.scans;
        let odometry: Vec<Pose2> = scans.iter().map(|scan| scan.odom_from_base).collect();
        let mut motions: Vec<Pose2> = odometry.windows(2).map(|w| w[0].between(&w[1])).collect();
        match self {
            Self::Turn => {
                let turn = Pose2::new(0.0, 0.0, 80.0_f64.to_radians());
                motions[at] = motions[at].compose(&turn);
            }
            Self::Jump => motions[at] = motions[at].compose(&Pose2::new(5.0, 0.0, 0.0)),
            Self::Slip => {
                let mut way_m = 0.0;
                for motion in &mut motions[at..] {
                    way_m += motion.translation().norm();
                    if way_m > SLIP_WAY_M {
                        break;
                    }
                    *motion = Pose2::new(3.0 * motion.x, 3.0 * motion.y, motion.theta);
                }
            }
            Self::Carried => {
                let over = scans.len() / 3;
                scans.drain(at + 1..at + 1 + over);
                motions.drain(at + 1..at + 1 + over);
            }
            Self::Restart => {
                let start = odometry[at].compose(&motions[at]);
                motions[at] = odometry[at].between(&Pose2::new(0.0, 0.0, start.theta * 0.5));
            }
            Self::Silent => motions.fill(Pose2::IDENTITY),
        }
        let mut odom_from_base = odometry[0];
        for (scan, motion) in scans
            .iter_mut()
            .zip([Pose2::IDENTITY].iter().chain(&motions))
        {
            odom_from_base = odom_from_base.compose(motion);
            scan.odom_from_base = odom_from_base;
        }
        match self {
            Self::Silent => 1,
            _ => at + 1,
        }
    }
}

/// Distance over which the wheels slip, metres.
const SLIP_WAY_M: f64 = 3.0;
/// Scans within this of the truth are right, metres …
const RIGHT_WITHIN_M: f64 = 0.15;
/// … and radians.
const RIGHT_WITHIN_RAD: f64 = 0.05;

/// Which of the three trips has the fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum FaultyTrip {
    /// The one that makes the map.
    First,
    /// One that repeats it.
    Second,
}

/// The outcome of one case.
#[derive(Debug, Clone, Serialize)]
pub struct FaultCase {
    /// The fault.
    pub fault: Fault,
    /// Which trip's odometry.
    pub trip: FaultyTrip,
    /// The world.
    pub world: &'static str,
    /// The seed.
    pub seed: u64,
    /// Scans of sound trips, and of the faulty one before the fault, that are right.
    pub others_right: usize,
    /// Number of these scans.
    pub others: usize,
    /// The largest error among them, metres.
    pub others_worst_m: f64,
    /// Scans of the faulty trip after the fault that are right …
    pub after_right: usize,
    /// … and how many have a place in the map.
    pub after: usize,
    /// Distance from the fault until the trip stays right, metres; `None` if it never does.
    pub localised_after_m: Option<f64>,
    /// Batches without a place in the map.
    pub batches_not_merged: usize,
    /// Alerts ever raised; all of them are false.
    pub false_alerts: usize,
}

/// Runs `seeds` seeds of every fault of every world; calls `after_run` after each run.
///
/// # Errors
/// If a world has no route, or its scans no map.
pub fn measure_faults(
    faults: &[Fault],
    seeds: std::ops::Range<u64>,
    after_run: impl Fn() + Sync,
) -> anyhow::Result<Vec<FaultCase>> {
    let mut cases = Vec::new();
    for &fault in faults {
        for trip in [FaultyTrip::Second, FaultyTrip::First] {
            for world in WORLDS {
                cases.extend(seeds.clone().map(|seed| (fault, trip, world, seed)));
            }
        }
    }
    let run_one = |(fault, trip, world, seed)| {
        let case = run(fault, trip, world, seed);
        after_run();
        case
    };
    cases.into_par_iter().map(run_one).collect()
}

const WORLDS: [WorldKind; 2] = [WorldKind::Hall, WorldKind::Rooms];

fn run(fault: Fault, trip: FaultyTrip, world: WorldKind, seed: u64) -> anyhow::Result<FaultCase> {
    let condition = Condition {
        changes: 0,
        trip_a_lap: true,
        ..PLAIN
    };
    let setting = Setting::of(world, &condition, seed)?;
    let fleet = condition.fleet();
    let drives = setting.drive(&fleet, seed);
    let mut recordings = recordings_of(&fleet, &drives, true)?;
    recordings.truncate(3);
    let lap_of = |lap: usize| -> Vec<&SimScan> {
        drives.iter().flatten().filter(|s| s.lap == lap).collect()
    };
    let faulty = match trip {
        FaultyTrip::First => 0,
        FaultyTrip::Second => 1,
    };
    // From four to six tenths of the lap.
    let at = lap_of(faulty).len() * (40 + (7 * seed % 21) as usize) / 100;
    let stamps: Vec<_> = recordings[faulty].scans.iter().map(|s| s.stamp).collect();
    let after = fault.apply(&mut recordings[faulty], at);
    let first_after = recordings[faulty].scans[after].stamp;
    let run = RouteRun::of(&recordings, true)?;
    let mut case = FaultCase {
        fault,
        trip,
        world: world.name(),
        seed,
        others_right: 0,
        others: 0,
        others_worst_m: 0.0,
        after_right: 0,
        after: 0,
        localised_after_m: None,
        batches_not_merged: run.batches_not_merged,
        false_alerts: run.alerts.iter().filter(|a| a.raised.is_some()).count(),
    };
    let mut way_m = 0.0;
    for (lap, recording) in recordings.iter().enumerate() {
        let truth = lap_of(lap);
        let mut last: Option<Pose2> = None;
        for scan in &recording.scans {
            let Some(pose) = run.poses.get(&scan.stamp) else {
                continue;
            };
            let k = match lap == faulty {
                true => stamps.iter().position(|stamp| *stamp == scan.stamp),
                false => recording.scans.iter().position(|s| s.stamp == scan.stamp),
            };
            let Some(there) = k.and_then(|k| truth.get(k)) else {
                continue;
            };
            let there = there.map_from_base;
            let off_m = (pose.translation() - there.translation()).norm();
            let is_right = off_m <= RIGHT_WITHIN_M
                && angle_difference_rad(pose.theta, there.theta) <= RIGHT_WITHIN_RAD;
            if lap == faulty && scan.stamp >= first_after {
                way_m += last.map_or(0.0, |p| (p.translation() - there.translation()).norm());
                last = Some(there);
                case.after += 1;
                case.after_right += usize::from(is_right);
                case.localised_after_m = match (is_right, case.localised_after_m) {
                    (true, None) => Some(way_m),
                    (true, since) => since,
                    (false, _) => None,
                };
            } else {
                case.others += 1;
                case.others_right += usize::from(is_right);
                case.others_worst_m = case.others_worst_m.max(off_m);
            }
        }
    }
    Ok(case)
}

/// A row for each fault and trip.
pub fn faults_text(cases: &[FaultCase]) -> String {
    let mut table = Table::new(
        "Faults of odometry",
        &[
            "fault",
            "trip",
            "cases",
            "others right",
            "others' worst, median m",
            "largest m",
            "localised again",
            "after, median m",
            "batches not merged",
            "false alerts",
        ],
    );
    for fault in Fault::ALL {
        for trip in [FaultyTrip::Second, FaultyTrip::First] {
            let of_row = |c: &&FaultCase| c.fault == fault && c.trip == trip;
            let row: Vec<_> = cases.iter().filter(of_row).collect();
            if row.is_empty() {
                continue;
            }
            let sum = |value: fn(&FaultCase) -> usize| row.iter().map(|c| value(c)).sum::<usize>();
            let mut worst_m: Vec<f64> = row.iter().map(|c| c.others_worst_m).collect();
            worst_m.sort_by(f64::total_cmp);
            let mut after_m: Vec<f64> = row.iter().filter_map(|c| c.localised_after_m).collect();
            after_m.sort_by(f64::total_cmp);
            let median = |sorted: &[f64]| match sorted.get(sorted.len() / 2) {
                Some(value) => format!("{value:.2}"),
                None => "–".to_owned(),
            };
            table.row([
                fault.name().to_owned(),
                format!("{trip:?}").to_lowercase(),
                row.len().to_string(),
                format!("{} of {}", sum(|c| c.others_right), sum(|c| c.others)),
                median(&worst_m),
                worst_m
                    .last()
                    .map_or_else(String::new, |m| format!("{m:.2}")),
                format!("{} of {}", after_m.len(), row.len()),
                median(&after_m),
                sum(|c| c.batches_not_merged).to_string(),
                sum(|c| c.false_alerts).to_string(),
            ]);
        }
    }
    table.text()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_made_up_step_is_distinguished_from_the_truth_and_a_hall_is_found_again() {
        let made_up = run(Fault::Jump, FaultyTrip::Second, WorldKind::Hall, 3).unwrap();
        assert!(made_up.others > 500 && made_up.others_right == made_up.others);
        assert!(made_up.after > 100 && made_up.localised_after_m.is_some_and(|m| m < 2.0));
        assert_eq!((made_up.false_alerts, made_up.batches_not_merged), (0, 0));
        let text = faults_text(&[made_up]);
        assert!(
            text.contains("a step of 5 m") && text.contains("1 of 1"),
            "{text}"
        );
    }

    #[test]
    fn who_was_carried_to_a_place_that_looks_the_same_is_found_and_reports_no_changes() {
        for (trip, seed) in [
            (FaultyTrip::Second, 2),
            (FaultyTrip::First, 4),
            (FaultyTrip::First, 315),
        ] {
            let carried = run(Fault::Carried, trip, WorldKind::Rooms, seed).unwrap();
            assert!(
                carried.localised_after_m.is_some_and(|m| m < 1.0),
                "{carried:?}"
            );
            assert_eq!(carried.others_right, carried.others);
            assert_eq!((carried.false_alerts, carried.batches_not_merged), (0, 0));
        }
    }

    #[test]
    fn faults_strike_where_they_should() {
        let condition = Condition {
            changes: 0,
            trip_a_lap: true,
            ..PLAIN
        };
        let setting = Setting::of(WorldKind::Hall, &condition, 1).unwrap();
        let fleet = condition.fleet();
        let drives = setting.drive(&fleet, 1);
        let sound = recordings_of(&fleet, &drives, true).unwrap().remove(1);
        let motions = |r: &Recording| -> Vec<Pose2> {
            let poses = r.scans.windows(2);
            poses
                .map(|w| w[0].odom_from_base.between(&w[1].odom_from_base))
                .collect()
        };
        for fault in Fault::ALL {
            let mut faulty = sound.clone();
            let after = fault.apply(&mut faulty, 100);
            let (was, is) = (motions(&sound), motions(&faulty));
            let same = |k: usize| {
                let apart = was[k].between(&is[k]);
                apart.translation().norm() < 1e-6 && apart.theta.abs() < 1e-6
            };
            if fault != Fault::Silent {
                assert!((0..100).all(same), "{fault:?}");
                assert_eq!(after, 101);
            }
            // The odometry of a carried vehicle does not notice.
            assert_eq!(same(100), fault == Fault::Carried, "{fault:?}");
            let shorter = if fault == Fault::Carried {
                sound.scans.len() / 3
            } else {
                0
            };
            assert_eq!(faulty.scans.len() + shorter, sound.scans.len());
        }
    }
}
