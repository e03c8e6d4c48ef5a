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
