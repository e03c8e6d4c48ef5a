//! What a vehicle records in a case, with the truth beside it.

use std::sync::Arc;

use anyhow::Context;

use super::area::area_m2;
use super::case::Case;
use crate::change::ChangeKind;
use crate::geometry::Pose2;
use crate::ids::StampNs;
use crate::mapping::DriveScan;
use crate::scan::LaserScan;
use crate::sim::{Hall, OdometryError, Scene, SceneObject, Shape, SimLidar, SimScan, Vehicle};

/// So many beams of a scan on an object are a look at it.
const BEAMS_MIN: usize = 3;

/// A true change of the world.
#[derive(Debug, Clone)]
pub(super) struct TrueChange {
    /// Appeared or disappeared.
    pub kind: ChangeKind,
    /// What came or went, map frame.
    pub shape: Shape,
    /// Its area as a share of the area of all original objects.
    pub area_share: f64,
    /// Whether the scans show it: looked at in at least four scans (`Scene::visible_changes`).
    pub visible: bool,
    /// The first lap after the change with a scan that looks at its place.
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
    /// The changes that a scan from here looks at, in the world that has the object.
    pub looks_at: Vec<usize>,
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
        let drive = |from_lap: usize| {
            let scene = stage.scene(&hall, from_lap, case.seed);
            scene.drive(&vehicle, 0..case.laps(), case.seed)
        };
        // Path, odometry and noise do not depend on what stands there, so these three are the
        // same drive before, after, and through the change.
        let (before, after, recorded) = (drive(usize::MAX), drive(0), drive(case.laps_before));
        let events = stage
            .scene(&hall, case.laps_before, case.seed)
            .visible_changes(&recorded);
        let lidar = vehicle.lidar.geometry.clone().validated()?;
        let lidar = Arc::new(lidar);
        let mut scans = Vec::with_capacity(recorded.len());
        for (k, scan) in recorded.into_iter().enumerate() {
            let beams = LaserScan::new(lidar.clone(), scan.ranges_m.iter().copied())?;
            scans.push(RecordedScan {
                differing: differing(&before[k], &after[k]),
                looks_at: stage.looks(&before[k], &after[k]),
                lap: scan.lap,
                truth: scan.map_from_base,
                scan: DriveScan {
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
            let first = later.filter(|s| s.looks_at.contains(&k)).map(|s| s.lap);
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

/// What changes, and by which places in the scene.
struct Stage {
    changes: Vec<TrueChange>,
    objects: Vec<usize>,
}

impl Stage {
    /// Every second change is an object that appears, the others vanish; once all have vanished
    /// the rest appear, as far as there is room.
    fn of(hall: &Hall, case: &Case) -> Self {
        // The first shape is the walls.
        let own: Vec<Shape> = hall.world.shapes().skip(1).cloned().collect();
        let total_m2: f64 = own.iter().map(area_m2).sum();
        // With one change the seed says which kind it is.
        let vanishing = ((case.changes + (case.seed % 2) as usize) / 2).min(own.len());
        let more = hall.more_objects(case.changes - vanishing, case.seed);
        let change = |kind, shape: &Shape| TrueChange {
            kind,
            shape: shape.clone(),
            area_share: area_m2(shape) / total_m2,
            visible: false,
            first_lap: None,
        };
        let mut stage = Self {
            changes: Vec::new(),
            objects: Vec::new(),
        };
        // Halls list their objects in random order; a stride spreads equal seeds over them.
        for k in 0..vanishing {
            let place = (k + case.seed as usize) % own.len();
            let vanished = change(ChangeKind::Disappeared, &own[place]);
            stage.changes.push(vanished);
            stage.objects.push(1 + place);
        }
        for (k, shape) in more.iter().enumerate() {
            stage.changes.push(change(ChangeKind::Appeared, shape));
            stage.objects.push(1 + own.len() + k);
        }
        stage
    }

    /// The hall with everything changed from a lap on.
    fn scene(&self, hall: &Hall, from_lap: usize, seed: u64) -> Scene {
        let mut scene = Scene::of_hall(hall, seed);
        for (change, &object) in self.changes.iter().zip(&self.objects) {
            if change.kind == ChangeKind::Disappeared {
                scene.objects[object].until_lap = Some(from_lap);
                continue;
            }
            scene.objects.push(SceneObject {
                shape: change.shape.clone(),
                from_lap,
                until_lap: None,
            });
        }
        scene
    }

    /// The changes that one of two equal scans, before and after, looks at.
    fn looks(&self, before: &SimScan, after: &SimScan) -> Vec<usize> {
        let strikes = |scan: &SimScan, object| {
            let struck = scan.struck.iter().filter(|s| **s == Some(object));
            struck.count()
        };
        let looked_at = |k: &usize| {
            let object = self.objects[*k];
            strikes(before, object).max(strikes(after, object)) >= BEAMS_MIN
        };
        (0..self.changes.len()).filter(looked_at).collect()
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
            let looks = scan.looks_at.len() as f64 * BEAMS_MIN as f64 / 360.0;
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
    fn a_hundred_changes_leave_no_object_standing() {
        let laps = Laps::drive(&case(100)).unwrap();
        let gone = laps
            .changes
            .iter()
            .filter(|c| c.kind == ChangeKind::Disappeared);
        assert!(gone.count() >= 35);
        assert!(laps.changes.len() > 50 && laps.appeared_area_share > 0.3);
    }
}
