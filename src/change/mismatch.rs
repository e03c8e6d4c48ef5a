//! Missing closures where they were expected: the map is wrong there.

use super::region::{centroid, region_round};
use super::{ChangeKind, Finding, Tier};
use crate::geometry::{Pose2, Vector2, angle_difference_rad};
use crate::ids::{NodeId, StampNs, TripId};

/// A keyframe is expected to be tied to a reference that is no farther than this, metres,
const NEAR_M: f64 = 1.5;
/// and turned by no more than this, radians.
const NEAR_RAD: f64 = 0.5;
/// This many keyframes in a row without a closure are a mismatch.
const MISSING_MIN: usize = 12;
/// In its own trip a keyframe is expected to be tied to those at least this many keyframes earlier. The newest
/// are no loop-closure candidates, and a vehicle that turns on the spot has not come back yet.
const RECENT_KEYFRAMES: u32 = 40;
/// Radius of the region round each pose, metres.
const REGION_RADIUS_M: f64 = 0.5;

/// A keyframe of a trip, and whether a closure ties it to a reference.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TiedPose {
    /// The node.
    pub node: NodeId,
    /// Its stamp.
    pub stamp: StampNs,
    /// `map_from_base`.
    pub pose: Pose2,
    /// Its number in its trip.
    pub trip_order: u32,
    /// Whether a closure ties it to a reference.
    pub tied: bool,
}

/// A reference that a keyframe may be tied to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KnownPose {
    /// The node.
    pub node: NodeId,
    /// `map_from_base`.
    pub pose: Pose2,
    /// Its number in the trip that is tested, if it belongs to it.
    pub trip_order: Option<u32>,
}

/// Segments of a trip that are covered by references, of other trips or of an earlier lap, but that no closure
/// ties to them.
///
/// A keyframe is matched with references that the map has when it arrives, so only those with smaller ids are
/// expected: of two trips the one that arrives second may lack closures.
pub fn mismatches(trip: &TripId, poses: &[TiedPose], references: &[KnownPose]) -> Vec<Finding> {
    let is_missing = |pose: &TiedPose| {
        let is_known = |reference: &&KnownPose| {
            let own = reference.trip_order;
            reference.node < pose.node
                && own.is_none_or(|order| order + RECENT_KEYFRAMES < pose.trip_order)
        };
        let mut known = references.iter().filter(is_known);
        !pose.tied && known.any(|reference| is_near(&reference.pose, &pose.pose))
    };
    let runs = poses.chunk_by(|a, b| is_missing(a) == is_missing(b));
    let missing = runs.filter(|run| run.len() >= MISSING_MIN && is_missing(&run[0]));
    missing.map(|run| finding_of(trip, run)).collect()
}

fn is_near(a: &Pose2, b: &Pose2) -> bool {
    (a.translation() - b.translation()).norm() <= NEAR_M
        && angle_difference_rad(a.theta, b.theta) <= NEAR_RAD
}

impl Finding {
    /// A mismatch that names the keyframes of its segment and whose region covers their `places` too (map frame,
    /// metres).
    pub fn on_segment(mut self, mut nodes: Vec<NodeId>, places: &[Vector2<f64>]) -> Self {
        nodes.sort_unstable();
        let path = region_round(places, REGION_RADIUS_M);
        self.region = region_round(&[self.region.as_slice(), &path].concat(), 0.0);
        self.location = centroid(&self.region);
        self.nodes = nodes;
        self
    }
}

fn finding_of(trip: &TripId, run: &[TiedPose]) -> Finding {
    let places: Vec<_> = run.iter().map(|pose| pose.pose.translation()).collect();
    let nodes = run.iter().map(|pose| pose.node).collect();
    let finding = Finding {
        tier: Tier::Confirmed,
        counterpart: None,
        shift: None,
        suspect: None,
        bands: Vec::new(),
        kind: ChangeKind::MapMismatch,
        location: places[0],
        sigma_m: REGION_RADIUS_M,
        region: Vec::new(),
        edges: Vec::new(),
        nodes: Vec::new(),
        trips: vec![trip.clone()],
        views: run.len(),
        laps: 1,
        confidence: 1.0 - 0.8_f64.powi(run.len() as i32),
        since: run[0].stamp,
        last_seen: run[run.len() - 1].stamp,
        until: None,
    };
    finding.on_segment(nodes, &places)
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
            trip_order: k as u32,
            tied: tied(k),
        };
        (0..count).map(pose).collect()
    }

    /// References of another trip.
    fn references(first_node: i64, count: i64) -> Vec<KnownPose> {
        known(&drive(first_node, count, |_| true), |_| None)
    }

    fn known(poses: &[TiedPose], trip_order: impl Fn(&TiedPose) -> Option<u32>) -> Vec<KnownPose> {
        let of_pose = |p: &TiedPose| KnownPose {
            node: p.node,
            pose: p.pose,
            trip_order: trip_order(p),
        };
        poses.iter().map(of_pose).collect()
    }

    fn missing(poses: &[TiedPose], references: &[KnownPose]) -> Vec<Vec<i64>> {
        let findings = mismatches(&TripId::new("t").unwrap(), poses, references);
        let nodes = findings.iter().map(|f| f.nodes.iter().map(|n| n.0));
        nodes.map(Iterator::collect).collect()
    }

    #[test]
    fn a_segment_without_closures_beside_known_references_is_reported() {
        let references = references(1, 60);
        let untied = |from: i64, end: i64| move |k: i64| !(from..end).contains(&k);
        let all_tied = drive(100, 60, |_| true);
        assert!(missing(&all_tied, &references).is_empty());
        assert!(missing(&drive(100, 60, untied(20, 31)), &references).is_empty());
        let found = missing(&drive(100, 60, untied(20, 32)), &references);
        assert_eq!(found, [Vec::from_iter(120..132)]);
    }

    #[test]
    fn nothing_is_expected_of_a_drive_that_was_there_first() {
        let first = drive(1, 60, |_| false);
        assert!(missing(&first, &references(100, 60)).is_empty());
        // Of two drives that come in turns, each is expected at what came before.
        let second = drive(130, 60, |_| false);
        let found = missing(&second, &references(100, 60));
        assert_eq!(found, [Vec::from_iter(130..190)]);
        assert!(missing(&second, &references(160, 60)).is_empty());
    }

    #[test]
    fn nothing_is_expected_where_no_reference_looks_the_same_way() {
        let untied = drive(100, 60, |_| false);
        for off in [Pose2::new(0.0, 0.0, 0.6), Pose2::new(0.0, 1.6, 0.0)] {
            let mut references = references(1, 60);
            for reference in &mut references {
                reference.pose = reference.pose.compose(&off);
            }
            assert!(missing(&untied, &references).is_empty());
        }
    }

    /// Two laps of one trip, the second of them tied nowhere.
    #[test]
    fn a_trip_that_never_ends_is_expected_where_it_was_itself_laps_ago() {
        let mut laps = drive(1, 60, |_| true);
        let second = drive(61, 60, |_| false).into_iter().enumerate();
        laps.extend(second.map(|(k, pose)| TiedPose {
            trip_order: 60 + k as u32,
            ..pose
        }));
        let own = known(&laps, |p| Some(p.trip_order));
        assert_eq!(missing(&laps, &own), [Vec::from_iter(61..121)]);
        // Nowhere is it expected at what it has only just driven.
        let at_once = drive(1, 60, |_| false);
        let here = |pose: &TiedPose| TiedPose {
            pose: Pose2::IDENTITY,
            ..*pose
        };
        let turning: Vec<TiedPose> = at_once.iter().map(here).take(40).collect();
        let own = known(&turning, |p| Some(p.trip_order));
        assert!(missing(&turning, &own).is_empty());
    }
}
