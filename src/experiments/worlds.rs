//! What the service finds in simulated worlds that are harder than the paper's halls.
//!
//! Fleets drive through worlds that change half-way, one map is made of each, and its alerts are
//! compared with what truly changed. Every trip but the very first is localised by search.

use std::collections::BTreeSet;
use std::sync::Arc;

use rayon::iter::{IntoParallelIterator, ParallelIterator};
use serde::Serialize;

use super::alert::ScoredAlert;
use super::correlation::Correlation;
use super::recording::Recording;
use super::route::RouteRun;
use super::scoring::reach_m;
use super::world_conditions::WorldKind;
use super::world_conditions::{CONDITIONS, CORRELATED, Condition, LAPS, LAPS_BEFORE, PLAIN};
use super::world_scoring::{WorldChange, WorldScore, world_changes};
use crate::change::ChangeKind;
use crate::ids::{StampNs, TripId};
use crate::ingest::RecordedScan;
use crate::sim::{Changes, Hall, Rooms, Scene, SimScan, Vehicle};

/// A scan observes an object with this many of its beams.
const BEAMS_MIN: usize = 3;
/// This many scans must observe a place in each of its states.
const SCANS_MIN: usize = 4;
/// From the start of a vehicle's lap to that of the next one's, seconds.
const LAP_PAUSE_S: f64 = 10_000.0;
/// What comes is so large, as a share of the mean area of what stands free.
const AREA_SHARE: f64 = 0.3;
/// Of this many doors one stands ajar in a lap, by an angle of this standard deviation, radians.
const AJAR_EVERY: u32 = 4;
const AJAR_SIGMA_RAD: f64 = 0.12;
/// Streams of random numbers for what passes, apart from those of what stays.
const PASSING_SEED: u64 = 1 << 40;

/// What came out, a row for each world and condition.
#[derive(Debug, Clone, Serialize)]
pub struct WorldsStudy {
    /// The first seed …
    pub first_seed: u64,
    /// … of all of these.
    pub seeds: u64,
    /// In the order of the conditions.
    pub rows: Vec<WorldRow>,
    /// How far observations of one pass err together, by world: one vehicle without, and then
    /// with errors as in recordings.
    pub correlations: Vec<NamedCorrelation>,
}

/// A world under a condition, over all seeds.
#[derive(Debug, Clone, Serialize)]
pub struct WorldRow {
    /// The world's name.
    pub world: &'static str,
    /// The condition's.
    pub condition: &'static str,
    /// Over all seeds.
    pub score: WorldScore,
}

/// How far the observations of some drives err together.
#[derive(Debug, Clone, Serialize)]
pub struct NamedCorrelation {
    /// What was driven.
    pub name: String,
    /// As measured.
    pub correlation: Correlation,
}

/// Measures recordings: what their own map keeps of them.
///
/// # Errors
/// If the recordings could not be run.
pub fn measure_correlation(recordings: &[Recording]) -> anyhow::Result<NamedCorrelation> {
    let run = RouteRun::of(recordings, false)?;
    let names: Vec<_> = recordings.iter().map(|r| r.trip.to_string()).collect();
    Ok(NamedCorrelation {
        name: names.join(", "),
        correlation: Correlation::of(recordings, &run)?,
    })
}

/// Worlds that [`score_worlds`] runs.
pub fn world_runs(seeds: u64) -> u64 {
    seeds * rows(&CONDITIONS).count() as u64
}

/// Runs every world and condition with some seeds; calls `after_run` when one more was run.
/// Worlds run side by side; the outcome does not depend on how many.
///
/// # Errors
/// If a world has no route, or its scans no map.
pub fn score_worlds(
    first_seed: u64,
    seeds: u64,
    after_run: impl Fn() + Sync,
) -> anyhow::Result<WorldsStudy> {
    score_conditions(&CONDITIONS, first_seed, seeds, after_run)
}

fn score_conditions(
    conditions: &[Condition],
    first_seed: u64,
    seeds: u64,
    after_run: impl Fn() + Sync,
) -> anyhow::Result<WorldsStudy> {
    let seeds_of = |row| (0..seeds).map(move |k| (row, first_seed + k));
    let runs: Vec<_> = rows(conditions).flat_map(seeds_of).collect();
    let outcomes = runs.into_par_iter().map(|((world, condition), seed)| {
        let outcome = run(world, &condition, seed);
        after_run();
        outcome
    });
    let outcomes: Vec<Outcome> = outcomes.collect::<anyhow::Result<_>>()?;
    let mut study = WorldsStudy {
        first_seed,
        seeds,
        rows: Vec::new(),
        correlations: Vec::new(),
    };
    let mut outcomes = outcomes.into_iter();
    for (world, condition) in rows(conditions) {
        let (mut score, mut correlation) = (WorldScore::default(), Correlation::default());
        for outcome in outcomes.by_ref().take(seeds as usize) {
            score.merge(&outcome.score);
            correlation.merge(&outcome.correlation);
        }
        if is_measured(&condition) {
            study.correlations.push(NamedCorrelation {
                name: format!("{}, {}", world.name(), condition.name),
                correlation,
            });
        }
        study.rows.push(WorldRow {
            world: world.name(),
            condition: condition.name,
            score,
        });
    }
    Ok(study)
}

/// Worlds and conditions, in the order of the table.
fn rows(conditions: &[Condition]) -> impl Iterator<Item = (WorldKind, Condition)> {
    let of_condition = |c: &Condition| {
        let condition = *c;
        c.worlds.iter().map(move |world| (*world, condition))
    };
    conditions.iter().flat_map(of_condition)
}

fn is_measured(condition: &Condition) -> bool {
    [PLAIN.name, CORRELATED.name].contains(&condition.name)
}

struct Outcome {
    score: WorldScore,
    correlation: Correlation,
}

/// A scene, and what passes in it: there for single laps only.
pub(super) struct Setting {
    pub(super) scene: Scene,
    passing: BTreeSet<usize>,
}

impl Setting {
    pub(super) fn of(world: WorldKind, condition: &Condition, seed: u64) -> anyhow::Result<Self> {
        let third = condition.changes / 3;
        let works = condition.works;
        let mut passing = BTreeSet::new();
        let mut scene = match world {
            WorldKind::Hall => Scene::of_hall(&Hall::generate(seed)?, seed),
            WorldKind::Racks => Scene::racks(seed)?,
            WorldKind::Street => Scene::street(seed)?,
            WorldKind::Rooms => {
                let mut rooms = Rooms::generate(seed)?;
                rooms.swing_doors(third + works.doors, LAPS_BEFORE, seed);
                if condition.has_doors_ajar() {
                    let ajar = rooms.leave_ajar(LAPS, AJAR_EVERY, AJAR_SIGMA_RAD, seed);
                    passing.extend(ajar);
                }
                rooms.scene
            }
        };
        let mut first = Changes::new(&mut scene, 0, condition.path_noise_m, seed);
        let walls = first.put_up_walls(works.walls);
        scene.walkers = condition.walkers;
        let mut changes = Changes::new(&mut scene, LAPS_BEFORE, condition.path_noise_m, seed);
        changes.take_down_walls(&walls);
        changes.put_up_walls(walls.len());
        if works.rebuilds_third {
            changes.rebuild_third(seed as usize % 3);
        }
        changes.remove(third);
        changes.add(condition.changes - third, AREA_SHARE);
        for lap in LAPS {
            let seed = seed + PASSING_SEED;
            let mut people = Changes::new(&mut scene, lap, condition.path_noise_m, seed);
            passing.extend(people.bystanders(condition.bystanders));
        }
        Ok(Self { scene, passing })
    }

    pub(super) fn drive(&self, fleet: &[Vehicle], seed: u64) -> Vec<Vec<SimScan>> {
        drive(&self.scene, fleet, seed)
    }
}

fn run(world: WorldKind, condition: &Condition, seed: u64) -> anyhow::Result<Outcome> {
    let setting = Setting::of(world, condition, seed)?;
    let fleet = condition.fleet();
    let drives = setting.drive(&fleet, seed);
    let recordings = recordings_of(&fleet, &drives, condition.trip_a_lap)?;
    let run = RouteRun::of(&recordings, true)?;
    let alerts: Vec<(ScoredAlert, bool)> = (run.alerts.iter())
        .filter(|alert| alert.raised.is_some())
        .map(|alert| (alert.scored(), alert.state.status.is_pending()))
        .collect();
    let sigma_m = fleet.iter().map(|v| v.lidar.geometry.range_sigma_m);
    let reach_m = reach_m(sigma_m.fold(0.0, f64::max));
    let changes = world_changes(&setting.scene, LAPS);
    let mut score = WorldScore {
        laps: LAPS.len() * fleet.len(),
        batches_not_merged: run.batches_not_merged,
        ..WorldScore::default()
    };
    score.add_alerts(&alerts, &changes, reach_m);
    let visible = setting.scene.visible_changes(drives.iter().flatten());
    for change in &changes {
        if setting.passing.contains(&change.object) {
            continue;
        }
        score.changes += 1;
        let is_visible = |event: &crate::sim::ChangeEvent| {
            (event.object, event.kind) == (change.object, change.kind)
        };
        let mut alone = WorldScore::default();
        if visible.iter().any(is_visible) {
            alone.add_change(change, &alerts, reach_m);
        }
        if alone.found.hits > 0
            || alone.found.of > 0 && would_be_observed(&setting.scene, &fleet, seed, change)
        {
            score.merge(&alone);
        } else {
            score.out_of_reach += 1;
        }
    }
    let correlation = match is_measured(condition) {
        true => Correlation::of(&recordings, &run)?,
        false => Correlation::default(),
    };
    Ok(Outcome { score, correlation })
}

fn drive(scene: &Scene, fleet: &[Vehicle], seed: u64) -> Vec<Vec<SimScan>> {
    let drives = fleet.iter().zip(10 * seed..);
    drives
        .map(|(vehicle, seed)| scene.drive(vehicle, LAPS, seed))
        .collect()
}

/// Whether scans of the state without a changed object would observe it if it were there.
fn would_be_observed(scene: &Scene, fleet: &[Vehicle], seed: u64, change: &WorldChange) -> bool {
    let mut always_there = scene.clone();
    let object = &mut always_there.objects[change.object];
    (object.from_lap, object.until_lap) = (0, None);
    let appeared = change.kind == ChangeKind::Appeared;
    let drives = drive(&always_there, fleet, seed);
    let observing = drives.iter().flatten().filter(|scan| {
        let beams = scan
            .hit_objects
            .iter()
            .filter(|&&o| o == Some(change.object));
        (scan.lap < LAPS_BEFORE) == appeared && beams.count() >= BEAMS_MIN
    });
    observing.count() >= SCANS_MIN
}

/// Every vehicle's laps, lap by lap. The first odometry frame is the map's.
pub(super) fn recordings_of(
    fleet: &[Vehicle],
    drives: &[Vec<SimScan>],
    trip_a_lap: bool,
) -> anyhow::Result<Vec<Recording>> {
    let mut recordings = Vec::new();
    for lap in LAPS {
        for (k, (vehicle, scans)) in fleet.iter().zip(drives).enumerate() {
            let Some(first) = scans.first() else { continue };
            let map_from_odom = first.map_from_base.compose(&first.odom_from_base.inverse());
            let of_lap: Vec<&SimScan> = scans.iter().filter(|scan| scan.lap == lap).collect();
            let start_s = LAP_PAUSE_S * (lap * fleet.len() + k) as f64;
            let lap_start_s = of_lap.first().map_or(0.0, |scan| scan.time_s);
            let scans = of_lap.into_iter().map(|scan| RecordedScan {
                stamp: StampNs(((start_s + scan.time_s - lap_start_s) * 1e9) as i64),
                odom_from_base: map_from_odom.compose(&scan.odom_from_base),
                ranges_m: scan.ranges_m.clone(),
            });
            recordings.push(Recording {
                trip: TripId::new(match trip_a_lap {
                    true => format!("{k}-{lap}"),
                    false => format!("{k}"),
                })?,
                lidar: Arc::new(vehicle.lidar.geometry.clone().validated()?),
                scans: scans.collect(),
            });
        }
    }
    Ok(recordings)
}

#[cfg(test)]
mod tests {
    use super::super::world_conditions::{BUILDING_WORKS, REBUILT};
    use super::*;
    use crate::sim::PassErrors;

    #[test]
    fn what_passes_is_there_for_single_laps_and_no_change_to_find() {
        let setting = Setting::of(WorldKind::Rooms, &CORRELATED, 5).unwrap();
        let plain = Setting::of(WorldKind::Rooms, &PLAIN, 5).unwrap();
        assert!(plain.passing.is_empty());
        let stays = |setting: &Setting| {
            let changes = world_changes(&setting.scene, LAPS);
            let stay = changes
                .iter()
                .filter(|c| !setting.passing.contains(&c.object));
            stay.map(|c| (c.kind, c.shape.clone())).collect::<Vec<_>>()
        };
        // Two doors that swing come and go, two things go and four come; who stands about may
        // have taken the place of one.
        assert!((8..=10).contains(&stays(&plain).len()));
        assert!(stays(&setting).len() >= 8);
        let of_one_lap = setting.passing.iter().filter(|&&object| {
            let object = &setting.scene.objects[object];
            object.until_lap == Some(object.from_lap + 1)
        });
        assert!(of_one_lap.count() >= 8);
    }

    #[test]
    fn every_lap_is_a_recording_after_the_one_before() {
        let setting = Setting::of(WorldKind::Hall, &PLAIN, 3).unwrap();
        let condition = Condition {
            vehicles: 2,
            ..PLAIN
        };
        let mut fleet = condition.fleet();
        for vehicle in &mut fleet {
            vehicle.scan_spacing_m = 4.0;
        }
        let drives = setting.drive(&fleet, 3);
        let recordings = recordings_of(&fleet, &drives, true).unwrap();
        assert_eq!(recordings.len(), LAPS.len() * 2);
        let stamps = recordings.iter().flat_map(|r| &r.scans).map(|s| s.stamp);
        assert!(stamps.is_sorted());
        let trips: BTreeSet<_> = recordings.iter().map(|r| &r.trip).collect();
        assert_eq!(trips.len(), recordings.len());
        let first = &recordings[0].scans[0].odom_from_base;
        assert!(
            first
                .between(&drives[0][0].map_from_base)
                .translation()
                .norm()
                < 1e-9
        );
        let together = recordings_of(&fleet, &drives, false).unwrap();
        let trips: BTreeSet<_> = together.iter().map(|r| &r.trip).collect();
        assert_eq!(trips.len(), 2);
    }

    #[test]
    fn a_hidden_place_is_not_within_reach() {
        let mut setting = Setting::of(WorldKind::Hall, &PLAIN, 3).unwrap();
        let mut fleet = PLAIN.fleet();
        fleet[0].scan_spacing_m = 1.0;
        let changes = world_changes(&setting.scene, LAPS);
        let change = changes.iter().find(|c| c.kind == ChangeKind::Appeared);
        let change = change.unwrap().clone();
        assert!(would_be_observed(&setting.scene, &fleet, 3, &change));
        // A box round its place, until it comes.
        let (middle, radius_m) = change.shape.bounding_circle();
        let round = crate::sim::Shape::Round {
            centre: middle,
            radius_m: radius_m + 0.05,
        };
        setting.scene.objects.push(crate::sim::SceneObject {
            until_lap: Some(LAPS_BEFORE),
            ..crate::sim::SceneObject::lasting(round)
        });
        assert!(!would_be_observed(&setting.scene, &fleet, 3, &change));
    }

    #[test]
    fn every_change_is_found_missed_or_out_of_reach() {
        let quick = Condition {
            worlds: &[WorldKind::Hall],
            range_max_m: Some(6.0),
            pass_errors: PassErrors::AS_RECORDED,
            ..PLAIN
        };
        let runs = std::sync::atomic::AtomicUsize::new(0);
        let count = || {
            runs.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
        };
        let study = score_conditions(&[quick], 100, 1, count).unwrap();
        assert_eq!(runs.into_inner(), 1);
        let score = &study.rows[0].score;
        assert_eq!(score.changes, score.out_of_reach + score.found.of);
        assert!(score.found.hits > 0 && score.confirmed <= score.found.hits);
        assert_eq!(score.laps, LAPS.len());
        assert_eq!(study.correlations.len(), 1);
        assert_eq!(world_runs(3), 3 * 59);
    }

    #[test]
    fn a_trip_is_followed_while_half_of_what_it_sees_changes() {
        let Outcome { score, .. } = run(WorldKind::Hall, &REBUILT, 670).unwrap();
        assert_eq!((score.changes, score.out_of_reach), (50, 0));
        assert!(score.found.hits >= 48, "{score:?}");
        assert_eq!(score.batches_not_merged, 0);
    }

    #[test]
    fn a_trip_is_localised_in_a_hall_that_was_rebuilt() {
        let Outcome { score, .. } = run(WorldKind::Hall, &BUILDING_WORKS, 640).unwrap();
        assert!(score.changes >= 25 && score.out_of_reach == 0, "{score:?}");
        assert!(score.found.hits + 1 >= score.found.of, "{score:?}");
        assert_eq!(score.open_true.hits, score.open_true.of, "{score:?}");
        assert_eq!(score.batches_not_merged, 0);
    }

    #[test]
    fn a_trip_is_not_placed_where_a_rebuilt_floor_looks_the_same_turned_by_half() {
        let Outcome { score, .. } = run(WorldKind::Rooms, &BUILDING_WORKS, 656).unwrap();
        assert_eq!(score.batches_not_merged, 8);
    }

    #[test]
    fn as_many_walls_are_put_up_as_are_taken_down() {
        for world in WorldKind::INDOORS {
            let Setting { scene, .. } = Setting::of(world, &BUILDING_WORKS, 640).unwrap();
            let walls = scene.objects.iter().filter(|o| !o.stands_free());
            let (mut went, mut came) = (0, 0);
            for wall in walls {
                went += usize::from(wall.until_lap == Some(LAPS_BEFORE));
                came += usize::from(wall.from_lap == LAPS_BEFORE);
            }
            // Doors are no free things either.
            let doors = if world == WorldKind::Rooms { 12 } else { 0 };
            assert_eq!((went, came), (4 + doors, 4 + doors));
        }
    }
}
