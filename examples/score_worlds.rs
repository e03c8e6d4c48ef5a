//! Scores the fused detector in worlds that are harder than the paper's halls.
//!
//! `cargo run --release --example score_worlds -- [FIRST_SEED [SEEDS]]` drives fleets through
//! changing worlds, builds one map of each, and prints for each world and condition how many of
//! the visible changes were found and how many of the findings were true. A change is found by a
//! finding of its kind whose region lies within 0.35 m of the object (0.5 m in a fleet with a
//! lidar of more than 2 cm noise). Of those missed it says how many nobody can tell: in the other
//! state fewer than four scans look at their place, because something else hides it. Every trip
//! but the very first is anchored by search.

use std::collections::BTreeMap;
use std::io::Write;
use std::sync::Arc;

use anyhow::Context;
use mapshift::change::{ChangeKind, FALSE_ALERTS_PER_LAP, Finding};
use mapshift::geometry::{Pose2, Vector2};
use mapshift::ids::{StampNs, TripId};
use mapshift::mapping::{Drive, DriveScan, InitialPose, RouteMap, Scope, Sites, Weighting};
use mapshift::scan::LaserScan;
use mapshift::sim::{ChangeEvent, Changes, Hall, Rooms, Scene, Shape, SimScan, Vehicle};

const LAPS_BEFORE: usize = 2;
const LAPS_AFTER: usize = 2;
const LAPS: std::ops::Range<usize> = 0..LAPS_BEFORE + LAPS_AFTER;
const BATCH_SCANS: usize = 60;
/// A scan looks at an object if so many of its beams strike it.
const BEAMS_MIN: usize = 3;
/// So many scans must look at a place.
const LOOKS_MIN: usize = 4;
const WORLDS: [&str; 4] = ["hall", "racks", "rooms", "street"];

/// What is made hard.
struct Condition {
    name: &'static str,
    changes: usize,
    walkers: usize,
    vehicles: usize,
    path_noise_m: f64,
    faulty: bool,
    trip_a_lap: bool,
}

const PLAIN: Condition = Condition {
    name: "one vehicle",
    changes: 6,
    walkers: 0,
    vehicles: 1,
    path_noise_m: 0.5,
    faulty: false,
    trip_a_lap: false,
};

const CONDITIONS: [Condition; 5] = [
    PLAIN,
    Condition {
        name: "3 people walk",
        walkers: 3,
        ..PLAIN
    },
    Condition {
        name: "4 vehicles, 3 kinds of lidar, 3 people, strays of 1 m",
        walkers: 3,
        vehicles: 4,
        path_noise_m: 1.0,
        ..PLAIN
    },
    Condition {
        name: "every lap anchored by search",
        trip_a_lap: true,
        walkers: 3,
        ..PLAIN
    },
    Condition {
        name: "nothing changes, 5 people, one of 3 lidars turned by 2°",
        changes: 0,
        walkers: 5,
        vehicles: 3,
        faulty: true,
        ..PLAIN
    },
];

#[derive(Default)]
struct Score {
    events: usize,
    found: usize,
    hidden: usize,
    findings: usize,
    true_findings: usize,
    suspected: usize,
    mismatches: usize,
    unanchored: usize,
    laps: usize,
}

fn main() -> anyhow::Result<()> {
    let mut numbers = std::env::args().skip(1).map(|text| text.parse::<u64>());
    let first = numbers.next().transpose()?.unwrap_or(7_000);
    let seeds = numbers.next().transpose()?.unwrap_or(3);
    let mut out = std::io::stdout();
    writeln!(
        out,
        "| world | condition | laps | found | missed, hidden in the other state | findings true | vehicles suspected | mismatches | batches not anchored |"
    )?;
    writeln!(out, "|---|---|---|---|---|---|---|---|---|")?;
    for world in WORLDS {
        for condition in &CONDITIONS {
            let mut score = Score::default();
            for seed in first..first + seeds {
                run(world, condition, seed, &mut score)?;
            }
            writeln!(
                out,
                "| {world} | {} | {} | {}/{} | {} | {}/{} | {} | {} | {} |",
                condition.name,
                score.laps,
                score.found,
                score.events,
                score.hidden,
                score.true_findings,
                score.findings,
                score.suspected,
                score.mismatches,
                score.unanchored,
            )?;
        }
    }
    Ok(())
}

fn scene_of(world: &str, condition: &Condition, seed: u64) -> anyhow::Result<Scene> {
    let third = condition.changes / 3;
    let mut scene = match world {
        "hall" => Scene::of_hall(&Hall::generate(seed)?, seed),
        "racks" => Scene::racks(seed)?,
        "street" => Scene::street(seed)?,
        _ => {
            let mut rooms = Rooms::generate(seed)?;
            rooms.swing_doors(third, LAPS_BEFORE, seed);
            rooms.scene
        }
    };
    scene.walkers = condition.walkers;
    let mut changes = Changes::new(&mut scene, LAPS_BEFORE, condition.path_noise_m, seed);
    changes.remove(third);
    changes.add(condition.changes - third, 0.3);
    Ok(scene)
}

fn run(world: &str, condition: &Condition, seed: u64, score: &mut Score) -> anyhow::Result<()> {
    let scene = scene_of(world, condition, seed)?;
    let fleet = (0..condition.vehicles).map(|k| {
        let vehicle = Vehicle::of_fleet(k, condition.path_noise_m);
        if condition.faulty && k + 1 == condition.vehicles {
            vehicle.with_turned_lidar(2.0_f64.to_radians())
        } else {
            vehicle
        }
    });
    let fleet: Vec<Vehicle> = fleet.collect();
    let drives = drive(&scene, &fleet, seed);
    let truth = scene.visible_changes(drives.iter().flatten());
    let mut map = RouteMap::new(Weighting::Robust);
    for lap in LAPS {
        for (k, (vehicle, scans)) in fleet.iter().zip(&drives).enumerate() {
            let scans: Vec<&SimScan> = scans.iter().filter(|scan| scan.lap == lap).collect();
            let name = match condition.trip_a_lap {
                true => format!("{k}-{lap}"),
                false => format!("{k}"),
            };
            let clock_s = 10_000.0 * (lap * fleet.len() + k) as f64;
            score.unanchored += extend(&mut map, vehicle, &TripId::new(name)?, &scans, clock_s)?;
        }
    }
    score.laps += LAPS.len() * fleet.len();
    let reach_m = if condition.vehicles > 1 { 0.5 } else { 0.35 };
    let findings = map.findings(&Scope {
        sites: Sites::All,
        pending: &[],
        false_alerts_per_lap: FALSE_ALERTS_PER_LAP,
        accepted: &[],
        vehicles: &BTreeMap::new(),
    });
    let missed = judge(&findings, &truth, reach_m, score);
    let hidden = missed.filter(|event| !would_be_seen(&scene, &fleet, seed, event));
    score.hidden += hidden.count();
    Ok(())
}

fn drive(scene: &Scene, fleet: &[Vehicle], seed: u64) -> Vec<Vec<SimScan>> {
    let drives = fleet.iter().zip(10 * seed..);
    drives
        .map(|(vehicle, seed)| scene.drive(vehicle, LAPS, seed))
        .collect()
}

/// Whether scans of the state without a changed object look at its place: whether they would
/// strike it if it were there.
fn would_be_seen(scene: &Scene, fleet: &[Vehicle], seed: u64, event: &ChangeEvent) -> bool {
    let mut always_there = scene.clone();
    let object = &mut always_there.objects[event.object];
    (object.from_lap, object.until_lap) = (0, None);
    let is_other_state = |lap: usize| (lap < event.lap) == (event.kind == ChangeKind::Appeared);
    let drives = drive(&always_there, fleet, seed);
    let looks = drives.iter().flatten().filter(|scan| {
        let beams = scan.struck.iter().filter(|&&o| o == Some(event.object));
        is_other_state(scan.lap) && beams.count() >= BEAMS_MIN
    });
    looks.count() >= LOOKS_MIN
}

/// Returns how many batches found no place in the map.
fn extend(
    map: &mut RouteMap,
    vehicle: &Vehicle,
    trip: &TripId,
    scans: &[&SimScan],
    clock_s: f64,
) -> anyhow::Result<usize> {
    let lidar = Arc::new(vehicle.lidar.geometry.clone().validated()?);
    let start = scans.first().context("a lap without scans")?;
    let (mut waiting, mut unanchored) = (Vec::new(), 0);
    for batch in scans.chunks(BATCH_SCANS) {
        for scan in batch {
            let stamp_s = clock_s + scan.time_s - start.time_s;
            waiting.push(DriveScan {
                stamp: StampNs((stamp_s * 1e9) as i64),
                odom_from_base: scan.odom_from_base,
                scan: LaserScan::new(lidar.clone(), scan.ranges_m.iter().copied())?,
            });
        }
        let is_first = map.keyframes().is_empty();
        let drive = Drive {
            trip: trip.clone(),
            initial_pose: is_first.then(|| well_known(start.map_from_base)),
            scans: waiting.clone(),
        };
        match map.extend(&drive) {
            Ok(_) => waiting.clear(),
            Err(_) => unanchored += 1,
        }
    }
    Ok(unanchored)
}

fn well_known(pose: Pose2) -> InitialPose {
    InitialPose {
        pose,
        sigma_xy_m: 0.01,
        sigma_theta_rad: 0.002,
    }
}

/// Counts, and returns the changes that were missed.
fn judge<'a>(
    findings: &[Finding],
    truth: &'a [ChangeEvent],
    reach_m: f64,
    score: &mut Score,
) -> impl Iterator<Item = &'a ChangeEvent> {
    let fits = |finding: &Finding, event: &ChangeEvent| {
        finding.kind == event.kind && gap_m(&finding.region, &event.shape) <= reach_m
    };
    let (found, missed): (Vec<_>, Vec<_>) = truth
        .iter()
        .partition(|event| findings.iter().any(|f| fits(f, event)));
    score.events += truth.len();
    score.found += found.len();
    for finding in findings {
        match finding.kind {
            ChangeKind::VehicleSuspect => score.suspected += 1,
            ChangeKind::MapMismatch => score.mismatches += 1,
            _ => {
                score.findings += 1;
                score.true_findings += usize::from(truth.iter().any(|e| fits(finding, e)));
            }
        }
    }
    missed.into_iter()
}

/// From a region's outline and corners to a shape, to the centimetre.
fn gap_m(region: &[Vector2<f64>], shape: &Shape) -> f64 {
    let sides = (0..region.len()).map(|k| (region[k], region[(k + 1) % region.len()]));
    let points = sides.flat_map(|(a, b)| {
        let steps = ((b - a).norm() / 0.01).ceil().max(1.0) as usize;
        (0..steps).map(move |k| a + (b - a) * (k as f64 / steps as f64))
    });
    points
        .map(|point| {
            if shape.contains(&point) {
                0.0
            } else {
                shape.distance_to(&point)
            }
        })
        .fold(f64::INFINITY, f64::min)
}
