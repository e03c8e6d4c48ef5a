//! How far a job moves what was mapped before it: more than its route allows, and nothing of it is
//! taken into the map.

use std::fmt;

use crate::geometry::{Pose2, Vector2};
use crate::ids::NodeId;
use crate::mapping::{Keyframe, RouteMap};

/// Where nodes were before a job, in the order of the graph.
pub(super) struct PosesBefore(Vec<(NodeId, Pose2)>);

/// A node that a job moved farther than any other.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Shift {
    /// Where it was in the map, metres.
    from: Vector2<f64>,
    /// How far it moved, metres.
    distance_m: f64,
}

impl PosesBefore {
    /// The nodes of a map that a job is about to extend, but for those that it may move.
    pub fn of(map: &RouteMap, may_move: impl Fn(&Keyframe) -> bool) -> Self {
        let nodes = map.keyframes().iter().zip(map.graph().nodes());
        let kept = nodes.filter(|(keyframe, _)| !may_move(keyframe));
        Self(kept.map(|(_, node)| (node.id, node.pose)).collect())
    }

    /// The node that has moved farthest since, if that is farther than `max_shift_m`.
    pub fn too_far(&self, map: &RouteMap, max_shift_m: f64) -> Option<Shift> {
        let farthest = self.farthest(map);
        farthest.filter(|shift| shift.distance_m > max_shift_m)
    }

    /// How far the node that has moved farthest since has moved, metres.
    pub fn farthest_m(&self, map: &RouteMap) -> f64 {
        self.farthest(map).map_or(0.0, |shift| shift.distance_m)
    }

    fn farthest(&self, map: &RouteMap) -> Option<Shift> {
        let moved = self.0.iter().filter_map(|(id, before)| {
            let now = map.graph().node(*id)?.pose;
            let from = before.translation();
            Some(Shift {
                from,
                distance_m: (now.translation() - from).norm(),
            })
        });
        moved.max_by(|a, b| a.distance_m.total_cmp(&b.distance_m))
    }
}

impl fmt::Display for Shift {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "it would move what others have mapped by {:.2} m, near ({:.1}, {:.1})",
            self.distance_m, self.from.x, self.from.y
        )
    }
}
