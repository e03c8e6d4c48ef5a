//! The true changes that scans can show.

use super::{Scene, Shape, SimScan};
use crate::change::ChangeKind;

/// A scan with this many beams on an object observes it.
const BEAMS_MIN: usize = 3;
/// An object with this many observations is visible.
const OBSERVATIONS_MIN: usize = 4;

/// A change of the world that the scans show.
#[derive(Debug, Clone, PartialEq)]
pub struct ChangeEvent {
    /// [`ChangeKind::Appeared`] or [`ChangeKind::Disappeared`].
    pub kind: ChangeKind,
    /// The object, by its index in [`Scene::objects`].
    pub object: usize,
    /// The first lap after the change.
    pub lap: usize,
    /// The shape that appeared or disappeared, map frame.
    pub shape: Shape,
}

impl Scene {
    /// The changes between laps of these scans, which may be of several vehicles: an object that appeared and
    /// was observed afterwards, or that disappeared and was observed before, in at least four scans with at
    /// least three beams each. In the order of the objects.
    pub fn visible_changes<'a>(
        &self,
        scans: impl IntoIterator<Item = &'a SimScan>,
    ) -> Vec<ChangeEvent> {
        let mut observations = vec![0_usize; self.objects.len()];
        let (mut first_lap, mut last_lap) = (usize::MAX, 0);
        for scan in scans {
            first_lap = first_lap.min(scan.lap);
            last_lap = last_lap.max(scan.lap);
            let mut beams = vec![0_usize; self.objects.len()];
            for &object in scan.hit_objects.iter().flatten() {
                beams[object] += 1;
                if beams[object] == BEAMS_MIN {
                    observations[object] += 1;
                }
            }
        }
        let mut events = Vec::new();
        for (object, (there, &observations)) in self.objects.iter().zip(&observations).enumerate() {
            // An object is hit only while it is there: all its observations are after it appeared and
            // before it disappeared.
            let came = (ChangeKind::Appeared, Some(there.from_lap));
            let went = (ChangeKind::Disappeared, there.until_lap);
            for (kind, lap) in [came, went] {
                if let Some(lap) = lap
                    && first_lap < lap
                    && lap <= last_lap
                    && observations >= OBSERVATIONS_MIN
                {
                    let shape = there.shape.clone();
                    events.push(ChangeEvent {
                        kind,
                        object,
                        lap,
                        shape,
                    });
                }
            }
        }
        events
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::Changes;
    use crate::sim::tests::{vehicle, worlds};

    /// The rules read out one by one, from the objects' lines and the beams' ends.
    fn by_brute_force(scene: &Scene, scans: &[SimScan]) -> Vec<(ChangeKind, usize, usize)> {
        let observations = |object: usize, lap: &dyn Fn(usize) -> bool| {
            let scans = scans.iter().filter(|s| lap(s.lap));
            let beams = |s: &&SimScan| s.hit_objects.iter().filter(|&&o| o == Some(object)).count();
            scans.filter(|s| beams(s) >= 3).count()
        };
        let mut events = Vec::new();
        for (k, object) in scene.objects.iter().enumerate() {
            let from = object.from_lap;
            if scans.iter().any(|s| s.lap < from) && observations(k, &|lap| lap >= from) >= 4 {
                events.push((ChangeKind::Appeared, k, from));
            }
            if let Some(until) = object.until_lap
                && scans.iter().any(|s| s.lap >= until)
                && observations(k, &|lap| lap < until) >= 4
            {
                events.push((ChangeKind::Disappeared, k, until));
            }
        }
        events
    }

    #[test]
    fn the_rules_are_what_counting_gives() {
        let (mut events_seen, mut changes_made) = (0, 0);
        for (name, mut scene) in worlds(9) {
            scene.walkers = 2;
            let mut changes = Changes::new(&mut scene, 2, 0.5, 9);
            changes_made += changes.add(6, 0.02).len() + changes.remove(4).len();
            changes_made += 2 * changes.displace(2).len();
            changes_made += Changes::new(&mut scene, 4, 0.5, 9).add(2, 1.0).len();
            // One that comes and goes.
            scene.objects.last_mut().unwrap().from_lap = 1;
            scene.objects.last_mut().unwrap().until_lap = Some(2);
            for laps in [0..3, 1..4, 2..4, 0..2, 0..1] {
                let scans = scene.drive(&vehicle(0.5), laps.clone(), 3);
                let events = scene.visible_changes(&scans);
                let reported: Vec<_> = events.iter().map(|e| (e.kind, e.object, e.lap)).collect();
                assert_eq!(reported, by_brute_force(&scene, &scans), "{name} {laps:?}");
                let shape = |e: &ChangeEvent| scene.objects[e.object].shape == e.shape;
                assert!(events.iter().all(shape));
                if laps == (0..3) {
                    events_seen += events.len();
                }
                if laps.len() == 1 {
                    assert!(events.is_empty(), "one lap shows no change");
                }
            }
        }
        // Some cannot be seen, most can.
        assert!(
            2 * events_seen > changes_made,
            "{events_seen} of {changes_made}"
        );
    }

    #[test]
    fn several_vehicles_see_together() {
        let [(_, mut scene), ..] = worlds(4);
        Changes::new(&mut scene, 1, 0.5, 4).add(5, 0.3);
        let old = scene.drive(&vehicle(0.5), 0..1, 1);
        let new = scene.drive(&vehicle(0.5), 1..2, 2);
        assert!(scene.visible_changes(&old).is_empty());
        assert!(scene.visible_changes(&new).is_empty());
        assert!(!scene.visible_changes(old.iter().chain(&new)).is_empty());
    }
}
