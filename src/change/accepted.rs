//! A change that was accepted into the map.

use crate::geometry::{Vector2, distance_to_polygon};
use crate::ids::{AlertId, EdgeId, NodeId, StampNs};

/// Margin of the region of an accepted change, metres.
pub const ACCEPTED_MARGIN_M: f64 = 0.1;

/// A change of the world that was accepted into a route's map: in its region, observations from before the
/// change no longer count.
#[derive(Debug, Clone, PartialEq)]
pub struct AcceptedChange {
    /// The alert that was accepted.
    pub alert_id: AlertId,
    /// A simple polygon, map frame, metres, counter-clockwise, not closed; the change reaches
    /// [`ACCEPTED_MARGIN_M`] beyond it.
    pub region: Vec<Vector2<f64>>,
    /// The first observation of the new state.
    pub since: StampNs,
    /// The version of the map that began with it.
    pub map_version: i64,
    /// The nodes whose scans show the place, ascending.
    pub nodes: Vec<NodeId>,
    /// The first edge id not used when it was accepted.
    pub first_edge_id: EdgeId,
}

impl AcceptedChange {
    /// Whether a point of the map frame lies in the region or within [`ACCEPTED_MARGIN_M`] of it.
    pub fn covers(&self, point: &Vector2<f64>) -> bool {
        distance_to_polygon(point, &self.region) <= ACCEPTED_MARGIN_M
    }

    /// Whether an observation of this point at this time is out of date.
    pub fn outdates(&self, stamp: StampNs, point: &Vector2<f64>) -> bool {
        stamp < self.since && self.covers(point)
    }

    /// Whether a closure has left the baseline of its residual series: it was made before the acceptance and
    /// ends at a node that shows the place. There the baseline restarts with later closures.
    pub fn leaves_baseline(&self, edge: EdgeId, from: NodeId, to: NodeId) -> bool {
        let shows = |node: &NodeId| self.nodes.binary_search(node).is_ok();
        edge < self.first_edge_id && (shows(&from) || shows(&to))
    }
}

/// Whether a closure is in the baseline of its residual series: none of the accepted changes has
/// taken it out, as [`AcceptedChange::leaves_baseline`] says.
pub fn is_in_baseline(accepted: &[AcceptedChange], edge: EdgeId, ends: [NodeId; 2]) -> bool {
    let [from, to] = ends;
    let has_left = |change: &AcceptedChange| change.leaves_baseline(edge, from, to);
    !accepted.iter().any(has_left)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn accepted() -> AcceptedChange {
        AcceptedChange {
            alert_id: AlertId(uuid::Uuid::nil()),
            region: [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]
                .map(Vector2::from)
                .to_vec(),
            since: StampNs(100),
            map_version: 2,
            nodes: vec![NodeId(3), NodeId(8)],
            first_edge_id: EdgeId(50),
        }
    }

    #[test]
    fn earlier_observations_are_out_of_date_inside_and_a_little_beyond() {
        let change = accepted();
        for (x, y, covered) in [
            (0.5, 0.5, true),
            (1.09, 0.5, true),
            (1.08, 1.08, false),
            (1.11, 0.5, false),
        ] {
            let point = Vector2::new(x, y);
            assert_eq!(change.outdates(StampNs(99), &point), covered, "{point}");
            assert!(!change.outdates(StampNs(100), &point));
        }
    }

    #[test]
    fn earlier_closures_at_the_place_leave_the_baseline() {
        let change = accepted();
        assert!(change.leaves_baseline(EdgeId(49), NodeId(1), NodeId(8)));
        assert!(change.leaves_baseline(EdgeId(1), NodeId(3), NodeId(4)));
        assert!(!change.leaves_baseline(EdgeId(50), NodeId(3), NodeId(8)));
        assert!(!change.leaves_baseline(EdgeId(49), NodeId(1), NodeId(2)));
    }
}
