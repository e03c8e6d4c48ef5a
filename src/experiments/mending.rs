//! Whether a map mends itself where a segment of a lap was laid wrong.
//!
//! Four laps through a simulated world that changes after the second, each a trip of its own. A part
//! of the third lap is displaced on purpose once that lap is mapped: by false closures, or without
//! any. The same is done with a map that is not mended, and with a sound one.

use std::collections::BTreeSet;

use rayon::iter::{IntoParallelIterator, ParallelIterator};
use serde::Serialize;

use super::alert::ScoredAlert;
use super::recording::Recording;
use super::route::{Route, RouteAlert, RouteRun};
use super::scoring::reach_m;
use super::table::Table;
use super::world_conditions::{Condition, LAPS, LAPS_BEFORE, PLAIN, WorldKind};
use super::world_scoring::{WorldChange, reports, world_changes};
use super::worlds::{Setting, recordings_of};
use crate::change::ChangeKind;
use crate::geometry::Vector2;
use crate::ids::{NodeId, StampNs, TripId};
use crate::mapping::{Keyframe, RouteMap};
use crate::sim::SimScan;

/// How a part of a lap comes to lie in the wrong place.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Displacement {
    /// Its closures say so, and its odometry at both ends.
    FalseClosures,
    /// Its odometry at both ends says so, and it has no closures.
    NoClosures,
    /// It does not.
    None,
}

impl Displacement {
    /// All of them, in the order of the table.
    pub const ALL: [Self; 3] = [Self::FalseClosures, Self::NoClosures, Self::None];

    fn name(self) -> &'static str {
        match self {
            Self::FalseClosures => "false closures",
            Self::NoClosures => "no closures",
            Self::None => "sound",
        }
    }
}

/// What became of one case.
#[derive(Debug, Clone, Serialize)]
pub struct MendingCase {
    /// How the segment was displaced.
    pub displacement: Displacement,
    /// The world.
    pub world: &'static str,
    /// How it was drawn.
    pub seed: u64,
    /// By which the segment was displaced, metres.
    pub by_m: f64,
    /// Whether a mismatch was found there.
    pub found: bool,
    /// Segments that were moved.
    pub mendings: usize,
    /// With a map that is not mended.
    pub before: Outcome,
    /// With one that is.
    pub after: Outcome,
}

/// What mending does to recordings of which no truth is known.
#[derive(Debug, Clone, Serialize)]
pub struct MendedRecordings {
    /// Segments that were moved: when they begin (seconds), by how much they were moved (metres),
    /// by how many closures, and how many edges were quarantined.
    pub mendings: Vec<(f64, [f64; 2], usize, usize)>,
    /// Open alerts of a map that is not mended: kind and place.
    pub alerts_before: Vec<(&'static str, [f64; 2])>,
    /// Of one that is.
    pub alerts_after: Vec<(&'static str, [f64; 2])>,
    /// CPU time of both maps, seconds.
    pub cpu_s: [f64; 2],
}

/// Maps recordings twice, the second time mending what can be mended.
///
/// # Errors
/// If a scan does not fit its lidar, or the graph refuses an id.
pub fn measure_mended_recordings(recordings: &[Recording]) -> anyhow::Result<MendedRecordings> {
    let run = |mends: bool| -> anyhow::Result<RouteRun> {
        let mut route = Route::new();
        route.mends = mends;
        for recording in recordings {
            route.drive(recording, true)?;
        }
        Ok(route.finish(recordings))
    };
    let (before, after) = (run(false)?, run(true)?);
    let alerts = |run: &RouteRun| -> Vec<(&'static str, [f64; 2])> {
        let open = run.open_alerts().into_iter();
        open.map(|a| (a.kind.name(), a.location.into())).collect()
    };
    let mendings = after.mendings.iter().map(|mending| {
        let begins_s = mending.mismatch.since.seconds();
        let (closures, quarantined) = (mending.closures.len(), mending.quarantined.len());
        (begins_s, mending.shift.into(), closures, quarantined)
    });
    Ok(MendedRecordings {
        mendings: mendings.collect(),
        alerts_before: alerts(&before),
        alerts_after: alerts(&after),
        cpu_s: [before.cpu_s, after.cpu_s],
    })
}

/// How a map ends.
#[derive(Debug, Clone, Copy, Default, Serialize)]
pub struct Outcome {
    /// How far the keyframes of the segment are from the truth, median, metres, …
    pub error_m: f64,
    /// … and the farthest.
    pub worst_m: f64,
    /// How far the farthest of all others is, metres.
    pub others_worst_m: f64,
    /// Changes that were seen and are reported, …
    pub changes_found: usize,
    /// … of all of these.
    pub changes: usize,
    /// Open alerts of changes where nothing changed.
    pub false_alerts: usize,
    /// Open mismatches.
    pub mismatches: usize,
}

const WORLDS: [WorldKind; 4] = [
    WorldKind::Hall,
    WorldKind::Racks,
    WorldKind::Rooms,
    WorldKind::Street,
];
/// The lap that is displaced.
const DISPLACED_LAP: usize = LAPS_BEFORE;

/// Runs `seeds` seeds of every displacement in every world; calls `after_run` after each case.
///
/// # Errors
/// If a world has no route, or its scans no map.
pub fn measure_mending(
    displacements: &[Displacement],
    seeds: std::ops::Range<u64>,
    after_run: impl Fn() + Sync,
) -> anyhow::Result<Vec<MendingCase>> {
    let mut cases = Vec::new();
    for &displacement in displacements {
        for world in WORLDS {
            cases.extend(seeds.clone().map(|seed| (displacement, world, seed)));
        }
    }
    let run_one = |(displacement, world, seed)| {
        let case = run(displacement, world, seed);
        after_run();
        case
    };
    cases.into_par_iter().map(run_one).collect()
}

/// What is done to a lap.
struct Displaced {
    trip: TripId,
    /// The first and the last scan of the segment.
    stamps: [StampNs; 2],
    by: Vector2<f64>,
}

/// A case with its truth.
struct Truth<'a> {
    recordings: &'a [Recording],
    laps: &'a [Vec<&'a SimScan>],
    changes: &'a [WorldChange],
    reach_m: f64,
}

fn run(displacement: Displacement, world: WorldKind, seed: u64) -> anyhow::Result<MendingCase> {
    let condition = Condition {
        trip_a_lap: true,
        ..PLAIN
    };
    let setting = Setting::of(world, &condition, seed)?;
    let fleet = condition.fleet();
    let drives = setting.drive(&fleet, seed);
    let recordings = recordings_of(&fleet, &drives, true)?;
    let of_lap = |lap| drives.iter().flatten().filter(move |scan| scan.lap == lap);
    let laps: Vec<Vec<&SimScan>> = LAPS.map(|lap| of_lap(lap).collect()).collect();
    let visible = setting.scene.visible_changes(drives.iter().flatten());
    let mut changes = world_changes(&setting.scene, LAPS);
    changes.retain(|change| {
        let mut visible = visible.iter();
        visible.any(|event| (event.object, event.kind) == (change.object, change.kind))
    });
    let sigmas_m = fleet.iter().map(|v| v.lidar.geometry.range_sigma_m);
    let truth = Truth {
        recordings: &recordings,
        laps: &laps,
        changes: &changes,
        reach_m: reach_m(sigmas_m.fold(0.0, f64::max)),
    };
    let displaced = displaced(&recordings[DISPLACED_LAP], seed)?;
    let (unmended, before) = one_map(&truth, &displaced, displacement, false)?;
    let (mended, after) = one_map(&truth, &displaced, displacement, true)?;
    let is_there = |alert: &RouteAlert| {
        let evidence = &alert.state.evidence;
        evidence.kind == ChangeKind::MapMismatch && evidence.trips.contains(&displaced.trip)
    };
    Ok(MendingCase {
        displacement,
        world: world.name(),
        seed,
        by_m: displaced.by.norm(),
        found: unmended.alerts.iter().any(is_there),
        mendings: mended.mendings.len(),
        before,
        after,
    })
}

/// From a quarter to a third of the lap, by 0.3 to 0.6 m in any direction.
fn displaced(recording: &Recording, seed: u64) -> anyhow::Result<Displaced> {
    let scans = recording.scans.len();
    let share = |salt: u64| {
        let mixed = (seed + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15 ^ salt.wrapping_mul(0xD1B5_4A32));
        ((mixed >> 40) % 1_000) as f64 / 1_000.0
    };
    let first = (scans as f64 * (0.2 + 0.4 * share(1))) as usize;
    let count = (scans as f64 * (0.25 + 0.08 * share(2))) as usize;
    let (sin, cos) = (std::f64::consts::TAU * share(3)).sin_cos();
    Ok(Displaced {
        trip: recording.trip.clone(),
        stamps: [first, first + count].map(|k| recording.scans[k].stamp),
        by: Vector2::new(cos, sin) * (0.3 + 0.3 * share(4)),
    })
}

fn one_map(
    truth: &Truth<'_>,
    displaced: &Displaced,
    displacement: Displacement,
    mends: bool,
) -> anyhow::Result<(RouteRun, Outcome)> {
    let mut route = Route::new();
    route.mends = mends;
    for (lap, recording) in truth.recordings.iter().enumerate() {
        if lap != DISPLACED_LAP || displacement == Displacement::None {
            route.drive(recording, true)?;
            continue;
        }
        route.drive_unasked(recording)?;
        route.replace_map(|map| displace(map, displaced, displacement))?;
    }
    let run = route.finish(truth.recordings);
    let outcome = outcome(truth, displaced, &run);
    Ok((run, outcome))
}

/// The map with a segment in the wrong place, and edges that agree with it.
fn displace(
    map: &RouteMap,
    displaced: &Displaced,
    displacement: Displacement,
) -> anyhow::Result<RouteMap> {
    let is_of_segment = |keyframe: &Keyframe| {
        let [first, last] = displaced.stamps;
        keyframe.trip == displaced.trip && (first..=last).contains(&keyframe.stamp)
    };
    let keyframes = map.keyframes().iter();
    let moved: BTreeSet<NodeId> = keyframes
        .filter(|keyframe| is_of_segment(keyframe))
        .map(|keyframe| keyframe.node)
        .collect();
    let keeps_closures = displacement == Displacement::FalseClosures;
    Ok(map.falsified(&moved, &displaced.by, keeps_closures)?)
}

fn outcome(truth: &Truth<'_>, displaced: &Displaced, run: &RouteRun) -> Outcome {
    let (mut errors_m, mut others_worst_m) = (Vec::new(), 0.0_f64);
    for (lap, recording) in truth.recordings.iter().enumerate() {
        for (scan, there) in recording.scans.iter().zip(&truth.laps[lap]) {
            let Some(pose) = run.poses.get(&scan.stamp) else {
                continue;
            };
            let off_m = (pose.translation() - there.map_from_base.translation()).norm();
            let [first, last] = displaced.stamps;
            match (first..=last).contains(&scan.stamp) {
                true => errors_m.push(off_m),
                false => others_worst_m = others_worst_m.max(off_m),
            }
        }
    }
    errors_m.sort_by(f64::total_cmp);
    let alerts = run.open_alerts();
    let mismatches = alerts.iter().filter(|a| a.kind == ChangeKind::MapMismatch);
    let reported = alerts.iter().filter(|a| a.kind.is_of_state());
    let is_false = |alert: &&ScoredAlert| {
        let mut changes = truth.changes.iter();
        !changes.any(|change| reports(alert, change, truth.reach_m))
    };
    let is_found = |change: &&WorldChange| {
        let mut alerts = alerts.iter();
        alerts.any(|alert| reports(alert, change, truth.reach_m))
    };
    Outcome {
        error_m: errors_m
            .get(errors_m.len() / 2)
            .copied()
            .unwrap_or_default(),
        worst_m: errors_m.last().copied().unwrap_or_default(),
        others_worst_m,
        changes_found: truth.changes.iter().filter(is_found).count(),
        changes: truth.changes.len(),
        false_alerts: reported.filter(is_false).count(),
        mismatches: mismatches.count(),
    }
}

/// A row for each displacement and world.
pub fn mending_text(cases: &[MendingCase]) -> String {
    let mut table = Table::new(
        "Segments of 0.3 to 0.6 m beside their place",
        &[
            "displaced by",
            "world",
            "cases",
            "found",
            "mended",
            "error before, median m",
            "after",
            "worst after",
            "others' worst before",
            "after",
            "changes found before",
            "after",
            "false alerts before",
            "after",
            "mismatches before",
            "after",
        ],
    );
    for displacement in Displacement::ALL {
        for world in WORLDS {
            let of_row =
                |c: &&MendingCase| c.displacement == displacement && c.world == world.name();
            let row: Vec<&MendingCase> = cases.iter().filter(of_row).collect();
            if row.is_empty() {
                continue;
            }
            let sum = |value: fn(&MendingCase) -> usize| -> usize {
                row.iter().map(|case| value(case)).sum()
            };
            let sorted = |value: fn(&MendingCase) -> f64| {
                let mut values: Vec<f64> = row.iter().map(|case| value(case)).collect();
                values.sort_by(f64::total_cmp);
                values
            };
            let median = |value| format!("{:.3}", sorted(value)[row.len() / 2]);
            let worst = |value| format!("{:.3}", sorted(value)[row.len() - 1]);
            let changes = sum(|c| c.before.changes);
            table.row([
                displacement.name().to_owned(),
                world.name().to_owned(),
                row.len().to_string(),
                sum(|c| usize::from(c.found)).to_string(),
                sum(|c| usize::from(c.mendings > 0)).to_string(),
                median(|c| c.before.error_m),
                median(|c| c.after.error_m),
                worst(|c| c.after.worst_m),
                worst(|c| c.before.others_worst_m),
                worst(|c| c.after.others_worst_m),
                format!("{} of {changes}", sum(|c| c.before.changes_found)),
                format!("{} of {changes}", sum(|c| c.after.changes_found)),
                sum(|c| c.before.false_alerts).to_string(),
                sum(|c| c.after.false_alerts).to_string(),
                sum(|c| c.before.mismatches).to_string(),
                sum(|c| c.after.mismatches).to_string(),
            ]);
        }
    }
    table.text()
}
