//! Whether poses are as uncertain as they say.
//!
//! Simulated vehicles drive through worlds in which nothing changes, and the error of every
//! keyframe is compared with what the map says of it.

use std::collections::BTreeMap;
use std::ops::Range;

use rayon::iter::{IntoParallelIterator, ParallelIterator};

use super::route::MapRun;
use super::table::Table;
use super::world_conditions::{CORRELATED, Condition, PLAIN, WorldKind};
use super::worlds::{Setting, recordings_of};
use crate::geometry::{Pose2, wrap_angle};
use crate::ids::StampNs;

/// What is driven.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Way {
    /// Three laps, one after the other.
    Laps,
    /// The first seven tenths of one: a chain that closes nowhere where nothing is passed twice.
    Open,
}

/// Laps of a closed way.
const LAPS: usize = 3;
/// Share of a lap's scans of an open one.
const OPEN_SHARE: f64 = 0.7;

/// Errors of poses beside what the map says of them, over some seeds.
#[derive(Debug, Clone)]
pub struct PoseConsistency {
    world: &'static str,
    condition: &'static str,
    way: Way,
    /// Of each keyframe but the first, errors of x, y (metres) and θ (radians), …
    errors: Vec<[f64; 3]>,
    /// … and their standard deviations.
    sigmas: Vec<[f64; 3]>,
    keyframes_without: usize,
}

/// Drives through every world with some seeds; a row for each world, condition and way.
///
/// # Errors
/// If a world has no route, or its scans no map.
pub fn measure_pose_consistency(seeds: &Range<u64>) -> anyhow::Result<Vec<PoseConsistency>> {
    let mut rows = Vec::new();
    for condition in [PLAIN, CORRELATED] {
        for way in [Way::Laps, Way::Open] {
            let worlds = condition.worlds.iter();
            rows.extend(worlds.map(|&world| (world, condition, way)));
        }
    }
    let of_row = |(world, condition, way)| {
        let runs = seeds.clone().into_par_iter();
        let runs: Vec<PoseConsistency> = runs
            .map(|seed| run(world, condition, way, seed))
            .collect::<anyhow::Result<_>>()?;
        let mut runs = runs.into_iter();
        let first = runs.next();
        let first = first.ok_or_else(|| anyhow::anyhow!("there are no seeds"))?;
        Ok(runs.fold(first, PoseConsistency::and))
    };
    rows.into_iter().map(of_row).collect()
}

fn run(
    world: WorldKind,
    condition: Condition,
    way: Way,
    seed: u64,
) -> anyhow::Result<PoseConsistency> {
    let condition = Condition {
        changes: 0,
        trip_a_lap: true,
        ..condition
    };
    let setting = Setting::of(world, &condition, seed)?;
    let fleet = condition.fleet();
    let drives = setting.drive(&fleet, seed);
    let mut recordings = recordings_of(&fleet, &drives, true)?;
    let mut truth: BTreeMap<StampNs, Pose2> = BTreeMap::new();
    for (lap, recording) in recordings.iter().enumerate() {
        let of_lap = drives.iter().flatten().filter(|scan| scan.lap == lap);
        let poses = of_lap.map(|scan| scan.map_from_base);
        truth.extend(recording.scans.iter().map(|scan| scan.stamp).zip(poses));
    }
    match way {
        Way::Laps => recordings.truncate(LAPS),
        Way::Open => {
            recordings.truncate(1);
            for recording in &mut recordings {
                let count = OPEN_SHARE * recording.scans.len() as f64;
                recording.scans.truncate(count as usize);
            }
        }
    }
    let map = MapRun::of(&recordings)?;
    let mut row = PoseConsistency {
        world: world.name(),
        condition: condition.name,
        way,
        errors: Vec::new(),
        sigmas: Vec::new(),
        keyframes_without: 0,
    };
    // The first keyframe is where the frame of the map is.
    for (stamp, pose) in map.keyframes.iter().skip(1) {
        let (Some(there), Some(sigma)) = (truth.get(stamp), map.sigmas.get(stamp)) else {
            row.keyframes_without += 1;
            continue;
        };
        let off = pose.translation() - there.translation();
        row.errors
            .push([off.x, off.y, wrap_angle(pose.theta - there.theta)]);
        row.sigmas.push([sigma.x_m, sigma.y_m, sigma.theta_rad]);
    }
    Ok(row)
}

impl PoseConsistency {
    fn and(mut self, other: Self) -> Self {
        self.errors.extend(other.errors);
        self.sigmas.extend(other.sigmas);
        self.keyframes_without += other.keyframes_without;
        self
    }

    /// Errors divided by their standard deviations, of x, y and θ alike.
    fn normalised(&self) -> Vec<f64> {
        let pairs = self
            .errors
            .iter()
            .flatten()
            .zip(self.sigmas.iter().flatten());
        pairs.map(|(error, sigma)| error / sigma).collect()
    }

    fn cells(&self) -> [String; 9] {
        let position_m = |of: &[[f64; 3]]| {
            let mut all: Vec<f64> = of.iter().map(|[x, y, _]| x.hypot(*y)).collect();
            all.sort_by(f64::total_cmp);
            all.get(all.len() / 2).copied().unwrap_or(f64::NAN)
        };
        let normalised = self.normalised();
        let count = normalised.len() as f64;
        let within = |sigmas: f64| {
            let inside = normalised.iter().filter(|z| z.abs() <= sigmas).count();
            inside as f64 / count
        };
        let squares: f64 = normalised.iter().map(|z| z * z).sum();
        [
            self.world.to_owned(),
            self.condition.to_owned(),
            format!("{:?}", self.way).to_lowercase(),
            format!("{} + {}", self.errors.len(), self.keyframes_without),
            format!("{:.3}", position_m(&self.errors)),
            format!("{:.3}", position_m(&self.sigmas)),
            format!("{:.2}", within(2.0)),
            format!("{:.2}", within(3.0)),
            format!("{:.2}", squares / count),
        ]
    }
}

/// A row for each world, condition and way.
pub fn pose_consistency_text(rows: &[PoseConsistency]) -> String {
    let mut table = Table::new(
        "Errors of poses beside their standard deviations",
        &[
            "world",
            "condition",
            "way",
            "keyframes, + without",
            "error, median m",
            "sigma, median m",
            "within 2σ",
            "within 3σ",
            "mean square / σ²",
        ],
    );
    for row in rows {
        table.row(row.cells());
    }
    table.text()
}
