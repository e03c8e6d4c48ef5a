//! What the alerts of a simulated world say of its changes.

use serde::Serialize;

use super::alert::ScoredAlert;
use super::distance::region_distance_m;
use super::wilson::Share;
use crate::change::{ChangeKind, Tier};
use crate::sim::{Scene, SceneObject, Shape};

/// A change of the world, seen by anybody or not.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct WorldChange {
    /// Appeared or disappeared.
    pub kind: ChangeKind,
    /// The object, by its place in [`Scene::objects`].
    pub object: usize,
    /// What came or went, map frame.
    pub shape: Shape,
}

/// Everything that comes or goes in a scene after its first lap, however hidden, in the order of
/// the objects. What the scans show of it is [`Scene::visible_changes`].
pub(super) fn world_changes(scene: &Scene, laps: std::ops::Range<usize>) -> Vec<WorldChange> {
    let is_within = |lap: &usize| laps.start < *lap && *lap < laps.end;
    let of_object = |(object, there): (usize, &SceneObject)| {
        let came = Some(there.from_lap).filter(is_within);
        let went = there.until_lap.filter(is_within);
        let kinds = [
            came.map(|_| ChangeKind::Appeared),
            went.map(|_| ChangeKind::Disappeared),
        ];
        let shape = there.shape.clone();
        kinds.into_iter().flatten().map(move |kind| WorldChange {
            kind,
            object,
            shape: shape.clone(),
        })
    };
    let objects = scene.objects.iter().enumerate();
    objects.flat_map(of_object).collect()
}

/// A row's counts.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct WorldScore {
    /// Laps of all vehicles.
    pub laps: usize,
    /// Changes between the laps before and after that last.
    pub changes: usize,
    /// Of them those that never were within reach: fewer than four scans have three beams on the
    /// object where it stands, or would have them where it does not.
    pub out_of_reach: usize,
    /// Of the others those that an open alert of their kind reports.
    pub found: Share,
    /// Of those found, how many by a confirmed alert.
    pub confirmed: usize,
    /// Open alerts on a change of the world of their kind, of those that are true or false.
    pub open_true: Share,
    /// The same of alerts that have ended.
    pub ended_true: Share,
    /// Alerts on a change of the world that are not of its kind.
    pub other_kind: usize,
    /// Open alerts that the map does not fit.
    pub mismatches: usize,
    /// Batches that never found a place in the map.
    pub batches_not_merged: usize,
}

impl WorldScore {
    /// Counts alerts, open ones and others, against everything that changed.
    pub(super) fn add_alerts(
        &mut self,
        alerts: &[(ScoredAlert, bool)],
        world: &[WorldChange],
        reach_m: f64,
    ) {
        for (alert, is_open) in alerts {
            match alert.kind {
                // Trips are not asked about their vehicles here.
                ChangeKind::VehicleSuspect => {}
                ChangeKind::MapMismatch => self.mismatches += usize::from(*is_open),
                _ => self.add_change_alert(alert, *is_open, world, reach_m),
            }
        }
    }

    fn add_change_alert(
        &mut self,
        alert: &ScoredAlert,
        is_open: bool,
        world: &[WorldChange],
        reach_m: f64,
    ) {
        let is_true = world.iter().any(|c| reports(alert, c, reach_m));
        if !is_true && world.iter().any(|c| lies_on(alert, c, reach_m)) {
            self.other_kind += 1;
            return;
        }
        let share = match is_open {
            true => &mut self.open_true,
            false => &mut self.ended_true,
        };
        share.of += 1;
        share.hits += usize::from(is_true);
    }

    /// Counts a change that is within reach.
    pub(super) fn add_change(
        &mut self,
        change: &WorldChange,
        alerts: &[(ScoredAlert, bool)],
        reach_m: f64,
    ) {
        let open = alerts.iter().filter(|(_, is_open)| *is_open);
        let mut reporting = open.filter(|(alert, _)| reports(alert, change, reach_m));
        let first = reporting.next();
        let is_confirmed = |(alert, _): &(ScoredAlert, bool)| alert.tier == Some(Tier::Confirmed);
        self.found.of += 1;
        self.found.hits += usize::from(first.is_some());
        let confirmed = first.is_some_and(is_confirmed) || reporting.any(is_confirmed);
        self.confirmed += usize::from(confirmed);
    }

    /// Adds another world's.
    pub(super) fn merge(&mut self, other: &Self) {
        let add = |share: &mut Share, other: &Share| {
            share.hits += other.hits;
            share.of += other.of;
        };
        self.laps += other.laps;
        self.changes += other.changes;
        self.out_of_reach += other.out_of_reach;
        add(&mut self.found, &other.found);
        self.confirmed += other.confirmed;
        add(&mut self.open_true, &other.open_true);
        add(&mut self.ended_true, &other.ended_true);
        self.other_kind += other.other_kind;
        self.mismatches += other.mismatches;
        self.batches_not_merged += other.batches_not_merged;
    }
}

/// Whether a side of an alert lies on a change, and is of its kind.
pub(super) fn reports(alert: &ScoredAlert, change: &WorldChange, reach_m: f64) -> bool {
    let mut sides = alert.sides();
    sides.any(|(kind, region)| {
        kind == change.kind && region_distance_m(&change.shape, region) <= reach_m
    })
}

fn lies_on(alert: &ScoredAlert, change: &WorldChange, reach_m: f64) -> bool {
    let mut sides = alert.sides();
    sides.any(|(_, region)| region_distance_m(&change.shape, region) <= reach_m)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::change::region_round;
    use crate::geometry::{Pose2, Vector2};
    use crate::ids::StampNs;
    use crate::sim::{Hall, SceneObject, Vehicle};

    fn alert(kind: ChangeKind, at: Vector2<f64>) -> ScoredAlert {
        ScoredAlert {
            kind,
            location: at,
            region: region_round(&[at], 0.1),
            counterpart: None,
            tier: Some(Tier::Confirmed),
            passes_when_raised: None,
            batch_when_raised: None,
            since: StampNs(0),
        }
    }

    #[test]
    fn an_alert_on_a_change_that_hardly_shows_is_true() {
        let mut scene = Scene::of_hall(&Hall::generate(3).unwrap(), 3);
        // Behind the walls, where no beam comes.
        let hidden = Pose2::new(-5.0, -5.0, 0.0);
        scene.objects.push(SceneObject {
            from_lap: 1,
            ..SceneObject::lasting(Shape::rectangle(&hidden, 0.5, 0.5))
        });
        let mut vehicle = Vehicle::of_fleet(0, 0.5);
        vehicle.scan_spacing_m = 4.0;
        let scans = scene.drive(&vehicle, 0..2, 1);
        assert!(scene.visible_changes(&scans).is_empty());
        let world = world_changes(&scene, 0..2);
        assert_eq!(world.len(), 1);
        let alerts = [
            (alert(ChangeKind::Appeared, hidden.translation()), true),
            (alert(ChangeKind::Disappeared, hidden.translation()), true),
            (alert(ChangeKind::Appeared, Vector2::new(3.0, 3.0)), true),
            (alert(ChangeKind::Appeared, Vector2::new(3.0, 3.0)), false),
            (alert(ChangeKind::MapMismatch, Vector2::zeros()), true),
        ];
        let mut score = WorldScore::default();
        score.add_alerts(&alerts, &world, 0.35);
        assert_eq!(score.open_true, Share { hits: 1, of: 2 });
        assert_eq!(score.ended_true, Share { hits: 0, of: 1 });
        assert_eq!((score.other_kind, score.mismatches), (1, 1));
        score.add_change(&world[0], &alerts, 0.35);
        score.add_change(&world[0], &alerts[1..], 0.35);
        assert_eq!(
            (score.found, score.confirmed),
            (Share { hits: 1, of: 2 }, 1)
        );
    }

    #[test]
    fn what_comes_and_goes_is_two_changes_and_what_stays_none() {
        let mut scene = Scene::of_hall(&Hall::generate(3).unwrap(), 3);
        assert!(world_changes(&scene, 0..4).is_empty());
        scene.objects[2].until_lap = Some(2);
        scene.objects[4].from_lap = 1;
        scene.objects[4].until_lap = Some(3);
        scene.objects[5].until_lap = Some(4);
        let kinds = |laps| -> Vec<_> {
            let changes = world_changes(&scene, laps);
            changes.iter().map(|c| (c.object, c.kind)).collect()
        };
        use ChangeKind::{Appeared, Disappeared};
        let expected = [(2, Disappeared), (4, Appeared), (4, Disappeared)];
        assert_eq!(kinds(0..4), expected);
        assert_eq!(kinds(1..3), [(2, Disappeared)]);
    }

    #[test]
    fn counterparts_report_too_and_scores_add_up() {
        let change = WorldChange {
            kind: ChangeKind::Disappeared,
            object: 0,
            shape: Shape::rectangle(&Pose2::new(2.0, 0.0, 0.0), 0.5, 0.5),
        };
        let mut door = alert(ChangeKind::Appeared, Vector2::zeros());
        assert!(!reports(&door, &change, 0.35));
        door.counterpart = Some(crate::change::Counterpart {
            kind: ChangeKind::Disappeared,
            region: region_round(&[Vector2::new(2.0, 0.3)], 0.1),
        });
        assert!(reports(&door, &change, 0.35));
        let mut score = WorldScore::default();
        score.add_change(&change, &[(door, true)], 0.35);
        let mut twice = score.clone();
        twice.merge(&score);
        assert_eq!(
            (twice.found, twice.confirmed),
            (Share { hits: 2, of: 2 }, 2)
        );
    }
}
