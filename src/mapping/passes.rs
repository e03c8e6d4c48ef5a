//! Which trips passed by the place of a change, and what they saw of it.

use std::collections::BTreeMap;

use super::route_map::RouteMap;
use crate::change::{
    AcceptedChange, CandidateSite, Finding, JudgedPass, JudgedPasses, Observed, PassSeen, Presence,
    Screen, Site, Standpoint, layer_of, pass_outcomes, passes, support_min,
};
use crate::geometry::distance_to_polygon;
use crate::ids::{TripId, VehicleId};
use crate::observation::{REACH_M, reach_m};

/// Observations of a pass that are asked, at most: whether something stands there is plain sooner than
/// since when.
const ASKED_MAX: usize = 16;

/// What passes are judged with.
#[derive(Clone, Copy)]
pub struct PassScope<'a> {
    /// What the map has taken in already: what was observed there before says nothing.
    pub accepted: &'a [AcceptedChange],
    /// Whose each trip is.
    pub vehicles: &'a BTreeMap<TripId, VehicleId>,
    /// How many false alerts a lap may raise.
    pub false_alerts_per_lap: f64,
}

impl RouteMap {
    /// The passes by a change of state that are still in the map, as the change was found last; `None`
    /// of any other finding.
    pub fn passes_by(&self, finding: &Finding, scope: &PassScope<'_>) -> Option<JudgedPasses> {
        if !finding.kind.is_of_state() {
            return None;
        }
        let trips: Vec<TripId> = self.trips.keys().cloned().collect();
        let candidates = [finding.location];
        let layers = self.layers.iter();
        let layers = layers.filter(|(layer, _)| finding.is_of(*layer));
        let sites = layers.map(|(_, screen)| Site {
            candidates: &candidates,
            changed_around: &[],
            observations: self.asked_about_passes(screen, finding, &trips),
            accepted: scope.accepted,
            trips: &trips,
            support_min: support_min(scope.false_alerts_per_lap),
        });
        let sites: Vec<Site<'_>> = sites.collect();
        let presences = self.presences(finding, scope, &trips);
        let seen = pass_outcomes(finding, &sites, &presences).into_iter();
        let judged = seen.filter_map(|pass| judged(&pass, &trips, scope));
        Some(JudgedPasses::of(finding.kind, judged.collect()))
    }

    /// Observations that see something of the place, evenly chosen from each pass, at the poses where
    /// they fit what others found, in the order of trip and time.
    fn asked_about_passes(
        &self,
        screen: &Screen,
        finding: &Finding,
        trips: &[TripId],
    ) -> Vec<Observed> {
        let place = CandidateSite {
            cells: finding.region.clone(),
            around: Vec::new(),
        };
        let asked = screen.observations_of(&place).into_iter();
        let asked = asked.filter_map(|key| self.observed(key, trips));
        let mut asked: Vec<Observed> = asked.collect();
        asked.sort_by_key(|observed| (observed.trip, observed.stamp, observed.node));
        let standpoints: Vec<Standpoint> = asked.iter().map(Observed::standpoint).collect();
        let chosen = passes(&standpoints).into_iter().flat_map(|pass| {
            let (first, count) = (pass.start, pass.len());
            let kept = count.min(ASKED_MAX);
            (0..kept).map(move |k| first + k * count / kept)
        });
        let mut chosen: Vec<Observed> = chosen.map(|k| asked[k].clone()).collect();
        for observed in &mut chosen {
            let key = (observed.node, observed.place);
            let scan = observed.observation.scan();
            let fit = screen.fit(&key, scan, &observed.map_from_base);
            observed.refit(&fit);
        }
        chosen
    }

    /// All observations within reach of the place that count there, in the order of trip and time.
    fn presences(
        &self,
        finding: &Finding,
        scope: &PassScope<'_>,
        trips: &[TripId],
    ) -> Vec<Presence> {
        let mut presences = Vec::new();
        let keyframes = self.keyframes.iter().zip(self.graph.nodes());
        for (keyframe, node) in keyframes.filter(|(keyframe, _)| self.observes(keyframe)) {
            let Ok(trip) = trips.binary_search(&keyframe.trip) else {
                continue;
            };
            for taken in keyframe.taken_scans(node.pose) {
                let lidar = taken.scan.lidar();
                let eye = taken.map_from_base.compose(&lidar.mount).translation();
                let is_near = (eye - finding.location).norm() <= REACH_M + extent_m(finding)
                    && distance_to_polygon(&eye, &finding.region) <= reach_m(lidar);
                let is_outdated =
                    |change: &AcceptedChange| change.outdates(taken.stamp, &finding.location);
                if is_near
                    && finding.is_of(layer_of(taken.scan))
                    && !scope.accepted.iter().any(is_outdated)
                {
                    let stamp = taken.stamp;
                    presences.push(Presence {
                        node: keyframe.node,
                        standpoint: Standpoint { trip, stamp, eye },
                    });
                }
            }
        }
        let order = |p: &Presence| (p.standpoint.trip, p.standpoint.stamp, p.node);
        presences.sort_by_key(order);
        presences
    }
}

/// How far a finding's region goes from its location, metres.
fn extent_m(finding: &Finding) -> f64 {
    let corners = finding.region.iter();
    let distances = corners.map(|corner| (corner - finding.location).norm());
    distances.fold(0.0, f64::max)
}

fn judged(pass: &PassSeen, trips: &[TripId], scope: &PassScope<'_>) -> Option<JudgedPass> {
    let trip = &trips[pass.trip];
    Some(JudgedPass {
        trip: trip.clone(),
        vehicle: scope.vehicles.get(trip)?.clone(),
        begins: pass.begins,
        ends: pass.ends,
        side: pass.side,
        outcome: pass.outcome,
        node: pass.node,
    })
}
