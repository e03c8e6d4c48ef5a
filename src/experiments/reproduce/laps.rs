//! What a vehicle records in a case, with the truth beside it.

use std::sync::Arc;

use anyhow::Context;

use super::case::Case;
use crate::change::ChangeKind;
use crate::geometry::Pose2;
use crate::ids::StampNs;
use crate::mapping::DriveScan;
use crate::scan::LaserScan;
use crate::sim::{Changes, Hall, OdometryError, Scene, Shape, SimLidar, SimScan, Vehicle};

/// A scan with this many beams on an object observes it.
const BEAMS_MIN: usize = 3;
/// Areas of what appears, in turn, as shares of the mean area of the hall's objects.
const SIZES: [f64; 4] = [1.0, 0.3, 2.0, 0.1];

/// A true change of the world.
#[derive(Debug, Clone)]
pub(super) struct TrueChange {
    /// Appeared or disappeared.
    pub kind: ChangeKind,
    /// What came or went, map frame.
    pub shape: Shape,
    /// Its area as a share of the area of all original objects.
    pub area_share: f64,
    /// Whether the scans show it: observed in at least four scans (`Scene::visible_changes`).
    pub visible: bool,
    /// The first lap after the change with a scan that observes its place.
    pub first_lap: Option<usize>,
}

/// One scan.
#[derive(Debug, Clone)]
pub(super) struct RecordedScan {
    /// As the map takes it.
    pub scan: DriveScan,
    /// From 0.
    pub lap: usize,
    /// `map_from_base`.
    pub truth: Pose2,
    /// Share of the beams that end elsewhere before the change than after it, seen from here.
    pub differing: f64,
    /// The changes that a scan from here observes, in the world that has the object.
    pub observes: Vec<usize>,
}

/// The laps of a case.
#[derive(Debug, Clone)]
pub(super) struct Laps {
    /// In the order of time.
    pub scans: Vec<RecordedScan>,
    /// All changes, seen or not.
    pub changes: Vec<TrueChange>,
    /// Laps before them.
    pub before: usize,
    /// All laps.
    pub count: usize,
    /// Area of what appeared as a share of the area of all original objects.
    pub appeared_area_share: f64,
}

impl Laps {
    /// Drives a case.
    ///
    /// # Errors
    /// If the case has no world; it has.
    pub(super) fn drive(case: &Case) -> anyhow::Result<Self> {
        let hall = Hall::generate(case.map_seed).context("the hall has no route")?;
        let vehicle = vehicle(case);
        let stage = Stage::of(&hall, case);
        let drive = |scene: &Scene| scene.drive(&vehicle, 0..case.laps(), case.seed);
        // Path, odometry and noise do not depend on what stands there, so these three are the
        // same drive through the change, before it, and after it.
        let recorded = drive(&stage.scene);
        let before = drive(&stage.changed_from(usize::MAX));
        let after = drive(&stage.changed_from(0));
        let events = stage.scene.visible_changes(&recorded);
        let lidar = vehicle.lidar.geometry.clone().validated()?;
        let lidar = Arc::new(lidar);
        let mut scans = Vec::with_capacity(recorded.len());
        for (k, scan) in recorded.into_iter().enumerate() {
            let beams = LaserScan::new(lidar.clone(), scan.ranges_m.iter().copied())?;
            scans.push(RecordedScan {
                differing: differing(&before[k], &after[k]),
                observes: stage.observed_changes(&before[k], &after[k]),
                lap: scan.lap,
                truth: scan.map_from_base,
                scan: DriveScan {
                    beam_interval_s: 0.0,
                    lidar: Default::default(),
                    stamp: StampNs((scan.time_s * 1e9).round() as i64),
                    odom_from_base: scan.odom_from_base,
                    scan: beams,
                },
            });
        }
        let mut changes = stage.changes;
        for (k, change) in changes.iter_mut().enumerate() {
            let object = stage.objects[k];
            change.visible = events.iter().any(|event| event.object == object);
            let later = scans.iter().filter(|s| s.lap >= case.laps_before);
            let first = later.filter(|s| s.observes.contains(&k)).map(|s| s.lap);
            change.first_lap = first.min();
        }
        let appeared = changes.iter().filter(|c| c.kind == ChangeKind::Appeared);
        Ok(Self {
            appeared_area_share: appeared.map(|c| c.area_share).sum(),
            scans,
            changes,
            before: case.laps_before,
            count: case.laps(),
        })
    }

    /// Whether the world changed between two scans.
    pub(super) fn crosses_change(&self, old: usize, new: usize) -> bool {
        let changed = |k: usize| self.scans[k].lap >= self.before;
        !self.changes.is_empty() && changed(old) != changed(new)
    }

    /// Share of the beams of a closure's scans that the change makes differ: the larger of both.
    pub(super) fn changed_share(&self, old: usize, new: usize) -> f64 {
        if !self.crosses_change(old, new) {
            return 0.0;
        }
        self.scans[old].differing.max(self.scans[new].differing)
    }
}

/// A lidar of 360 beams with 1 cm of noise, and wheels that err by a hundredth.
fn vehicle(case: &Case) -> Vehicle {
    Vehicle {
        lidar: SimLidar::all_round(360, 20.0, 0.01, Pose2::new(0.2, 0.0, 0.0)),
        odometry: OdometryError {
            scale: 0.01,
            yaw_drift_rad_per_m: 5e-4,
            sigma_xy_m: 0.005,
            sigma_theta_rad: 0.003,
        },
        path_noise_m: case.path_noise_m,
        scan_spacing_m: case.scan_spacing_m,
        speed_mps: 1.0,
    }
}

/// The scene of a case, and what changes in it.
struct Stage {
    scene: Scene,
    changes: Vec<TrueChange>,
    /// Of each change, by places in the scene.
    objects: Vec<usize>,
}

impl Stage {
    /// About every second change is an object that appears, of four sizes in turn; the others
    /// vanish. Fewer where there is no room, or nothing left to take away.
    fn of(hall: &Hall, case: &Case) -> Self {
        let mut scene = Scene::of_hall(hall, case.seed);
        // The first object is the walls.
        let own = scene.objects.iter().skip(1);
        let total_m2: f64 = own.map(|object| object.shape.area_m2()).sum();
        // With an odd number the seed says of which kind there is one more.
        let vanishing = (case.changes + (case.seed % 2) as usize) / 2;
        let mut changes = Changes::new(&mut scene, case.laps_before, case.path_noise_m, case.seed);
        let mut objects = changes.remove(vanishing);
        for k in 0..case.changes - objects.len() {
            objects.extend(changes.add(1, SIZES[k % SIZES.len()]));
        }
        let change = |&object: &usize| {
            let there = &scene.objects[object];
            TrueChange {
                kind: match there.until_lap {
                    Some(_) => ChangeKind::Disappeared,
                    None => ChangeKind::Appeared,
                },
                shape: there.shape.clone(),
                area_share: there.shape.area_m2() / total_m2,
                visible: false,
                first_lap: None,
            }
        };
        Self {
            changes: objects.iter().map(change).collect(),
            objects,
            scene,
        }
    }

    /// The scene with everything changed from another lap on.
    fn changed_from(&self, lap: usize) -> Scene {
        let mut scene = self.scene.clone();
        for (change, &object) in self.changes.iter().zip(&self.objects) {
            let object = &mut scene.objects[object];
            match change.kind {
                ChangeKind::Disappeared => object.until_lap = Some(lap),
                _ => object.from_lap = lap,
            }
        }
        scene
    }

    /// The changes that one of two equal scans, before and after, observes.
    fn observed_changes(&self, before: &SimScan, after: &SimScan) -> Vec<usize> {
        let strikes = |scan: &SimScan, object| {
            let hits = scan.hit_objects.iter().filter(|s| **s == Some(object));
            hits.count()
        };
        let is_observed = |k: &usize| {
            let object = self.objects[*k];
            strikes(before, object).max(strikes(after, object)) >= BEAMS_MIN
        };
        (0..self.changes.len()).filter(is_observed).collect()
    }
}

fn differing(before: &SimScan, after: &SimScan) -> f64 {
    let pairs = before.ranges_m.iter().zip(&after.ranges_m);
    let differing = pairs.filter(|(a, b)| a != b).count();
    differing as f64 / before.ranges_m.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::super::case::Seeds;
    use super::super::protocol::figure_3;
    use super::*;

    fn case(changes: usize) -> Case {
        let case = figure_3(true, Seeds::Tuning);
        Case { changes, ..case }
    }

    #[test]
    fn what_differs_is_what_changed() {
        let laps = Laps::drive(&case(6)).unwrap();
        assert_eq!(laps.changes.len(), 6);
        let appeared = laps
            .changes
            .iter()
            .filter(|c| c.kind == ChangeKind::Appeared);
        assert_eq!(appeared.count(), 3);
        assert!(laps.changes.iter().any(|c| c.visible));
        for scan in &laps.scans {
            // Three beams on an object are three beams that differ.
            let looks = scan.observes.len() as f64 * BEAMS_MIN as f64 / 360.0;
            assert!(scan.differing >= looks - 1e-9, "{scan:?}");
        }
        for change in laps.changes.iter().filter(|c| c.visible) {
            assert!(change.first_lap.is_some_and(|lap| lap >= laps.before));
        }
        let (old, new) = (5, laps.scans.len() - 1);
        assert!(laps.crosses_change(old, new) && !laps.crosses_change(old, old + 1));
        assert_eq!(laps.changed_share(old, old + 1), 0.0);
    }

    #[test]
    fn without_changes_nothing_differs() {
        let laps = Laps::drive(&case(0)).unwrap();
        assert!(laps.changes.is_empty() && laps.appeared_area_share == 0.0);
        assert!(laps.scans.iter().all(|s| s.differing == 0.0));
        assert!(!laps.crosses_change(0, laps.scans.len() - 1));
    }

    #[test]
    fn a_hundred_changes_are_too_many() {
        let laps = Laps::drive(&case(100)).unwrap();
        let gone = laps
            .changes
            .iter()
            .filter(|c| c.kind == ChangeKind::Disappeared);
        assert!(gone.count() >= 30);
        assert!(laps.changes.len() > 50 && laps.appeared_area_share > 0.3);
    }
}
