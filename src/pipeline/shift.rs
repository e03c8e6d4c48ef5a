//! How far a job moves what was mapped before it. A job that moves it farther than the route allows is
//! refused.

use std::fmt;

use crate::geometry::{Pose2, Vector2};
use crate::ids::NodeId;
use crate::mapping::{Keyframe, RouteMap};
use crate::store::NodeChange;

/// A pose may always move by this many of its standard deviations.
const SIGMAS: f64 = 3.0;

/// Where nodes were before a job, in the order of the graph.
pub(super) struct PosesBefore(Vec<PoseBefore>);

struct PoseBefore {
    node: NodeId,
    pose: Pose2,
    /// How far it may move, metres.
    shift_max_m: f64,
}

/// A node that a job moved farther than any other.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Shift {
    /// Where it was in the map, metres.
    from: Vector2<f64>,
    /// How far it moved, metres.
    distance_m: f64,
}

impl PosesBefore {
    /// The nodes of a map before a job, without those that it `may_move` anywhere. The others may move by
    /// `shift_max_m`.
    pub fn of(map: &RouteMap, shift_max_m: f64, may_move: impl Fn(&Keyframe) -> bool) -> Self {
        let nodes = map.keyframes().iter().zip(map.graph().nodes());
        let kept = nodes.filter(|(keyframe, _)| !may_move(keyframe));
        let kept = kept.map(|(_, node)| PoseBefore {
            node: node.id,
            pose: node.pose,
            shift_max_m,
        });
        Self(kept.collect())
    }

    /// The same, but uncertain poses may move by [`SIGMAS`] standard deviations. `known` is sorted by id.
    #[must_use]
    pub fn within_sigmas(mut self, known: &[NodeChange]) -> Self {
        for before in &mut self.0 {
            let place = known.binary_search_by_key(&before.node, |known| known.id);
            let sigma = place.ok().and_then(|place| known[place].sigma);
            if let Some(sigma) = sigma {
                let uncertain_m = SIGMAS * sigma.x_m.max(sigma.y_m);
                before.shift_max_m = before.shift_max_m.max(uncertain_m);
            }
        }
        self
    }

    /// Of the nodes that have moved farther than allowed, the one that moved farthest.
    pub fn too_far(&self, map: &RouteMap) -> Option<Shift> {
        let moved = self.moved(map);
        let too_far = moved.filter(|(before, shift)| shift.distance_m > before.shift_max_m);
        let too_far = too_far.map(|(_, shift)| shift);
        too_far.max_by(|a, b| a.distance_m.total_cmp(&b.distance_m))
    }

    /// The largest displacement of a node, metres.
    pub fn farthest_m(&self, map: &RouteMap) -> f64 {
        let distances_m = self.moved(map).map(|(_, shift)| shift.distance_m);
        distances_m.fold(0.0, f64::max)
    }

    /// The displacement of each node that is still in the map.
    fn moved(&self, map: &RouteMap) -> impl Iterator<Item = (&PoseBefore, Shift)> {
        self.0.iter().filter_map(|before| {
            let now = map.graph().node(before.node)?.pose;
            let from = before.pose.translation();
            let distance_m = (now.translation() - from).norm();
            Some((before, Shift { from, distance_m }))
        })
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
