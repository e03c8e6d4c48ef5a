//! The map's observations as evidence of changes.

use std::collections::BTreeMap;

use super::route_map::RouteMap;
use crate::change::{
    AcceptedChange, Agreement, CandidateSite, Finding, Fit, KnownPose, Layer, MovedPose,
    ObservationKey, Observed, SHIFT_MAX_M, Screen, Screened, ShiftFit, Site, Suspect, TiedPose,
    Tier, displaced_segments, explain_by_shift, join_bands, join_counterparts, layer_of,
    mismatches, separate_bands, separate_counterparts, state_changes, support_min,
};
use crate::geometry::{Vector2, distance_to_polygon};
use crate::graph::{EdgeKind, EdgeStatus};
use crate::ids::{EdgeId, NodeId, TripId, VehicleId};
use crate::observation::{Observation, REACH_M};

/// Two findings of one kind this near to each other are one, found from two sides, metres.
const SAME_FINDING_M: f64 = 0.3;

/// What a pass observed this near to a segment says by which shift it fits, metres.
const SEGMENT_MARGIN_M: f64 = 1.0;

/// How observations fit what other passes found, as far as it was asked.
type Fits = BTreeMap<ObservationKey, Fit>;
/// By which observations had to be moved to fit, map frame, metres.
type Moved = BTreeMap<ObservationKey, Vector2<f64>>;

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
    /// Whose each trip is.
    pub vehicles: &'a BTreeMap<TripId, VehicleId>,
    /// The vehicles of which something is off.
    pub suspects: &'a [Suspect],
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
    /// What the observations of the map say: places that changed, and segments where the map does
    /// not fit; and the vehicles that are suspected, with the changes that their faults explain.
    pub fn findings(&mut self, scope: &Scope<'_>) -> Vec<Finding> {
        self.findings_and_hints(scope).0
    }

    /// Findings, and segments that may lie in the wrong place, since their scans fit elsewhere.
    pub(super) fn findings_and_hints(&mut self, scope: &Scope<'_>) -> (Vec<Finding>, Vec<Finding>) {
        self.update_screen();
        let mut moved = Moved::default();
        let mut findings = self.state_changes(scope, &mut moved);
        self.layers.mark_judged();
        let suspected = self.silence(&mut findings, scope);
        let seen = self.trips.iter();
        let seen = seen.filter(|(_, places)| self.has_scans(places));
        findings.extend(seen.flat_map(|(trip, _)| self.mismatches_of(trip)));
        findings.extend(suspected);
        (findings, displaced_segments(self.moved_poses(&moved)))
    }

    fn moved_poses(&self, moved: &Moved) -> Vec<MovedPose<'_>> {
        let poses = moved.iter().filter_map(|((node, _), by)| {
            let position = self.graph.node_position(*node)?;
            let keyframe = &self.keyframes[position];
            Some(MovedPose {
                node: *node,
                trip: &keyframe.trip,
                stamp: keyframe.stamp,
                pose: self.graph.nodes()[position].pose,
                by: *by,
            })
        });
        poses.collect()
    }

    /// Brings the screen up to date with the map, without a judgement: what has moved or left is
    /// no news.
    pub fn settle_screen(&mut self) {
        self.update_screen();
        self.layers.mark_judged();
    }

    fn update_screen(&mut self) {
        let mut layers = std::mem::take(&mut self.layers);
        let keyframes = self.keyframes.iter().zip(self.graph.nodes());
        // What a lost trip saw, nobody knows where.
        let keyframes = keyframes.filter(|(keyframe, _)| self.observes(keyframe));
        let observations = keyframes.flat_map(|(keyframe, node)| {
            keyframe.taken_scans(node.pose).map(|taken| Screened {
                key: (keyframe.node, taken.place),
                trip: &keyframe.trip,
                stamp: taken.stamp,
                map_from_base: taken.map_from_base,
                scan: taken.scan,
            })
        });
        layers.update(observations);
        self.layers = layers;
    }

    fn state_changes(&self, scope: &Scope<'_>, moved: &mut Moved) -> Vec<Finding> {
        // Each side of a change, in each band, is kept or judged anew on its own, and a segment
        // that a shift explains as a whole: what it was found by is not kept.
        let of_state = scope.pending.iter().filter(|f| f.kind.is_of_state());
        let of_state = separate_bands(separate_counterparts(of_state.cloned().collect()));
        let shifted = || scope.pending.iter().filter(|f| f.shift.is_some());
        let layers = self.layers.iter();
        let findings = layers.flat_map(|(layer, screen)| {
            let findings = self.judged_layer(layer, screen, &of_state, scope, moved);
            // What one shift explains is no change.
            let is_of_one_pass = |finding: &Finding| self.is_of_one_pass(finding);
            let fit = |mismatch: &Finding| self.shift_fit(layer, mismatch);
            let findings = explain_by_shift(findings, is_of_one_pass, fit);
            findings.into_iter().map(|f| self.with_segment(f))
        });
        // What several bands show is one event, and so is what left one place for another.
        let mut findings = join_counterparts(join_bands(findings.collect()));
        let is_kept = |finding: &&Finding| self.is_kept(finding, scope);
        findings.extend(shifted().filter(is_kept).cloned());
        findings
    }

    /// Whether a single pass shows a finding, or a single trip that never saw the place otherwise:
    /// such a trip may lie elsewhere from its beginning.
    fn is_of_one_pass(&self, finding: &Finding) -> bool {
        let [trip] = finding.trips.as_slice() else {
            return false;
        };
        let saw_it_before = |node: &NodeId| {
            let keyframe = self.keyframe(*node);
            keyframe.is_some_and(|k| k.trip == *trip && k.stamp < finding.since)
        };
        finding.laps <= 1 || !finding.nodes.iter().any(saw_it_before)
    }

    /// A mismatch with the keyframes of its segment, and with a region that covers them too; any
    /// other finding as it is.
    fn with_segment(&self, finding: Finding) -> Finding {
        if finding.shift.is_none() {
            return finding;
        }
        let segment = self.nodes_of_segment(&finding);
        let places = segment.iter().map(|(_, pose)| pose.translation());
        let places: Vec<Vector2<f64>> = places.collect();
        finding.on_segment(segment.iter().map(|(node, _)| *node).collect(), &places)
    }

    /// Whether a finding stands as it is, since nothing was touched near it in any layer.
    fn is_kept(&self, finding: &Finding, scope: &Scope<'_>) -> bool {
        scope.sites == Sites::Touched && !self.layers.is_touched(&finding.region)
    }

    /// The changes of state that one layer shows, and those of `pending` that it keeps.
    fn judged_layer(
        &self,
        layer: Layer,
        screen: &Screen,
        pending: &[Finding],
        scope: &Scope<'_>,
        moved: &mut Moved,
    ) -> Vec<Finding> {
        let shifted = scope.pending.iter().filter(|f| f.shift.is_some());
        let regions = pending.iter().chain(shifted).map(|f| f.region.as_slice());
        let sites = match scope.sites {
            Sites::Touched => {
                let is_touched = |region: &&[Vector2<f64>]| self.layers.is_touched(region);
                screen.touched_sites(regions.clone().filter(is_touched))
            }
            Sites::All => screen.all_sites(),
        };
        let trips: Vec<TripId> = self.trips.keys().cloned().collect();
        let mut fits = Fits::default();
        let mut findings: Vec<Finding> = Vec::new();
        for site in &sites {
            for mut found in self.judge(screen, site, &trips, scope, &mut fits) {
                found.bands = layer.into_iter().collect();
                match findings.iter_mut().find(|other| is_same(other, &found)) {
                    Some(same) if same.confidence >= found.confidence => {}
                    Some(same) => *same = found,
                    None => findings.push(found),
                }
            }
        }
        moved.extend(fits.iter().filter_map(|(key, fit)| {
            let position = self.graph.node_position(key.0)?;
            let pose = self.graph.nodes()[position].pose;
            let mut taken = self.keyframes[position].taken_scans(pose);
            let taken = taken.find(|taken| taken.place == key.1)?;
            let by = fit.map_from_base.translation() - taken.map_from_base.translation();
            Some((*key, by))
        }));
        let found = findings.iter().map(|f| f.region.as_slice());
        let regions: Vec<_> = found.chain(regions).map(<[_]>::to_vec).collect();
        let reliability = screen.reliability(&regions);
        for finding in &mut findings {
            if !reliability.confirms(finding.laps, scope.false_alerts_per_lap) {
                finding.tier = Tier::Tentative;
            }
        }
        let of_layer = pending.iter().filter(|f| f.bands.first().copied() == layer);
        for kept in of_layer.filter(|finding| self.is_kept(finding, scope)) {
            if !findings.iter().any(|found| is_same(found, kept)) {
                findings.push(kept.clone());
            }
        }
        findings
    }

    /// By which shift what a trip observed in a mismatch's region, in a layer, fits what others did
    /// there, and the trip itself before.
    fn shift_fit(&self, layer: Layer, mismatch: &Finding) -> Option<ShiftFit> {
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
        for (keyframe, node) in keyframes.filter(|(keyframe, _)| self.observes(keyframe)) {
            let is_own = mismatch.trips.contains(&keyframe.trip);
            let taken_scans = keyframe.taken_scans(node.pose);
            for taken in taken_scans.filter(|taken| layer_of(taken.scan) == layer) {
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
        screen: &Screen,
        site: &CandidateSite,
        trips: &[TripId],
        scope: &Scope<'_>,
        fits: &mut Fits,
    ) -> Vec<Finding> {
        let asked = screen.observations_of(site).into_iter();
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
        let mut findings = state_changes(&mut site, |observed| fit_of(screen, observed, fits));
        for finding in &mut findings {
            finding.edges = self.closures_across(finding);
        }
        findings
    }

    /// An observation of the map with the number of its trip.
    pub(super) fn observed(
        &self,
        (node, place): ObservationKey,
        trips: &[TripId],
    ) -> Option<Observed> {
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

    /// Whether a trip is one of scans.
    fn has_scans(&self, places: &[usize]) -> bool {
        places.iter().any(|&k| self.keyframes[k].scan.is_some())
    }

    fn mismatches_of(&self, trip: &TripId) -> Vec<Finding> {
        let nodes = self.graph.nodes();
        let first = self.trips[trip].first();
        let layer = first.map(|&k| self.keyframes[k].layer());
        let references = self.keyframes.iter().zip(nodes);
        let references = references.filter(|(keyframe, _)| {
            let has_scan = keyframe.reference && keyframe.scan.is_some();
            has_scan && Some(keyframe.layer()) == layer
        });
        let references: Vec<KnownPose> = references
            .map(|(keyframe, node)| KnownPose {
                node: node.id,
                pose: node.pose,
                trip_order: (keyframe.trip == *trip).then_some(keyframe.trip_order),
            })
            .collect();
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
            trip_order: self.keyframes[k].trip_order,
            tied: incident.any(|&edge| self.ties(edge, k)),
        }
    }

    /// Whether an edge is a closure from an older node to node `k`, and no false one.
    fn ties(&self, edge: usize, k: usize) -> bool {
        let (edge, (_, to)) = (&self.graph.edges()[edge], self.graph.ends()[edge]);
        edge.kind == EdgeKind::LoopClosure && edge.status != EdgeStatus::Quarantined && to == k
    }
}

/// How an observation fits the others of its layer, and where it fits better; each is asked but once.
fn fit_of(screen: &Screen, observed: &Observed, fits: &mut Fits) -> Fit {
    let key = (observed.node, observed.place);
    let scan = observed.observation.scan();
    let fit = fits.entry(key);
    *fit.or_insert_with(|| screen.fit(&key, scan, &observed.map_from_base))
}

fn is_same(a: &Finding, b: &Finding) -> bool {
    a.kind == b.kind && (a.location - b.location).norm() <= SAME_FINDING_M
}

#[cfg(test)]
mod band_tests;
#[cfg(test)]
mod tests;
