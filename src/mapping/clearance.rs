//! How near a change is to the way that vehicles took before it.

use super::route_map::RouteMap;
use crate::change::Finding;
use crate::geometry::polygon_gap;
use crate::model::Clearance;

/// Nearer to the way of a vehicle's base than this something stands in the way, metres: half the width
/// of a vehicle.
const BLOCKING_M: f64 = 0.4;
/// Nearer than this vehicles pass close by, metres.
const NEAR_M: f64 = 1.0;

impl RouteMap {
    /// How near a change of state is to the way that vehicles took before it, from keyframe to
    /// keyframe; `None` of any other finding, and if the map has nothing from before.
    pub fn clearance(&self, finding: &Finding) -> Option<Clearance> {
        if !finding.kind.is_of_state() {
            return None;
        }
        let gap_m = self.way_gap_m(finding)?;
        Some(if gap_m < BLOCKING_M {
            Clearance::Blocking
        } else if gap_m < NEAR_M {
            Clearance::Near
        } else {
            Clearance::Clear
        })
    }

    /// The distance of a finding's region from the nearest way before it, metres.
    fn way_gap_m(&self, finding: &Finding) -> Option<f64> {
        let is_before = |k: &usize| {
            let keyframe = &self.keyframes[*k];
            keyframe.stamp < finding.since && !keyframe.is_lost()
        };
        let place = |k: usize| self.graph.nodes()[k].pose.translation();
        let order = |k: usize| self.keyframes[k].trip_order;
        let mut nearest: Option<f64> = None;
        for trip in self.trips.values() {
            let before: Vec<usize> = trip.iter().copied().filter(is_before).collect();
            // Keyframes on both sides of others that have left are no way.
            for way in before.chunk_by(|a, b| order(*a) + 1 == order(*b)) {
                let ends = way.iter().zip(way.iter().skip(1).chain(way.last()));
                for (from, to) in ends {
                    let gap_m = polygon_gap(&[place(*from), place(*to)], &finding.region);
                    nearest = Some(nearest.map_or(gap_m, |least| least.min(gap_m)));
                }
            }
        }
        nearest
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::change::ChangeKind;
    use crate::change::testing::finding;
    use crate::geometry::Pose2;
    use crate::ids::{EdgeId, NodeId, StampNs, TripId};
    use crate::mapping::{Keyframe, Weighting};
    use crate::observation::testing::{World, all_round};

    /// One trip along the x axis, a keyframe every metre and second.
    fn map() -> RouteMap {
        let world = World::default().with_rectangle([-5.0, -5.0], [15.0, 5.0]);
        let lidar = Arc::new(all_round(90));
        let nodes = (0..10).map(|k| {
            let pose = Pose2::new(f64::from(k), 0.0, 0.0);
            let scan = world.scan(&lidar, 90, &pose, || 0.0);
            let (node, trip) = (NodeId(i64::from(k) + 1), TripId::new("monday").unwrap());
            let stamp = StampNs(i64::from(k) * 1_000_000_000);
            (pose, Keyframe::new(node, trip, stamp, pose, scan))
        });
        RouteMap::restore(Weighting::Robust, nodes, [], NodeId(11), EdgeId(1)).unwrap()
    }

    #[test]
    fn distance_counts_from_the_way_to_the_region() {
        let map = map();
        let clearance = |place, kind| map.clearance(&finding(kind, place, 0.2, 100));
        // Between two keyframes, and beside them.
        for (y, expected) in [
            (0.0, Clearance::Blocking),
            (0.59, Clearance::Blocking),
            (0.61, Clearance::Near),
            (1.19, Clearance::Near),
            (1.21, Clearance::Clear),
        ] {
            let found = clearance([4.5, y], ChangeKind::Appeared);
            assert_eq!(found, Some(expected), "{y} m");
        }
        let beyond = clearance([9.7, 0.0], ChangeKind::Disappeared);
        assert_eq!(beyond, Some(Clearance::Near), "the way ends there");
        assert_eq!(clearance([4.5, 0.0], ChangeKind::MapMismatch), None);
    }

    #[test]
    fn only_the_way_before_counts() {
        let at =
            |since_s| map().clearance(&finding(ChangeKind::Appeared, [8.5, 0.0], 0.2, since_s));
        assert_eq!(at(100), Some(Clearance::Blocking));
        assert_eq!(at(4), Some(Clearance::Clear), "it had come to 3 m");
        assert_eq!(at(0), None);
    }
}
