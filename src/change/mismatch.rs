//! Closures that were expected and are missing: the map does not fit the place.

use super::region::{centroid, region_round};
use super::{ChangeKind, Finding};
use crate::geometry::{Pose2, angle_difference_rad};
use crate::ids::{NodeId, StampNs, TripId};

/// A keyframe is expected to be tied to a reference that is no farther than this, metres,
const NEAR_M: f64 = 1.5;
/// and turned by no more than this, radians.
const NEAR_RAD: f64 = 0.5;
/// So many keyframes in a row without a closure are a mismatch.
const MISSING_MIN: usize = 12;
/// Radius round each of their poses, metres.
const REGION_RADIUS_M: f64 = 0.5;

/// A keyframe of a trip, as far as its closures go.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TiedPose {
    /// The node.
    pub node: NodeId,
    /// When.
    pub stamp: StampNs,
    /// `map_from_base`.
    pub pose: Pose2,
    /// Whether a closure ties it to a reference.
    pub tied: bool,
}

/// Stretches of a trip that other trips' references cover, and no closure ties to them.
/// `references` are those of other trips.
pub fn mismatches(trip: &TripId, poses: &[TiedPose], references: &[Pose2]) -> Vec<Finding> {
    let is_missing = |pose: &TiedPose| {
        !pose.tied
            && references
                .iter()
                .any(|reference| is_near(reference, &pose.pose))
    };
    let runs = poses.chunk_by(|a, b| is_missing(a) == is_missing(b));
    let missing = runs.filter(|run| run.len() >= MISSING_MIN && is_missing(&run[0]));
    missing.map(|run| finding_of(trip, run)).collect()
}

fn is_near(a: &Pose2, b: &Pose2) -> bool {
    (a.translation() - b.translation()).norm() <= NEAR_M
        && angle_difference_rad(a.theta, b.theta) <= NEAR_RAD
}

fn finding_of(trip: &TripId, run: &[TiedPose]) -> Finding {
    let places: Vec<_> = run.iter().map(|pose| pose.pose.translation()).collect();
    let region = region_round(&places, REGION_RADIUS_M);
    let mut nodes: Vec<NodeId> = run.iter().map(|pose| pose.node).collect();
    nodes.sort_unstable();
    Finding {
        kind: ChangeKind::MapMismatch,
        location: centroid(&region),
        sigma_m: REGION_RADIUS_M,
        region,
        edges: Vec::new(),
        nodes,
        trips: vec![trip.clone()],
        views: run.len(),
        laps: 1,
        confidence: 1.0 - 0.8_f64.powi(run.len() as i32),
        since: run[0].stamp,
        last_seen: run[run.len() - 1].stamp,
        until: None,
    }
}
