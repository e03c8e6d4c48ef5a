//! Segments of a trip whose scans all fit better elsewhere, by one shift.
//!
//! Where there is much to see, a misplaced pass shows no changes: its observations are moved to where they fit
//! before sites are judged. That all of them had to be moved by the same vector shows that the map is wrong.

use super::median::median;
use super::shift_fit::{SHIFT_MAX_M, SHIFT_MIN_M};
use super::{ChangeKind, Finding, Tier};
use crate::geometry::{Pose2, Vector2};
use crate::ids::{NodeId, StampNs, TripId};

/// Fewest keyframes of a segment.
const KEYFRAMES_MIN: usize = 5;
/// Largest time between neighbours of a segment, nanoseconds.
const APART_MAX_NS: i64 = 30_000_000_000;
/// Largest difference of neighbours' shifts, metres.
const SAME_SHIFT_M: f64 = 0.15;

/// A keyframe one of whose observations fits better elsewhere.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MovedPose<'a> {
    /// The node.
    pub node: NodeId,
    /// Its trip.
    pub trip: &'a TripId,
    /// Its stamp.
    pub stamp: StampNs,
    /// `map_from_base` as the map has it.
    pub pose: Pose2,
    /// The shift at which it fits better, map frame, metres.
    pub by: Vector2<f64>,
}

/// Segments of trips that fit better elsewhere, as mismatches with the shift that would correct them. They do
/// not say which of two passes is wrong.
pub fn displaced_segments(mut poses: Vec<MovedPose<'_>>) -> Vec<Finding> {
    poses.retain(|pose| (SHIFT_MIN_M..=SHIFT_MAX_M).contains(&pose.by.norm()));
    poses.sort_by(|a, b| (a.trip, a.stamp, a.node).cmp(&(b.trip, b.stamp, b.node)));
    poses.dedup_by_key(|pose| pose.node);
    let is_next = |a: &MovedPose<'_>, b: &MovedPose<'_>| {
        a.trip == b.trip
            && b.stamp.0 - a.stamp.0 <= APART_MAX_NS
            && (a.by - b.by).norm() <= SAME_SHIFT_M
    };
    let runs = poses.chunk_by(is_next);
    let segments = runs.filter(|run| run.len() >= KEYFRAMES_MIN);
    segments.map(finding_of).collect()
}

fn finding_of(run: &[MovedPose<'_>]) -> Finding {
    let along = |axis: usize| {
        let mut values: Vec<f64> = run.iter().map(|pose| pose.by[axis]).collect();
        median(&mut values)
    };
    let places: Vec<_> = run.iter().map(|pose| pose.pose.translation()).collect();
    let finding = Finding {
        tier: Tier::Tentative,
        counterpart: None,
        shift: Some(Vector2::new(along(0), along(1))),
        suspect: None,
        bands: Vec::new(),
        kind: ChangeKind::MapMismatch,
        location: places[0],
        sigma_m: SAME_SHIFT_M,
        region: Vec::new(),
        edges: Vec::new(),
        nodes: Vec::new(),
        trips: vec![run[0].trip.clone()],
        views: run.len(),
        laps: 1,
        confidence: 1.0 - 0.8_f64.powi(run.len() as i32),
        since: run[0].stamp,
        last_seen: run[run.len() - 1].stamp,
        until: None,
    };
    finding.on_segment(run.iter().map(|pose| pose.node).collect(), &places)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn poses(trip: &TripId, count: i64, by: impl Fn(i64) -> [f64; 2]) -> Vec<MovedPose<'_>> {
        let pose = |k| MovedPose {
            node: NodeId(k),
            trip,
            stamp: StampNs(1_000_000_000 * k),
            pose: Pose2::new(0.5 * k as f64, 0.0, 0.0),
            by: by(k).into(),
        };
        (0..count).map(pose).collect()
    }

    #[test]
    fn keyframes_in_a_row_that_are_moved_alike_are_a_segment() {
        let trip = TripId::new("t").unwrap();
        let found = displaced_segments(poses(&trip, 9, |k| [0.4, 0.01 * k as f64]));
        assert_eq!(found.len(), 1);
        assert!((found[0].shift.unwrap() - Vector2::new(0.4, 0.04)).norm() < 1e-9);
        assert_eq!(found[0].nodes, Vec::from_iter((0..9).map(NodeId)));
        // Too few, moved hardly or each elsewhere.
        assert!(displaced_segments(poses(&trip, 4, |_| [0.4, 0.0])).is_empty());
        assert!(displaced_segments(poses(&trip, 9, |_| [0.04, 0.0])).is_empty());
        let turning = |k: i64| [0.4 * (k as f64).cos(), 0.4 * (k as f64).sin()];
        assert!(displaced_segments(poses(&trip, 9, turning)).is_empty());
    }
}
