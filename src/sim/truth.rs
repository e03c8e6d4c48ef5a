//! What has truly changed, and could be seen.

use super::{Scene, Shape, SimScan};
use crate::change::ChangeKind;

/// So many beams of a scan on an object are a look at it.
const BEAMS_MIN: usize = 3;
/// So many looks make an object visible.
const LOOKS_MIN: usize = 4;

/// A change of the world that the scans show.
#[derive(Debug, Clone, PartialEq)]
pub struct ChangeEvent {
    /// [`ChangeKind::Appeared`] or [`ChangeKind::Disappeared`].
    pub kind: ChangeKind,
    /// The object, by its place in [`Scene::objects`].
    pub object: usize,
    /// The first lap after the change.
    pub lap: usize,
    /// What has come or gone, map frame.
    pub shape: Shape,
}

impl Scene {
    /// The changes between laps of these scans, which may be of several vehicles: an object that
    /// came and was looked at afterwards, or went and was looked at before, in at least four
    /// scans with at least three beams each. In the order of the objects.
    pub fn visible_changes<'a>(
        &self,
        scans: impl IntoIterator<Item = &'a SimScan>,
    ) -> Vec<ChangeEvent> {
        let mut looks = vec![0_usize; self.objects.len()];
        let (mut first_lap, mut last_lap) = (usize::MAX, 0);
        for scan in scans {
            first_lap = first_lap.min(scan.lap);
            last_lap = last_lap.max(scan.lap);
            let mut beams = vec![0_usize; self.objects.len()];
            for &object in scan.struck.iter().flatten() {
                beams[object] += 1;
                if beams[object] == BEAMS_MIN {
                    looks[object] += 1;
                }
            }
        }
        let mut events = Vec::new();
        for (object, (there, &looks)) in self.objects.iter().zip(&looks).enumerate() {
            // An object is struck only while it is there, so that all looks lie on the one side
            // of its coming and on the one side of its going.
            let came = (ChangeKind::Appeared, Some(there.from_lap));
            let went = (ChangeKind::Disappeared, there.until_lap);
            for (kind, lap) in [came, went] {
                if let Some(lap) = lap
                    && first_lap < lap
                    && lap <= last_lap
                    && looks >= LOOKS_MIN
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
