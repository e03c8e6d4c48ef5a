//! What a node of the graph remembers beside its pose.

use super::intermediate::IntermediateScan;
use crate::geometry::Pose2;
use crate::ids::{NodeId, StampNs, TripId};
use crate::scan::{KeyframeRule, LaserScan, SurfacePoint, surface_points};

/// A node's scan, and where it stands in its trip.
#[derive(Debug, Clone)]
pub struct Keyframe {
    /// The node.
    pub node: NodeId,
    /// The trip it belongs to.
    pub trip: TripId,
    /// Its place in its trip: 0, 1, 2 … Others of the trip may have left the map.
    pub trip_order: u32,
    /// When the vehicle was there.
    pub stamp: StampNs,
    /// Pose of the base in the vehicle's own odometry frame.
    pub odom_from_base: Pose2,
    /// Whether later laps are tied to it.
    pub reference: bool,
    /// Way driven since the trip was last tied to the map, metres; the uncertainty of a given
    /// pose counts as a way driven.
    pub drift_m: f64,
    /// What was seen; `None` for a node that came with edges alone.
    pub scan: Option<LaserScan>,
    /// The scan's returns with normals, base frame; none without a scan.
    pub points: Vec<SurfacePoint>,
    /// The trip's scans between this keyframe and its next, in the order of time.
    pub intermediate: Vec<IntermediateScan>,
}

/// Where the newest scan of a keyframe was taken.
pub(super) struct LastScan {
    /// When.
    pub stamp: StampNs,
    /// `keyframe_from_base`.
    pub pose: Pose2,
    /// In the vehicle's own odometry frame.
    pub odom_from_base: Pose2,
}

/// A scan of a keyframe, or of one of those behind it, at its pose.
#[derive(Debug, Clone, Copy)]
pub struct TakenScan<'a> {
    /// The keyframe's own (0), or its first, second … intermediate scan.
    pub place: u32,
    /// When.
    pub stamp: StampNs,
    /// Where the base was.
    pub map_from_base: Pose2,
    /// What was seen.
    pub scan: &'a LaserScan,
}

impl Keyframe {
    /// Projects the scan; the keyframe is no reference, has not drifted, and is its trip's first
    /// until a map puts it behind others.
    pub fn new(
        node: NodeId,
        trip: TripId,
        stamp: StampNs,
        odom_from_base: Pose2,
        scan: LaserScan,
    ) -> Self {
        let points = surface_points(&scan);
        Self {
            scan: Some(scan),
            points,
            ..Self::without_scan(node, trip, stamp, odom_from_base)
        }
    }

    /// As [`Keyframe::new`], of a node that has no scan.
    pub fn without_scan(node: NodeId, trip: TripId, stamp: StampNs, odom_from_base: Pose2) -> Self {
        Self {
            node,
            trip,
            trip_order: 0,
            stamp,
            odom_from_base,
            reference: false,
            drift_m: 0.0,
            scan: None,
            points: Vec::new(),
            intermediate: Vec::new(),
        }
    }

    /// The newest scan of its trip up to its next keyframe: its own, or the last one between that
    /// was not put off.
    pub(super) fn last_scan(&self, rule: &KeyframeRule) -> LastScan {
        let mut newest = self.intermediate.iter().rev();
        let last = newest.find(|following| !self.was_put_off(following, rule));
        last.map_or(
            LastScan {
                stamp: self.stamp,
                pose: Pose2::IDENTITY,
                odom_from_base: self.odom_from_base,
            },
            |following| LastScan {
                stamp: following.stamp,
                pose: following.keyframe_from_base,
                odom_from_base: following.odom_from_base,
            },
        )
    }

    /// How many scans since it would have been keyframes if anything had told where they were.
    pub(super) fn put_off_count(&self, rule: &KeyframeRule) -> usize {
        let newest = self.intermediate.iter().rev();
        newest
            .take_while(|following| self.was_put_off(following, rule))
            .count()
    }

    fn was_put_off(&self, following: &IntermediateScan, rule: &KeyframeRule) -> bool {
        rule.is_due(&self.odom_from_base.between(&following.odom_from_base))
    }

    /// Its own scan and those between it and its trip's next keyframe that were kept.
    pub fn taken_scans(&self, map_from_keyframe: Pose2) -> impl Iterator<Item = TakenScan<'_>> {
        let own = self.scan.as_ref().map(|scan| TakenScan {
            place: 0,
            stamp: self.stamp,
            map_from_base: map_from_keyframe,
            scan,
        });
        let following = (1..).zip(&self.intermediate);
        let following = following.filter_map(move |(place, following)| {
            Some(TakenScan {
                place,
                stamp: following.stamp,
                map_from_base: map_from_keyframe.compose(&following.keyframe_from_base),
                scan: following.scan.as_ref()?,
            })
        });
        own.into_iter().chain(following)
    }

    /// About how much memory it takes, bytes.
    pub(super) fn size_bytes(&self) -> usize {
        size_of::<Self>()
            + size_of_val(self.points.as_slice())
            + self.scan.as_ref().map_or(0, |s| size_of_val(s.ticks()))
            + self
                .intermediate
                .iter()
                .map(IntermediateScan::size_bytes)
                .sum::<usize>()
            + NODE_BYTES
    }
}

/// A node in the graph and in its indices.
const NODE_BYTES: usize = 256;
