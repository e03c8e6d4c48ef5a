//! What faults of a vehicle explain of what the map says has changed.

use super::evidence::Scope;
use super::route_map::RouteMap;
use crate::change::{ChangeKind, Finding, Suspect};
use crate::geometry::{Vector2, distance_to_polygon};
use crate::ids::TripId;
use crate::observation::{Observation, REACH_M};

/// What a fault displaces lies as far beside what was there as it says, give or take this, metres:
/// a cell and what poses err.
const MARGIN_M: f64 = 0.15;

impl RouteMap {
    /// Takes out the findings that a fault of the only vehicle that saw them explains, and returns
    /// the findings against those vehicles, each with what it silenced.
    pub(super) fn silence(&self, findings: &mut Vec<Finding>, scope: &Scope<'_>) -> Vec<Finding> {
        let suspected = scope.suspects.iter().filter_map(|suspect| {
            let known = scope.pending.iter().find(|finding| {
                finding.kind == ChangeKind::VehicleSuspect
                    && finding
                        .trips
                        .iter()
                        .any(|trip| suspect.trips.contains(trip))
            });
            let mut against = self.against(suspect, known)?;
            let evidence = against.suspect.get_or_insert_default();
            for silenced in known.iter().flat_map(|known| &known.suspect) {
                evidence.silenced.clone_from(&silenced.silenced);
            }
            if suspect.until.is_none() {
                findings.retain(|finding| {
                    let is_explained = self.explains(suspect, finding, scope);
                    if is_explained {
                        evidence.silence(finding.as_silenced());
                    }
                    !is_explained
                });
            }
            Some(against)
        });
        suspected.collect()
    }

    /// The finding against a vehicle: at the first place where its trips show the fault, or where
    /// its alert has it. `None` if nothing of these trips is in the map and there is no alert.
    fn against(&self, suspect: &Suspect, known: Option<&Finding>) -> Option<Finding> {
        if let Some((known, &node)) = known.and_then(|known| Some((known, known.nodes.first()?))) {
            return Some(suspect.finding(node, known.location));
        }
        let places = suspect.trips.iter().filter_map(|trip| self.trips.get(trip));
        // Where it stated that it was, if it was never localised.
        let by_time = |&&k: &&usize| (self.is_lost(k), self.keyframes[k].stamp);
        let &first = places.flatten().min_by_key(by_time)?;
        let node = &self.graph.nodes()[first];
        Some(suspect.finding(node.id, node.pose.translation()))
    }

    /// Whether a change is what a fault makes of a world that has not changed: only the suspected
    /// vehicle saw it, since it is as it is, and all of it lies no farther from what was there
    /// before (what went: from what is there now) than the fault displaces things.
    fn explains(&self, suspect: &Suspect, finding: &Finding, scope: &Scope<'_>) -> bool {
        let is_own = |trip: &TripId| scope.vehicles.get(trip) == Some(&suspect.vehicle);
        let is_late = suspect
            .sound_until
            .is_none_or(|until| finding.since > until);
        if !finding.kind.is_of_state() || !is_late || !finding.trips.iter().all(is_own) {
            return false;
        }
        let reach_m = suspect.displacement().at_range_m(self.range_m(finding));
        if reach_m <= 0.0 {
            return false;
        }
        let reach_m = reach_m + MARGIN_M;
        // Beside what has come something stood before; where something has gone, it is seen now.
        let is_asked = |trip: &TripId, stamp| match finding.kind {
            ChangeKind::Appeared => {
                !is_own(trip) || suspect.sound_until.is_some_and(|until| stamp <= until)
            }
            _ => is_own(trip) && stamp >= finding.since,
        };
        let mut there: Vec<Vector2<f64>> = Vec::new();
        let keyframes = self.keyframes.iter().zip(self.graph.nodes());
        for (keyframe, node) in keyframes.filter(|(keyframe, _)| self.observes(keyframe)) {
            for taken in keyframe.taken_scans(node.pose) {
                let eye = taken.map_from_base.translation();
                let is_near = distance_to_polygon(&eye, &finding.region) <= REACH_M;
                if is_near && is_asked(&keyframe.trip, taken.stamp) {
                    let observation = Observation::new(taken.scan, &taken.map_from_base);
                    let near =
                        |at: &Vector2<f64>| distance_to_polygon(at, &finding.region) <= reach_m;
                    there.extend(observation.hits().filter(near));
                }
            }
        }
        let is_beside = |at: &Vector2<f64>| there.iter().any(|hit| (hit - at).norm() <= reach_m);
        let corners = finding.region.iter();
        corners.chain([&finding.location]).all(is_beside)
    }

    /// How far the farthest node that a finding was seen from is from it, metres.
    fn range_m(&self, finding: &Finding) -> f64 {
        let seen_from = finding.nodes.iter().filter_map(|node| {
            let k = self.graph.node_position(*node)?;
            let is_late = self.keyframes[k].stamp >= finding.since;
            is_late.then(|| self.graph.nodes()[k].pose.translation())
        });
        let ranges_m = seen_from.map(|eye| (eye - finding.location).norm());
        ranges_m.fold(0.0, f64::max)
    }
}
