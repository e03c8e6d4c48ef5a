//! What height bands of a 3D lidar find of tables, shelves and boards that come and go.

use rayon::iter::{IntoParallelIterator, ParallelIterator};
use serde::Serialize;

use super::alert::ScoredAlert;
use super::distance::region_distance_m;
use super::recording::Recording;
use super::route::{RouteAlert, RouteRun};
use super::scoring::reach_m;
use super::wilson::Share;
use super::world_conditions::{LAPS, LAPS_BEFORE};
use super::worlds::recordings_of;
use crate::change::ChangeKind;
use crate::geometry::{Pose2, Vector2, distance_to_polygon};
use crate::scan::{BandScanner, CloudLidar, HeightBand};
use crate::sim::{Changes, Furniture, Hall, Scene, Shape, SimCloudLidar, Vehicle};

/// Bands, metres above the floor: near the floor, …
const LOW_M: (f64, f64) = (0.1, 0.4);
/// … and about as high as a table.
const HIGH_M: (f64, f64) = (0.6, 1.0);
/// What is lower than this within a band may be passed by unseen, metres: with it the low band sees
/// far, …
const LOW_LEAST_M: f64 = 0.1;
/// … and the high one sees the top of a table, which is 3 cm thick.
const HIGH_LEAST_M: f64 = 0.03;

/// The 3D lidar: height above the floor, metres, …
const HEIGHT_M: f64 = 0.85;
/// … rings, from this elevation on, degrees, …
const RINGS: u32 = 32;
const LOWEST_DEG: f64 = -16.0;
/// … and so far apart, degrees.
const RING_STEP_DEG: f64 = 0.66;
const BEAMS: usize = 600;
const REACH_M: f64 = 30.0;
const SIGMA_M: f64 = 0.01;
const DROPOUT_RATE: f64 = 0.005;

/// How many pieces of each kind of furniture appear, and how many disappear.
const OF_EACH: usize = 3;
/// Furniture stands no farther than this from where vehicles may drive, metres.
const BESIDE_M: f64 = 0.4;
/// Places across half of a thing at which it is asked whether an alert covers it.
const STEPS: i32 = 20;
const PATH_NOISE_M: f64 = 0.3;
const SCAN_SPACING_M: f64 = 0.2;

/// What was found, by what it was looked for with.
#[derive(Debug, Clone, Serialize)]
pub struct BandsStudy {
    /// The first seed …
    pub first_seed: u64,
    /// … of all of these.
    pub seeds: u64,
    /// The low band alone; both; and what of both the high one shows.
    pub rows: Vec<BandsRow>,
}

/// What was found with some bands, over all seeds.
#[derive(Debug, Clone, Default, Serialize)]
pub struct BandsRow {
    /// Which bands.
    pub bands: &'static str,
    /// Of each kind of furniture what came, then what went: tables, shelves, hanging boards.
    pub found: [Share; 6],
    /// Of the outline of everything found, the share that the alerts' regions cover, summed.
    pub covered: f64,
    /// Open alerts of change that lie on no change of their kind.
    pub false_alerts: usize,
    /// Other open alerts: of vehicles, or of a map that does not fit.
    pub others: usize,
    /// Batches that never found a place in the map.
    pub batches_not_merged: usize,
}

const KINDS: [Furniture; 3] = [Furniture::Table, Furniture::Shelf, Furniture::Board];

/// Furniture that came or went.
struct Change {
    furniture: Furniture,
    kind: ChangeKind,
    outline: Shape,
}

/// Runs a hall for each seed, once with the low band and once with both, each band as a trip of its
/// own. `advance` is called after each run.
///
/// # Errors
/// If a world could not be made or run.
pub fn score_bands(
    first_seed: u64,
    seeds: u64,
    advance: impl Fn() + Sync,
) -> anyhow::Result<BandsStudy> {
    let of_seed = |seed: u64| -> anyhow::Result<[BandsRow; 3]> {
        let (scene, changes) = furnished(seed)?;
        let drives = drives(&scene, seed)?;
        let low = run_of(&drives[..1])?;
        advance();
        let both = run_of(&drives)?;
        advance();
        let is_high = |alert: &RouteAlert| {
            let bands = &alert.state.evidence.bands;
            bands.iter().any(|band| band.from_m == HIGH_M.0)
        };
        Ok([
            row_of("low", &low, &changes, |_| true),
            row_of("low and high", &both, &changes, |_| true),
            row_of(
                "of these, reported by the high one",
                &both,
                &changes,
                is_high,
            ),
        ])
    };
    let of_seeds: anyhow::Result<Vec<[BandsRow; 3]>> = (first_seed..first_seed + seeds)
        .into_par_iter()
        .map(of_seed)
        .collect();
    let mut rows: Vec<BandsRow> = Vec::new();
    for of_seed in of_seeds? {
        if rows.is_empty() {
            rows.extend(of_seed);
        } else {
            rows.iter_mut()
                .zip(&of_seed)
                .for_each(|(row, other)| row.merge(other));
        }
    }
    Ok(BandsStudy {
        first_seed,
        seeds,
        rows,
    })
}

/// A hall in which furniture comes and goes half-way.
fn furnished(seed: u64) -> anyhow::Result<(Scene, Vec<Change>)> {
    let mut scene = Scene::of_hall(&Hall::generate(seed)?, seed);
    let mut changes = Vec::new();
    for kind in [ChangeKind::Appeared, ChangeKind::Disappeared] {
        let from_lap = match kind {
            ChangeKind::Appeared => LAPS_BEFORE,
            _ => 0,
        };
        for furniture in KINDS.repeat(OF_EACH) {
            let place = seed + 1_000 * scene.objects.len() as u64;
            let mut laying = Changes::new(&mut scene, from_lap, PATH_NOISE_M, place);
            let Some(parts) = laying.furnish(furniture, BESIDE_M) else {
                continue;
            };
            let outline = parts.last().map(|&part| scene.objects[part].shape.clone());
            if kind == ChangeKind::Disappeared {
                for &part in &parts {
                    scene.objects[part].until_lap = Some(LAPS_BEFORE);
                }
            }
            changes.extend(outline.map(|outline| Change {
                furniture,
                kind,
                outline,
            }));
        }
    }
    Ok((scene, changes))
}

/// Each band's drive: the same way, the same clouds.
fn drives(scene: &Scene, seed: u64) -> anyhow::Result<Vec<Vec<Recording>>> {
    let ring = |k: u32| (LOWEST_DEG + RING_STEP_DEG * f64::from(k)).to_radians();
    let lidar = CloudLidar {
        mount: Pose2::new(0.2, 0.0, 0.0),
        height_m: HEIGHT_M,
        elevations_rad: (0..RINGS).map(ring).collect(),
        beams: BEAMS,
        range_min_m: 0.3,
        range_max_m: REACH_M,
        range_sigma_m: SIGMA_M,
    };
    let scanner = |(from_m, to_m), least_m| -> anyhow::Result<BandScanner> {
        Ok(BandScanner::new(
            &lidar,
            HeightBand::new(from_m, to_m)?,
            least_m,
        )?)
    };
    let scanners = [scanner(LOW_M, LOW_LEAST_M)?, scanner(HIGH_M, HIGH_LEAST_M)?];
    let cloud_lidar = SimCloudLidar {
        lidar,
        dropout_rate: DROPOUT_RATE,
    };
    let mut vehicle = Vehicle::of_fleet(0, PATH_NOISE_M);
    vehicle.scan_spacing_m = SCAN_SPACING_M;
    let drives = scene.drive_bands(&vehicle, &cloud_lidar, &scanners, LAPS, 10 * seed)?;
    let of_bands = scanners.iter().zip(drives).enumerate();
    let recordings = of_bands.map(|(band, (scanner, drive))| {
        let mut of_band = vehicle.clone();
        of_band.lidar.geometry = (**scanner.lidar()).clone();
        // Each band is a vehicle of its own, and one follows the other.
        let fleet = vec![of_band; scanners.len()];
        let mut drives = vec![Vec::new(); scanners.len()];
        drives[band] = drive;
        recordings_of(&fleet, &drives, false)
    });
    recordings.collect()
}

fn run_of(drives: &[Vec<Recording>]) -> anyhow::Result<RouteRun> {
    let mut recordings: Vec<Recording> = drives.iter().flatten().cloned().collect();
    recordings.sort_by_key(|recording| recording.scans.first().map(|scan| scan.stamp));
    RouteRun::of(&recordings, true)
}

/// Counts the open alerts that `counts` takes.
fn row_of(
    bands: &'static str,
    run: &RouteRun,
    changes: &[Change],
    counts: impl Fn(&RouteAlert) -> bool,
) -> BandsRow {
    let mut row = BandsRow {
        bands,
        batches_not_merged: run.batches_not_merged,
        ..BandsRow::default()
    };
    let open = run.alerts.iter().filter(|a| a.state.status.is_pending());
    let alerts: Vec<ScoredAlert> = open.filter(|a| counts(a)).map(RouteAlert::scored).collect();
    let lies_on = |alert: &ScoredAlert, change: &Change| {
        let mut sides = alert.sides();
        sides.any(|(kind, region)| {
            let off_m = region_distance_m(&change.outline, region);
            kind == change.kind && off_m <= reach_m(SIGMA_M)
        })
    };
    for alert in &alerts {
        if !alert.kind.is_of_state() {
            row.others += 1;
        } else if !changes.iter().any(|change| lies_on(alert, change)) {
            row.false_alerts += 1;
        }
    }
    for change in changes {
        let on_it: Vec<_> = alerts.iter().filter(|a| lies_on(a, change)).collect();
        let share = row.share_mut(change);
        share.of += 1;
        share.hits += usize::from(!on_it.is_empty());
        row.covered += covered(change, &on_it);
    }
    row
}

/// The share of what came or went that the regions of alerts cover.
fn covered(change: &Change, alerts: &[&ScoredAlert]) -> f64 {
    let (middle, reach_m) = change.outline.bounding_circle();
    let steps = || (-STEPS..=STEPS).map(|k| reach_m * f64::from(k) / f64::from(STEPS));
    let places = steps().flat_map(|x| steps().map(move |y| middle + Vector2::new(x, y)));
    let (mut all, mut hit) = (0_usize, 0_usize);
    for place in places.filter(|place| change.outline.contains(place)) {
        let mut sides = alerts.iter().flat_map(|alert| alert.sides());
        let is_covered = sides.any(|(kind, region)| {
            kind == change.kind && distance_to_polygon(&place, region) == 0.0
        });
        all += 1;
        hit += usize::from(is_covered);
    }
    hit as f64 / all.max(1) as f64
}

impl BandsRow {
    fn share_mut(&mut self, change: &Change) -> &mut Share {
        let kind = KINDS.iter().position(|kind| *kind == change.furniture);
        let went = usize::from(change.kind == ChangeKind::Disappeared);
        &mut self.found[2 * kind.unwrap_or(0) + went]
    }

    fn found_count(&self) -> usize {
        self.found.iter().map(|share| share.hits).sum()
    }

    fn merge(&mut self, other: &Self) {
        for (share, other) in self.found.iter_mut().zip(&other.found) {
            share.hits += other.hits;
            share.of += other.of;
        }
        self.covered += other.covered;
        self.false_alerts += other.false_alerts;
        self.others += other.others;
        self.batches_not_merged += other.batches_not_merged;
    }
}

/// The rows as a table.
pub fn bands_text(study: &BandsStudy) -> String {
    let mut text = String::from(
        "| bands | tables came | went | shelves came | went | boards came | went | of their area \
         | false alerts | other alerts | batches not merged |\n\
         |---|---|---|---|---|---|---|---|---|---|---|\n",
    );
    for row in &study.rows {
        let found = row.found.iter();
        let found: Vec<String> = found.map(|s| format!("{}/{}", s.hits, s.of)).collect();
        let covered = row.covered / row.found_count().max(1) as f64;
        let line = format!(
            "| {} | {} | {covered:.2} | {} | {} | {} |\n",
            row.bands,
            found.join(" | "),
            row.false_alerts,
            row.others,
            row.batches_not_merged
        );
        text.push_str(&line);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn furniture_comes_and_goes_half_way() {
        let (scene, changes) = furnished(7).unwrap();
        assert_eq!(changes.len(), 6 * OF_EACH);
        for lap in LAPS {
            let parts = scene.objects.iter().filter(|object| object.is_there(lap));
            let boards = parts.filter(|object| object.heights_m.1 < 2.0).count();
            // Five parts of a table, nine of a shelf, one of a board; before and after.
            assert_eq!(boards, OF_EACH * (5 + 9 + 1), "lap {lap}");
        }
    }
}
