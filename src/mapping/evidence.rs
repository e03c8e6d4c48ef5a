//! The map's scans as evidence of changes.

use std::collections::BTreeMap;

use super::partners::Placed;
use super::route_map::RouteMap;
use crate::change::{
    AcceptedChange, Evidence, Finding, Look, Suspicion, TiedPose, TripPose, detect, mismatches,
    suspect_vehicle,
};
use crate::geometry::{Pose2, Vector2};
use crate::graph::{EdgeKind, EdgeStatus};
use crate::ids::{EdgeId, TripId, VehicleId};
use crate::matching::{View, Visibility};

/// Depth tolerance of the comparison of two scans, metres.
const TOLERANCE_M: f64 = 0.12;
/// What a metre of range adds to it: three standard deviations of a pose's turn, at a slant.
const TOLERANCE_PER_RANGE: f64 = 0.012;
/// Standard deviations of the two ranges in it.
const TOLERANCE_SIGMAS: f64 = 4.0;

/// The points by which the two scans of a closure contradict each other.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Contradictions {
    /// Places in the new node's points: they lie in the old scan's free space.
    pub new_in_old: Vec<usize>,
    /// Places in the old node's points: they lie in the new scan's free space.
    pub old_in_new: Vec<usize>,
}

impl Contradictions {
    /// About how much memory they take, bytes.
    pub fn size_bytes(&self) -> usize {
        size_of::<Self>()
            + size_of_val(self.new_in_old.as_slice())
            + size_of_val(self.old_in_new.as_slice())
    }

    /// Of two scans that were matched.
    pub fn between(old: &Placed<'_>, new: &Placed<'_>, old_from_new: &Pose2) -> Self {
        Self {
            new_in_old: in_free_space(new, old, old_from_new),
            old_in_new: in_free_space(old, new, &old_from_new.inverse()),
        }
    }
}

fn in_free_space(
    points: &Placed<'_>,
    seen_by: &Placed<'_>,
    seen_by_from_points: &Pose2,
) -> Vec<usize> {
    let (Some(points_scan), Some(scan)) = (&points.keyframe.scan, &seen_by.keyframe.scan) else {
        return Vec::new();
    };
    let view = View::new(scan);
    let to_seen_by = seen_by_from_points.to_transform();
    let sigma_m = [points_scan, scan]
        .map(|scan| scan.lidar().range_sigma_m)
        .into_iter()
        .fold(0.0, f64::hypot);
    let is_free = |position: &Vector2<f64>| {
        let position = to_seen_by.apply(position);
        let tolerance_m =
            TOLERANCE_M + TOLERANCE_PER_RANGE * position.norm() + TOLERANCE_SIGMAS * sigma_m;
        view.look_at(&position, tolerance_m) == Visibility::Free
    };
    let points = points.keyframe.points.iter().enumerate();
    points
        .filter(|(_, point)| is_free(&point.position))
        .map(|(k, _)| k)
        .collect()
}

/// What findings are asked for.
pub struct Scope<'a> {
    /// Spots are decided anew where closures from this one on raise a suspicion,
    pub fresh_from: EdgeId,
    /// and in these regions (map frame).
    pub watched: &'a [Vec<Vector2<f64>>],
    /// What the map has taken in already.
    pub accepted: &'a [AcceptedChange],
    /// Whose each trip is; a trip that is not named is its own vehicle's.
    pub vehicles: &'a BTreeMap<TripId, VehicleId>,
}

impl RouteMap {
    /// What the scans of the map say: places that changed, vehicles whose lidar is turned, and
    /// stretches where the map does not fit. A change that only suspected vehicles saw is left
    /// out.
    pub fn findings(&self, scope: &Scope<'_>) -> Vec<Finding> {
        let suspects = self.suspected_vehicles(scope.vehicles);
        let is_suspected = |trip: &TripId| suspects.iter().any(|s| s.trips.contains(trip));
        let trips: Vec<TripId> = self.trips.keys().cloned().collect();
        let mut findings = detect(&Evidence {
            looks: &self.looks(),
            trips: &trips,
            suspicions: &self.suspicions(scope.fresh_from),
            accepted: scope.accepted,
            watched: scope.watched,
        });
        findings.retain(|finding| !finding.trips.iter().all(is_suspected));
        let seen = || {
            self.trips
                .iter()
                .filter(|(_, places)| self.has_scans(places))
        };
        findings.extend(seen().flat_map(|(trip, _)| self.mismatches_of(trip)));
        findings.extend(suspects);
        findings
    }

    fn suspected_vehicles(&self, vehicles: &BTreeMap<TripId, VehicleId>) -> Vec<Finding> {
        let mut trips_of: BTreeMap<Result<&VehicleId, &TripId>, Vec<_>> = BTreeMap::new();
        let seen = self.trips.iter();
        for (trip, places) in seen.filter(|(_, places)| self.has_scans(places)) {
            let vehicle = vehicles.get(trip).ok_or(trip);
            let poses = places.iter().map(|&k| self.trip_pose(k)).collect();
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
        let runs = self.trips[trip].chunk_by(|a, b| order(a) + 1 == order(b));
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

    fn looks(&self) -> Vec<Look<'_>> {
        let nodes = self.graph.nodes();
        let mut looks = Vec::with_capacity(nodes.len());
        for (trip, places) in self.trips.values().enumerate() {
            for &k in places {
                let keyframe = &self.keyframes[k];
                let Some(scan) = &keyframe.scan else {
                    continue;
                };
                let order = keyframe.trip_order as usize;
                let look = Look::new(
                    keyframe.node,
                    (trip, order),
                    keyframe.stamp,
                    &nodes[k].pose,
                    scan,
                );
                looks.push(look.with_pose_error(self.pose_error_m(k)));
            }
        }
        looks
    }

    /// How far node `k` is from where its closures have it, metres: the farthest of them tells,
    /// since nothing tells which is right.
    fn pose_error_m(&self, k: usize) -> f64 {
        let edges = self.graph.incident(k).iter();
        let closures = edges
            .map(|&edge| &self.graph.edges()[edge])
            .filter(|edge| edge.kind == EdgeKind::LoopClosure && edge.status == EdgeStatus::Active);
        let errors = closures.filter_map(|edge| self.graph.error_of(edge));
        errors.map(|e| e.x.hypot(e.y)).fold(0.0, f64::max)
    }

    fn suspicions(&self, fresh_from: EdgeId) -> Vec<Suspicion> {
        let mut suspicions = Vec::new();
        for (&edge, contradictions) in &self.contradictions {
            let Some(position) = self.graph.edge_position(edge) else {
                continue;
            };
            let (old, new) = self.graph.ends()[position];
            let [a, b] = [old, new].map(|k| self.keyframes[k].stamp);
            let sides = [
                (new, &contradictions.new_in_old),
                (old, &contradictions.old_in_new),
            ];
            for (k, points) in sides {
                let placed = self.placed(k);
                let to_map = placed.pose.to_transform();
                suspicions.extend(points.iter().map(|&point| Suspicion {
                    edge,
                    node: placed.keyframe.node,
                    taken: (a.min(b), a.max(b)),
                    spot: to_map.apply(&placed.keyframe.points[point].position),
                    fresh: edge >= fresh_from,
                }));
            }
        }
        suspicions
    }

    /// The contradictions of all closures, from their scans and measurements.
    pub(super) fn compare_closures(&self) -> BTreeMap<EdgeId, Contradictions> {
        let edges = self.graph.edges().iter().zip(self.graph.ends());
        let closures = edges.filter(|(edge, _)| edge.kind == EdgeKind::LoopClosure);
        closures
            .map(|(edge, &(old, new))| {
                let (old, new) = (self.placed(old), self.placed(new));
                (
                    edge.id,
                    Contradictions::between(&old, &new, &edge.measurement),
                )
            })
            .collect()
    }
}
