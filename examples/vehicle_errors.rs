//! What becomes of simulated vehicles that are not as stated: when their trips are sure of what is
//! off, what is left of it, and what that does to a map.
//!
//! `cargo run --release --example vehicle_errors -- words FIRST_SEED VEHICLES LAPS` drives vehicles that
//! are off and sound ones, in halls and rooms, with errors for each beam alone and with errors that a
//! lap shares; every lap is a trip. `… -- maps FIRST_SEED VEHICLES` maps laps in a hall that changes,
//! with the corrections and without, and with the beam spacing corrected, which the service does not.

use std::collections::BTreeMap;
use std::io::Write;
use std::sync::Arc;

use anyhow::{Context, bail};
use mapshift::calibration::{
    CalibratedTrip, Corrections, Estimates, Quantity, TripCalibration, TripScan, VehicleCalibration,
};
use mapshift::change::Finding;
use mapshift::experiments::{OffVehicle, region_distance_m};
use mapshift::geometry::Pose2;
use mapshift::ids::{StampNs, TripId};
use mapshift::mapping::{
    Drive, DriveScan, InitialPose, LidarOfVehicle, RouteMap, Scope, Sites, Weighting,
};
use mapshift::sim::{ChangeEvent, Changes, Hall, PassErrors, Rooms, Scene, SimScan};
use rayon::iter::{IntoParallelIterator, ParallelIterator};

const OFF: [Quantity; 7] = [
    Quantity::MountYaw,
    Quantity::MountX,
    Quantity::MountY,
    Quantity::WayScale,
    Quantity::TurnScale,
    Quantity::TurnPerMetre,
    Quantity::BeamSpacing,
];
/// Of the laps of a map the world changes before this one, counted from 0; and of so many.
const CHANGES_AT: usize = 7;
const LAPS: usize = 9;
/// From the start of a lap to that of the next, seconds.
const LAP_PAUSE_S: f64 = 10_000.0;
const BATCH_SCANS: usize = 60;
const REMOVED: usize = 2;
const ADDED: usize = 4;
const AREA_SHARE: f64 = 0.3;
/// A finding is of a change if its region is no farther from it, metres.
const REACH_M: f64 = 0.35;

fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let number = |k: usize| -> anyhow::Result<u64> {
        let text = arguments.get(k).context("see the head of this file")?;
        Ok(text.parse()?)
    };
    match arguments.first().map(String::as_str) {
        Some("words") => words(number(1)?, number(2)?, number(3)? as usize),
        Some("maps") => maps(number(1)?, number(2)?),
        _ => bail!("words or maps"),
    }
}

fn world(name: &str, seed: u64) -> anyhow::Result<Scene> {
    Ok(match name {
        "hall" => Scene::of_hall(&Hall::generate(seed)?, seed),
        _ => Rooms::generate(seed)?.scene,
    })
}

fn word(lap: usize, scans: &[TripScan]) -> anyhow::Result<CalibratedTrip> {
    Ok(CalibratedTrip {
        trip: TripId::new(format!("{lap}"))?,
        stamp: scans.last().map_or(StampNs(0), |scan| scan.stamp),
        scans: scans.len() as u32,
        calibration: TripCalibration::of_scans(scans),
    })
}

/// What became of one vehicle, after each of its laps.
struct Told {
    truth: Corrections,
    sure: Vec<Estimates>,
    /// Laps with a vehicle that would be suspected.
    alerts: usize,
}

fn words(first: u64, vehicles: u64, laps: usize) -> anyhow::Result<()> {
    let mut console = std::io::stdout();
    for name in ["hall", "rooms"] {
        for (condition, pass_errors) in [
            ("each beam errs alone", PassErrors::NONE),
            ("a lap errs together", PassErrors::AS_RECORDED),
        ] {
            for (kind, off) in [("sound", &[][..]), ("off", &OFF)] {
                let told = (first..first + vehicles).into_par_iter();
                let told = told.map(|seed| tell(name, pass_errors, off, seed, laps));
                let told: Vec<Told> = told.collect::<anyhow::Result<_>>()?;
                let alerts: usize = told.iter().map(|told| told.alerts).sum();
                writeln!(
                    console,
                    "{name}, {condition}: {vehicles} vehicles that are {kind}, {laps} laps: \
                     {alerts} alerts"
                )?;
                for quantity in Quantity::ALL {
                    row(&mut console, quantity, &told)?;
                }
            }
        }
    }
    Ok(())
}

fn row(console: &mut impl Write, quantity: Quantity, told: &[Told]) -> anyhow::Result<()> {
    let truth = |told: &Told| told.truth.get(quantity);
    let worth = told.iter();
    let worth = worth.filter(|told| truth(told).abs() >= quantity.applied_min());
    let (mut after, mut left, mut wrong): (Vec<usize>, Vec<f64>, usize) = Default::default();
    for told in told {
        let sure = told.sure.iter().enumerate();
        let mut sure = sure.filter_map(|(lap, sure)| Some((lap + 1, sure.get(&quantity)?.value)));
        let Some((lap, value)) = sure.next() else {
            continue;
        };
        let values: Vec<f64> = std::iter::once(value).chain(sure.map(|(_, v)| v)).collect();
        let off = |value: &f64| (value - truth(told)).abs();
        wrong += usize::from(values.iter().any(|value| off(value) >= truth(told).abs()));
        after.push(lap);
        left.push(values.last().map_or(0.0, off));
    }
    left.sort_by(f64::total_cmp);
    after.sort_unstable();
    let at = |share: f64| left.get((share * left.len() as f64) as usize).copied();
    writeln!(
        console,
        "  {quantity:?}: {} worth it, {} corrected, after {} to {} laps (median {}), wrongly {wrong}; \
         left {:.5} (median), {:.5} (90 %)",
        worth.count(),
        after.len(),
        after.first().unwrap_or(&0),
        after.last().unwrap_or(&0),
        after.get(after.len() / 2).unwrap_or(&0),
        at(0.5).unwrap_or_default(),
        at(0.9).unwrap_or_default(),
    )?;
    Ok(())
}

fn tell(
    name: &str,
    pass_errors: PassErrors,
    off: &[Quantity],
    seed: u64,
    laps: usize,
) -> anyhow::Result<Told> {
    let scene = world(name, seed)?;
    let off = OffVehicle::drawn(off, seed).with_pass_errors(pass_errors);
    let (mut trips, mut sure, mut alerts) = (Vec::new(), Vec::new(), 0);
    for lap in 1..=laps {
        let driven = scene.drive(&off.vehicle, lap..lap + 1, seed);
        let scans = off.sent(&driven, LAP_PAUSE_S * lap as f64)?;
        trips.push(word(lap, &scans)?);
        let known = VehicleCalibration::of(trips.clone());
        let mut values = known.sure();
        values.extend(known.uncorrected());
        sure.push(values);
        let (_, faults) = known.lasting_faults();
        alerts += usize::from(
            !(known.changes().is_empty() && known.unsteady().is_empty() && faults.is_empty()),
        );
    }
    Ok(Told {
        truth: off.truth,
        sure,
        alerts,
    })
}

/// What came of a map, of the laps from the fifth on.
#[derive(Default)]
struct Mapped {
    /// How far motions of a metre or so are off, metres and radians.
    errors: Vec<[f64; 2]>,
    found: usize,
    changes: usize,
    false_before: usize,
    false_after: usize,
    not_merged: usize,
}

fn maps(first: u64, vehicles: u64) -> anyhow::Result<()> {
    let mut console = std::io::stdout();
    let all_but_spacing = &OFF[..6];
    for (what, off) in [
        ("mount and wheels off", all_but_spacing),
        ("beam spacing off", &[Quantity::BeamSpacing][..]),
        ("sound", &[]),
    ] {
        for corrects in [false, true] {
            let runs = (first..first + vehicles).into_par_iter();
            let runs = runs.map(|seed| map(off, seed, corrects));
            let runs: Vec<Mapped> = runs.collect::<anyhow::Result<_>>()?;
            let sum = |of: fn(&Mapped) -> usize| runs.iter().map(of).sum::<usize>();
            let median = |k: usize| {
                let mut of: Vec<f64> = runs.iter().flat_map(|r| &r.errors).map(|e| e[k]).collect();
                of.sort_by(f64::total_cmp);
                [of[of.len() / 2], of[of.len() * 9 / 10]]
            };
            writeln!(
                console,
                "{what}, {}: motions of a metre off by {:.4?} m, {:.4?} rad (median, 90 %); found {} \
                 of {} changes, {} false before the change, {} after; {} batches not merged",
                if corrects { "corrected" } else { "as stated" },
                median(0),
                median(1),
                sum(|run| run.found),
                sum(|run| run.changes),
                sum(|run| run.false_before),
                sum(|run| run.false_after),
                sum(|run| run.not_merged),
            )?;
        }
    }
    Ok(())
}

fn map(off: &[Quantity], seed: u64, corrects: bool) -> anyhow::Result<Mapped> {
    let mut scene = world("hall", seed)?;
    let mut changes = Changes::new(&mut scene, CHANGES_AT, 0.5, seed);
    changes.remove(REMOVED);
    changes.add(ADDED, AREA_SHARE);
    let off = OffVehicle::drawn(off, seed);
    let mut map = RouteMap::new(Weighting::Robust);
    let mut mapped = Mapped::default();
    let (mut trips, mut driven, mut pending) = (Vec::new(), Vec::new(), Vec::new());
    let mut at: BTreeMap<StampNs, Pose2> = BTreeMap::new();
    for lap in 0..LAPS {
        let simulated = scene.drive(&off.vehicle, lap..lap + 1, seed);
        let scans = off.sent(&simulated, LAP_PAUSE_S * lap as f64)?;
        let poses = scans.iter().zip(&simulated);
        at.extend(poses.map(|(scan, truly)| (scan.stamp, truly.map_from_base)));
        let corrections = match corrects {
            true => {
                let known = VehicleCalibration::of(trips.clone());
                let mut values = known.sure();
                values.extend(known.uncorrected());
                Corrections::of(&values)
            }
            false => Corrections::default(),
        };
        mapped.not_merged += extend(&mut map, lap, &scans, &simulated, &corrections)?;
        trips.push(word(lap, &scans)?);
        driven.extend(simulated);
        pending = findings(&mut map, &pending);
        if lap + 1 == CHANGES_AT {
            mapped.false_before = pending.iter().filter(|f| stands(f)).count();
        }
    }
    let events = scene.visible_changes(&driven);
    let reports = |finding: &&Finding, event: &ChangeEvent| {
        let other = finding.counterpart.as_ref();
        let sides = std::iter::once((finding.kind, &finding.region));
        let mut sides = sides.chain(other.map(|other| (other.kind, &other.region)));
        sides.any(|(kind, region)| {
            kind == event.kind && region_distance_m(&event.shape, region) <= REACH_M
        })
    };
    let standing: Vec<&Finding> = pending.iter().filter(|f| stands(f)).collect();
    mapped.changes = events.len();
    let is_found = |event: &&ChangeEvent| standing.iter().any(|f| reports(f, event));
    mapped.found = events.iter().filter(is_found).count();
    let changed = scene.objects.iter();
    let changed = changed.filter(|object| object.from_lap > 0 || object.until_lap.is_some());
    let changed: Vec<_> = changed.map(|object| &object.shape).collect();
    let is_false = |finding: &&&Finding| {
        let is_near = |shape| region_distance_m(shape, &finding.region) <= REACH_M;
        !changed.iter().any(|shape| is_near(shape))
    };
    mapped.false_after = standing.iter().filter(is_false).count();
    mapped.errors = motions_off(&map, &at);
    Ok(mapped)
}

fn stands(finding: &Finding) -> bool {
    finding.until.is_none() && finding.kind.is_of_state()
}

/// Adds a lap; returns how many batches never found a place.
fn extend(
    map: &mut RouteMap,
    lap: usize,
    scans: &[TripScan],
    simulated: &[SimScan],
    corrections: &Corrections,
) -> anyhow::Result<usize> {
    let mut not_merged = 0;
    for (number, batch) in scans.chunks(BATCH_SCANS).enumerate() {
        let seen = batch.iter().map(|scan| {
            let lidar = corrections.lidar(scan.scan.lidar(), scan.scan.beam_count())?;
            anyhow::Ok(DriveScan {
                stamp: scan.stamp,
                odom_from_base: scan.odom_from_base,
                beam_interval_s: 0.0,
                lidar: LidarOfVehicle::default(),
                scan: corrections.scan(&scan.scan, &Arc::new(lidar))?,
            })
        });
        let drive = Drive {
            trip: TripId::new(format!("{lap}"))?,
            initial_pose: (lap + number == 0).then(|| InitialPose {
                pose: simulated[0].map_from_base,
                sigma_xy_m: 0.01,
                sigma_theta_rad: 0.002,
            }),
            scans: seen.collect::<anyhow::Result<_>>()?,
            wheels: *corrections,
        };
        not_merged += usize::from(map.extend(&drive).is_err());
    }
    Ok(not_merged)
}

fn findings(map: &mut RouteMap, pending: &[Finding]) -> Vec<Finding> {
    map.findings(&Scope {
        sites: Sites::Touched,
        pending,
        false_alerts_per_lap: 0.01,
        accepted: &[],
        vehicles: &BTreeMap::new(),
        suspects: &[],
    })
}

/// How far each motion from a keyframe to the next but one is off, of the laps that may be corrected.
fn motions_off(map: &RouteMap, at: &BTreeMap<StampNs, Pose2>) -> Vec<[f64; 2]> {
    let mut by_trip: BTreeMap<&TripId, Vec<(StampNs, Pose2)>> = BTreeMap::new();
    for (keyframe, node) in map.keyframes().iter().zip(map.graph().nodes()) {
        let poses = by_trip.entry(&keyframe.trip).or_default();
        poses.push((keyframe.stamp, node.pose));
    }
    let corrected = by_trip.into_iter();
    let corrected =
        corrected.filter(|(trip, _)| trip.as_str().parse().is_ok_and(|lap: usize| lap >= 4));
    let motions = corrected.flat_map(|(_, poses)| {
        let off = poses.windows(3).filter_map(|three| {
            let (from, to) = (three[0], three[2]);
            let truly = at.get(&from.0)?.between(at.get(&to.0)?);
            let off = truly.between(&from.1.between(&to.1));
            Some([off.translation().norm(), off.theta.abs()])
        });
        off.collect::<Vec<_>>()
    });
    motions.collect()
}
