//! What a second lidar is worth: the same simulated laps seen by a front lidar of 180°, by it and a
//! rear one together, and by one that sees all round.
//!
//! `cargo run --release --example two_lidars -- FIRST_SEED SEEDS` prints, for each world and
//! vehicle, how far keyframes are from the truth and how many of the visible changes are found.

use std::collections::BTreeMap;
use std::f64::consts::PI;
use std::io::Write;
use std::sync::Arc;

use anyhow::Context;
use mapshift::change::{ChangeKind, Finding};
use mapshift::experiments::region_distance_m;
use mapshift::geometry::Pose2;
use mapshift::ids::{LidarId, StampNs, TripId};
use mapshift::mapping::{
    Drive, DriveScan, InitialPose, LidarOfVehicle, RouteMap, Scope, Sites, Weighting,
};
use mapshift::scan::LaserScan;
use mapshift::sim::{Changes, Hall, Rooms, Scene, SimLidar, SimScan, Vehicle};
use rayon::iter::{IntoParallelIterator, ParallelIterator};

/// Laps before the world changes, and of all; each is a trip of its own.
const LAPS_BEFORE: usize = 2;
const LAPS: usize = 4;
/// From the start of a lap to that of the next, seconds.
const LAP_PAUSE_S: f64 = 10_000.0;
const BATCH_SCANS: usize = 60;
const PATH_NOISE_M: f64 = 0.5;
const RANGE_MAX_M: f64 = 20.0;
const RANGE_SIGMA_M: f64 = 0.01;
const BEAMS: usize = 181;
/// What goes before the change, and what comes, so large as a share of what stands free.
const REMOVED: usize = 2;
const ADDED: usize = 4;
const AREA_SHARE: f64 = 0.3;
/// A finding is of a change if its region is no farther from it, metres.
const REACH_M: f64 = 0.35;
const NAMES: [&str; 2] = ["front", "rear"];
const VEHICLES: [&str; 3] = ["front 180°", "front and rear 180°", "all round 360°"];
const WORLDS: [&str; 2] = ["hall", "rooms"];

/// What came of one world with one vehicle.
#[derive(Default, Clone)]
struct Outcome {
    errors_m: Vec<f64>,
    found: usize,
    changes: usize,
    false_findings: usize,
    batches_not_merged: usize,
}

fn main() -> anyhow::Result<()> {
    let mut arguments = std::env::args()
        .skip(1)
        .map(|argument| argument.parse::<u64>());
    let mut number = || {
        arguments
            .next()
            .context("usage: two_lidars FIRST_SEED SEEDS")
    };
    let (first_seed, seeds) = (number()??, number()??);
    let mut console = std::io::stdout();
    for world in WORLDS {
        for (which, vehicle) in VEHICLES.iter().enumerate() {
            let runs = (first_seed..first_seed + seeds).into_par_iter();
            let runs = runs.map(|seed| run(world, which, seed));
            let mut runs: Vec<Outcome> = runs.collect::<anyhow::Result<_>>()?;
            let of_seeds = |runs: &mut [Outcome]| -> Vec<String> {
                let worst = runs.iter_mut().map(|run| {
                    run.errors_m.sort_by(f64::total_cmp);
                    format!("{:.3}", run.errors_m.last().copied().unwrap_or_default())
                });
                worst.collect()
            };
            let worst = of_seeds(&mut runs).join(" ");
            let mut all = Outcome::default();
            for run in runs {
                all.errors_m.extend(run.errors_m);
                all.found += run.found;
                all.changes += run.changes;
                all.false_findings += run.false_findings;
                all.batches_not_merged += run.batches_not_merged;
            }
            all.errors_m.sort_by(f64::total_cmp);
            let at = |share: f64| all.errors_m[(share * (all.errors_m.len() - 1) as f64) as usize];
            writeln!(
                console,
                "{world}, {vehicle}: {} keyframes off by {:.4} m (median), {:.4} m (95 %), {:.3} m \
                 (worst; by seed {worst}); found {} of {} changes, {} false, {} batches not merged",
                all.errors_m.len(),
                at(0.5),
                at(0.95),
                at(1.0),
                all.found,
                all.changes,
                all.false_findings,
                all.batches_not_merged,
            )?;
        }
    }
    Ok(())
}

fn run(world: &str, which: usize, seed: u64) -> anyhow::Result<Outcome> {
    let mut scene = match world {
        "hall" => Scene::of_hall(&Hall::generate(seed)?, seed),
        _ => Rooms::generate(seed)?.scene,
    };
    let mut changes = Changes::new(&mut scene, LAPS_BEFORE, PATH_NOISE_M, seed);
    changes.remove(REMOVED);
    changes.add(ADDED, AREA_SHARE);
    let [front, rear] = SimLidar::front_and_rear(PI, BEAMS, RANGE_MAX_M, RANGE_SIGMA_M);
    let all_round = SimLidar::all_round(2 * BEAMS, RANGE_MAX_M, RANGE_SIGMA_M, Pose2::IDENTITY);
    let vehicle = Vehicle {
        lidar: front.clone(),
        ..Vehicle::of_fleet(0, PATH_NOISE_M)
    };
    let of_front = scene.drive(&vehicle, 0..LAPS, seed);
    let of_rear = scene.drive_of_companion(&vehicle, (1, &rear), 0..LAPS, seed);
    // What can be found is what both lidars see: the same for all vehicles.
    let visible = scene.visible_changes(of_front.iter().chain(&of_rear));
    let seen = match which {
        0 => vec![(front, of_front)],
        1 => vec![(front, of_front), (rear, of_rear)],
        _ => {
            let scans = scene.drive_of_companion(&vehicle, (2, &all_round), 0..LAPS, seed);
            vec![(all_round, scans)]
        }
    };
    let mut outcome = Outcome::default();
    let mut map = RouteMap::new(Weighting::Robust);
    let mut truth = BTreeMap::new();
    for lap in 0..LAPS {
        let scans = scans_of(&seen, lap)?;
        let start = seen[0].1.first().map(|scan| scan.map_from_base);
        truth.extend(truths(&seen[0].1, lap));
        let trip = TripId::new(format!("lap-{lap}"))?;
        let mut waiting = Vec::new();
        let mut batches_waiting = 0;
        for batch in scans.chunks(BATCH_SCANS * seen.len()) {
            waiting.extend(batch.iter().cloned());
            let initial_pose = start.filter(|_| map.keyframes().is_empty());
            let drive = Drive {
                wheels: Default::default(),
                trip: trip.clone(),
                initial_pose: initial_pose.map(|pose| InitialPose {
                    pose,
                    sigma_xy_m: 0.01,
                    sigma_theta_rad: 0.002,
                }),
                scans: waiting.clone(),
            };
            batches_waiting += 1;
            if map.extend(&drive).is_ok() {
                waiting.clear();
                batches_waiting = 0;
            }
        }
        outcome.batches_not_merged += batches_waiting;
    }
    let placed = map.keyframes().iter().zip(map.graph().nodes());
    outcome.errors_m = placed
        .filter_map(|(keyframe, node)| {
            let truth: &Pose2 = truth.get(&keyframe.stamp)?;
            Some((truth.translation() - node.pose.translation()).norm())
        })
        .collect();
    let findings = findings(&mut map);
    let reports = |finding: &Finding, kind: ChangeKind, shape| {
        let own = (finding.kind, &finding.region);
        let other = finding.counterpart.as_ref().map(|c| (c.kind, &c.region));
        let mut sides = std::iter::once(own).chain(other);
        sides.any(|(of, region)| of == kind && region_distance_m(shape, region) <= REACH_M)
    };
    outcome.changes = visible.len();
    let is_found = |kind, shape| findings.iter().any(|f| reports(f, kind, shape));
    outcome.found = visible
        .iter()
        .filter(|c| is_found(c.kind, &c.shape))
        .count();
    let changed = scene
        .objects
        .iter()
        .filter(|o| o.from_lap > 0 || o.until_lap.is_some());
    let changed: Vec<_> = changed.map(|object| &object.shape).collect();
    let is_false = |finding: &&Finding| {
        finding.kind.is_of_state()
            && !changed
                .iter()
                .any(|shape| region_distance_m(shape, &finding.region) <= REACH_M)
    };
    outcome.false_findings = findings.iter().filter(is_false).count();
    Ok(outcome)
}

fn stamp(scan: &SimScan, lap_start_s: f64) -> StampNs {
    let since_s = LAP_PAUSE_S * scan.lap as f64 + scan.time_s - lap_start_s;
    StampNs((1e9 * since_s) as i64)
}

fn truths(scans: &[SimScan], lap: usize) -> Vec<(StampNs, Pose2)> {
    let of_lap = || scans.iter().filter(|scan| scan.lap == lap);
    let start_s = of_lap().next().map_or(0.0, |scan| scan.time_s);
    of_lap()
        .map(|scan| (stamp(scan, start_s), scan.map_from_base))
        .collect()
}

/// A lap's scans of all lidars, in the order of time.
fn scans_of(seen: &[(SimLidar, Vec<SimScan>)], lap: usize) -> anyhow::Result<Vec<DriveScan>> {
    let mut scans = Vec::new();
    for (place, (lidar, driven)) in seen.iter().enumerate() {
        let geometry = Arc::new(lidar.geometry.clone());
        let name = (seen.len() > 1)
            .then(|| LidarId::new(NAMES[place]))
            .transpose()?;
        let of_lap = || driven.iter().filter(|scan| scan.lap == lap);
        let start_s = of_lap().next().map_or(0.0, |scan| scan.time_s);
        for scan in of_lap() {
            let ranges_m = scan.ranges_m.iter().copied();
            scans.push(DriveScan {
                stamp: stamp(scan, start_s),
                odom_from_base: scan.odom_from_base,
                beam_interval_s: 0.0,
                lidar: LidarOfVehicle {
                    name: name.clone(),
                    place,
                },
                scan: LaserScan::new(geometry.clone(), ranges_m)?,
            });
        }
    }
    scans.sort_by_key(|scan| scan.stamp);
    Ok(scans)
}

fn findings(map: &mut RouteMap) -> Vec<Finding> {
    map.findings(&Scope {
        sites: Sites::All,
        pending: &[],
        false_alerts_per_lap: mapshift::change::FALSE_ALERTS_PER_LAP,
        accepted: &[],
        vehicles: &BTreeMap::new(),
        suspects: &[],
    })
}
