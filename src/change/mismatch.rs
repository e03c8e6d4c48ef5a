//! Closures that were expected and are missing: the map does not fit the place.

use super::region::{centroid, region_round};
use super::{ChangeKind, Finding, Tier};
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
/// `references` are those of other trips with their `map_from_base`.
///
/// A keyframe is tied to what the map has when it comes, so that it is expected at references of
/// smaller ids alone: whichever of two drives comes first, it is the second one that may be
/// missing its closures.
pub fn mismatches(
    trip: &TripId,
    poses: &[TiedPose],
    references: &[(NodeId, Pose2)],
) -> Vec<Finding> {
    let is_missing = |pose: &TiedPose| {
        let mut known = references.iter().filter(|(node, _)| *node < pose.node);
        !pose.tied && known.any(|(_, reference)| is_near(reference, &pose.pose))
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
        tier: Tier::Confirmed,
        counterpart: None,
        shift: None,
        suspect: None,
        bands: Vec::new(),
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

#[cfg(test)]
mod tests {
    use super::*;

    /// A drive along x whose keyframes are half a metre apart, from a node id on.
    fn drive(first_node: i64, count: i64, tied: impl Fn(i64) -> bool) -> Vec<TiedPose> {
        let pose = |k| TiedPose {
            node: NodeId(first_node + k),
            stamp: StampNs(k),
            pose: Pose2::new(0.5 * k as f64, 0.0, 0.0),
            tied: tied(k),
        };
        (0..count).map(pose).collect()
    }

    fn references(first_node: i64, count: i64) -> Vec<(NodeId, Pose2)> {
        let drive = drive(first_node, count, |_| true);
        drive.iter().map(|p| (p.node, p.pose)).collect()
    }

    fn missing(poses: &[TiedPose], references: &[(NodeId, Pose2)]) -> Vec<Vec<i64>> {
        let findings = mismatches(&TripId::new("t").unwrap(), poses, references);
        let nodes = findings.iter().map(|f| f.nodes.iter().map(|n| n.0));
        nodes.map(Iterator::collect).collect()
    }

    #[test]
    fn a_stretch_without_closures_beside_known_references_is_told() {
        let references = references(1, 60);
        let untied = |from: i64, end: i64| move |k: i64| !(from..end).contains(&k);
        let all_tied = drive(100, 60, |_| true);
        assert!(missing(&all_tied, &references).is_empty());
        assert!(missing(&drive(100, 60, untied(20, 31)), &references).is_empty());
        let told = missing(&drive(100, 60, untied(20, 32)), &references);
        assert_eq!(told, [Vec::from_iter(120..132)]);
    }

    #[test]
    fn nothing_is_expected_of_a_drive_that_was_there_first() {
        let first = drive(1, 60, |_| false);
        assert!(missing(&first, &references(100, 60)).is_empty());
        // Of two drives that come in turns, each is expected at what came before.
        let second = drive(130, 60, |_| false);
        let told = missing(&second, &references(100, 60));
        assert_eq!(told, [Vec::from_iter(130..190)]);
        assert!(missing(&second, &references(160, 60)).is_empty());
    }

    #[test]
    fn nothing_is_expected_where_no_reference_looks_the_same_way() {
        let untied = drive(100, 60, |_| false);
        let turned = references(1, 60).into_iter();
        let turned = turned.map(|(node, pose)| (node, pose.compose(&Pose2::new(0.0, 0.0, 0.6))));
        assert!(missing(&untied, &turned.collect::<Vec<_>>()).is_empty());
        let aside = references(1, 60).into_iter();
        let aside = aside.map(|(node, pose)| (node, pose.compose(&Pose2::new(0.0, 1.6, 0.0))));
        assert!(missing(&untied, &aside.collect::<Vec<_>>()).is_empty());
    }
}
