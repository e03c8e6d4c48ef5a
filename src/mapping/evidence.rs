//! The map's observations as evidence of changes.

use std::collections::BTreeMap;

use super::route_map::RouteMap;
use crate::change::{
    AcceptedChange, Agreement, CandidateSite, Finding, Fit, ObservationKey, Observed, SHIFT_MAX_M,
    Screened, ShiftFit, Site, TiedPose, Tier, TripPose, explain_by_shift, join_counterparts,
    mismatches, separate_counterparts, state_changes, support_min, suspect_vehicle,
};
use crate::geometry::{Vector2, distance_to_polygon};
use crate::graph::EdgeKind;
use crate::ids::{EdgeId, TripId, VehicleId};
use crate::observation::{Observation, REACH_M};

/// Two findings of one kind this near to each other are one, found from two sides, metres.
const SAME_FINDING_M: f64 = 0.3;

/// What a pass observed this near to a segment says by which shift it fits, metres.
const SEGMENT_MARGIN_M: f64 = 1.0;

/// How observations fit what other passes found, as far as it was asked.
type Fits = BTreeMap<ObservationKey, Fit>;

/// What findings are asked for.
pub struct Scope<'a> {
    /// Sites that were touched since the last time, or every one.
    pub sites: Sites,
    /// The findings that alerts wait with, and those that a shift explains, whatever became of
    /// their alerts: where nothing was touched they stand as they are.
    pub pending: &'a [Finding],
    /// How many false alerts a lap may raise.
    pub false_alerts_per_lap: f64,
    /// What the map has taken in already.
    pub accepted: &'a [AcceptedChange],
    /// Whose each trip is; a trip that is not named is its own vehicle's.
    pub vehicles: &'a BTreeMap<TripId, VehicleId>,
}

/// Which sites are judged.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sites {
    /// Those that something new was seen of.
    Touched,
    /// All.
    All,
}

impl RouteMap {
    /// What the observations of the map say: places that changed, vehicles whose lidar is turned,
    /// and segments where the map does not fit. A turned lidar shifts nothing that is matched scan
    /// by scan, so a suspected vehicle's changes stand; but where sound vehicles drive too, its
    /// word alone confirms none.
    pub fn findings(&mut self, scope: &Scope<'_>) -> Vec<Finding> {
        self.update_screen();
        let mut findings = self.state_changes(scope);
        self.screen.settle();
        let suspects = self.suspected_vehicles(scope.vehicles);
        let is_suspected = |trip: &TripId| suspects.iter().any(|s| s.trips.contains(trip));
        let seen = || {
            self.trips
                .iter()
                .filter(|(_, places)| self.has_scans(places))
        };
        if seen().any(|(trip, _)| !is_suspected(trip)) {
            let of_suspects = |f: &&mut Finding| f.trips.iter().all(is_suspected);
            for finding in findings.iter_mut().filter(of_suspects) {
                finding.tier = Tier::Tentative;
            }
        }
        findings.extend(seen().flat_map(|(trip, _)| self.mismatches_of(trip)));
        findings.extend(suspects);
        findings
    }

    /// Brings the screen up to date with the map, without a judgement: what has moved or left is
    /// no news.
    pub fn settle_screen(&mut self) {
        self.update_screen();
        self.screen.settle();
    }

    fn update_screen(&mut self) {
        let mut screen = std::mem::take(&mut self.screen);
        let keyframes = self.keyframes.iter().zip(self.graph.nodes());
        // What a lost trip saw, nobody knows where.
        let keyframes = keyframes.filter(|(keyframe, _)| !keyframe.is_lost());
        let observations = keyframes.flat_map(|(keyframe, node)| {
            keyframe.taken_scans(node.pose).map(|taken| Screened {
                key: (keyframe.node, taken.place),
                trip: &keyframe.trip,
                stamp: taken.stamp,
                map_from_base: taken.map_from_base,
                scan: taken.scan,
            })
        });
        screen.update(observations);
        self.screen = screen;
    }

    fn state_changes(&self, scope: &Scope<'_>) -> Vec<Finding> {
        // Each side of a change is kept or judged anew on its own, and a segment that a shift
        // explains as a whole: what it was found by is not kept.
        let of_state = scope.pending.iter().filter(|f| f.kind.is_of_state());
        let of_state = separate_counterparts(of_state.cloned().collect());
        let shifted = || scope.pending.iter().filter(|f| f.shift.is_some());
        let pending = of_state.iter().chain(shifted());
        let regions: Vec<_> = pending.map(|finding| finding.region.clone()).collect();
        let sites = match scope.sites {
            Sites::Touched => self.screen.touched_sites(&regions),
            Sites::All => self.screen.all_sites(),
        };
        let trips: Vec<TripId> = self.trips.keys().cloned().collect();
        let mut fits = Fits::default();
        let mut findings: Vec<Finding> = Vec::new();
        for site in &sites {
            for found in self.judge(site, &trips, scope, &mut fits) {
                match findings.iter_mut().find(|other| is_same(other, &found)) {
                    Some(same) if same.confidence >= found.confidence => {}
                    Some(same) => *same = found,
                    None => findings.push(found),
                }
            }
        }
        let regions: Vec<_> = findings
            .iter()
            .map(|f| f.region.clone())
            .chain(regions)
            .collect();
        let reliability = self.screen.reliability(&regions);
        for finding in &mut findings {
            if !reliability.confirms(finding.laps, scope.false_alerts_per_lap) {
                finding.tier = Tier::Tentative;
            }
        }
        let is_kept = |finding: &&Finding| {
            scope.sites == Sites::Touched && !self.screen.is_touched(&finding.region)
        };
        for kept in of_state.iter().filter(is_kept) {
            if !findings.iter().any(|found| is_same(found, kept)) {
                findings.push(kept.clone());
            }
        }
        // What one shift explains is no change; then what left one place for another is one event.
        let findings = explain_by_shift(findings, |mismatch| self.shift_fit(mismatch));
        let mut findings = join_counterparts(findings);
        findings.extend(shifted().filter(is_kept).cloned());
        findings
    }

    /// By which shift what a trip observed in a mismatch's region fits what others did, and the
    /// trip itself before.
    fn shift_fit(&self, mismatch: &Finding) -> Option<ShiftFit> {
        let expected = mismatch.shift?;
        let near = |margin_m: f64| {
            let is_near =
                move |at: &Vector2<f64>| distance_to_polygon(at, &mismatch.region) <= margin_m;
            move |observation: &Observation| -> Vec<Vector2<f64>> {
                observation.hits().filter(is_near).collect()
            }
        };
        let (mut old, mut new) = (Vec::new(), Vec::new());
        let keyframes = self.keyframes.iter().zip(self.graph.nodes());
        for (keyframe, node) in keyframes.filter(|(keyframe, _)| !keyframe.is_lost()) {
            let is_own = mismatch.trips.contains(&keyframe.trip);
            for taken in keyframe.taken_scans(node.pose) {
                let eye = taken.map_from_base.translation();
                if distance_to_polygon(&eye, &mismatch.region) > REACH_M {
                    continue;
                }
                let observation = Observation::new(taken.scan, &taken.map_from_base);
                if !is_own || taken.stamp < mismatch.since {
                    old.extend(near(SEGMENT_MARGIN_M + SHIFT_MAX_M)(&observation));
                } else if taken.stamp <= mismatch.last_seen {
                    new.extend(near(SEGMENT_MARGIN_M)(&observation));
                }
            }
        }
        ShiftFit::of(old.into_iter(), new.into_iter(), &expected)
    }

    fn judge(
        &self,
        site: &CandidateSite,
        trips: &[TripId],
        scope: &Scope<'_>,
        fits: &mut Fits,
    ) -> Vec<Finding> {
        let asked = self.screen.asked_about(site).into_iter();
        let observed = asked.filter_map(|key| self.observed(key, trips));
        let mut observations: Vec<Observed> = observed.collect();
        observations.sort_by_key(|observed| (observed.trip, observed.stamp, observed.node));
        let mut site = Site {
            candidates: &site.cells,
            changed_around: &site.around,
            observations,
            accepted: scope.accepted,
            trips,
            support_min: support_min(scope.false_alerts_per_lap),
        };
        let mut findings = state_changes(&mut site, |observed| self.fit_of(observed, fits));
        for finding in &mut findings {
            finding.edges = self.closures_across(finding);
        }
        findings
    }

    /// How an observation fits the others, and where it fits better; each is asked but once.
    fn fit_of(&self, observed: &Observed, fits: &mut Fits) -> Fit {
        let key = (observed.node, observed.place);
        let scan = observed.observation.scan();
        let fit = fits.entry(key);
        *fit.or_insert_with(|| self.screen.fit(&key, scan, &observed.map_from_base))
    }

    fn observed(&self, (node, place): ObservationKey, trips: &[TripId]) -> Option<Observed> {
        let position = self.graph.node_position(node)?;
        let keyframe = &self.keyframes[position];
        let pose = self.graph.nodes()[position].pose;
        let taken = keyframe
            .taken_scans(pose)
            .find(|taken| taken.place == place)?;
        Some(Observed {
            node,
            place,
            trip: trips.binary_search(&keyframe.trip).ok()?,
            stamp: taken.stamp,
            map_from_base: taken.map_from_base,
            observation: Observation::new(taken.scan, &taken.map_from_base),
            agreement: Agreement::default(),
        })
    }

    /// The closures between the nodes that saw a finding's old state and those that saw its new
    /// one.
    fn closures_across(&self, finding: &Finding) -> Vec<EdgeId> {
        let stamp_of = |k: usize| self.keyframes[k].stamp;
        let is_seen_from = |k: usize| {
            let node = self.keyframes[k].node;
            finding.nodes.binary_search(&node).is_ok()
        };
        let edges = self.graph.edges().iter().zip(self.graph.ends());
        let across = edges.filter(|(edge, (from, to))| {
            let (a, b) = (stamp_of(*from), stamp_of(*to));
            edge.kind == EdgeKind::LoopClosure
                && a.min(b) < finding.since
                && finding.since <= a.max(b)
                && is_seen_from(*from)
                && is_seen_from(*to)
        });
        across.map(|(edge, _)| edge.id).collect()
    }

    fn suspected_vehicles(&self, vehicles: &BTreeMap<TripId, VehicleId>) -> Vec<Finding> {
        let mut trips_of: BTreeMap<Result<&VehicleId, &TripId>, Vec<_>> = BTreeMap::new();
        let seen = self.trips.iter();
        for (trip, places) in seen.filter(|(_, places)| self.has_scans(places)) {
            let vehicle = vehicles.get(trip).ok_or(trip);
            let placed = places.iter().filter(|k| !self.is_lost(**k));
            let poses = placed.map(|&k| self.trip_pose(k)).collect();
            trips_of.entry(vehicle).or_default().push((trip, poses));
        }
        trips_of
            .values()
            .filter_map(|trips| suspect_vehicle(trips))
            .collect()
    }

    /// Whether a trip is one of scans.
    fn has_scans(&self, places: &[usize]) -> bool {
        places.iter().any(|&k| self.keyframes[k].scan.is_some())
    }

    fn trip_pose(&self, k: usize) -> TripPose {
        let keyframe = &self.keyframes[k];
        TripPose {
            node: keyframe.node,
            stamp: keyframe.stamp,
            map_from_base: self.graph.nodes()[k].pose,
            odom_from_base: keyframe.odom_from_base,
        }
    }

    fn mismatches_of(&self, trip: &TripId) -> Vec<Finding> {
        let nodes = self.graph.nodes();
        let others = self.keyframes.iter().zip(nodes);
        let others = others.filter(|(keyframe, _)| {
            keyframe.reference && keyframe.scan.is_some() && keyframe.trip != *trip
        });
        let references: Vec<_> = others.map(|(_, node)| (node.id, node.pose)).collect();
        let order = |k: &usize| self.keyframes[*k].trip_order;
        // Keyframes on both sides of others that have left are no run.
        let placed = self.trips[trip].iter().filter(|k| !self.is_lost(**k));
        let placed: Vec<usize> = placed.copied().collect();
        let runs = placed.chunk_by(|a, b| order(a) + 1 == order(b));
        let found = runs.flat_map(|run| {
            let poses: Vec<TiedPose> = run.iter().map(|&k| self.tied_pose(k)).collect();
            mismatches(trip, &poses, &references)
        });
        found.collect()
    }

    fn tied_pose(&self, k: usize) -> TiedPose {
        let node = self.graph.nodes()[k];
        let mut incident = self.graph.incident(k).iter();
        TiedPose {
            node: node.id,
            stamp: self.keyframes[k].stamp,
            pose: node.pose,
            tied: incident.any(|&edge| self.ties(edge, k)),
        }
    }

    /// Whether an edge is a closure from an older node to node `k`.
    fn ties(&self, edge: usize, k: usize) -> bool {
        self.graph.edges()[edge].kind == EdgeKind::LoopClosure && self.graph.ends()[edge].1 == k
    }
}

fn is_same(a: &Finding, b: &Finding) -> bool {
    a.kind == b.kind && (a.location - b.location).norm() <= SAME_FINDING_M
}

#[cfg(test)]
mod tests;
