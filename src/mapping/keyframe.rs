//! What a node of the graph remembers beside its pose.

use super::intermediate::IntermediateScan;
use crate::change::{Layer, layer_of};
use crate::geometry::{Pose2, Vector2};
use crate::ids::{LidarId, NodeId, StampNs, TripId};
use crate::matching::Views;
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
    /// Which of the vehicle's lidars saw it; `None` for its only one.
    pub lidar: Option<LidarId>,
    /// The scan's returns with normals, base frame, and after them those that companions lend;
    /// none without a scan.
    pub points: Vec<SurfacePoint>,
    /// The trip's scans between this keyframe and its next, in the order of time; those that lend
    /// it their points first.
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
            lidar: None,
            points: Vec::new(),
            intermediate: Vec::new(),
        }
    }

    /// The layer of its scan; that of lidars without a band if it has none.
    pub fn layer(&self) -> Layer {
        self.scan.as_ref().and_then(layer_of)
    }

    /// With scans behind it, from its first to its last; those that lend it their points do so.
    #[must_use]
    pub fn with_intermediate(mut self, intermediate: Vec<IntermediateScan>) -> Self {
        let lent = intermediate.iter().filter_map(IntermediateScan::lent);
        for (keyframe_from_base, scan) in lent {
            let turn = Pose2::new(0.0, 0.0, keyframe_from_base.theta).to_transform();
            let to_keyframe = keyframe_from_base.to_transform();
            let points = surface_points(scan).into_iter();
            self.points.extend(points.map(|point| SurfacePoint {
                position: to_keyframe.apply(&point.position),
                normal: point.normal.map(|normal: Vector2<f64>| turn.apply(&normal)),
                ..point
            }));
        }
        self.intermediate = intermediate;
        self
    }

    /// What was seen from it: its own scan and those that lend it their points, each from where it
    /// was taken. `None` without a scan.
    pub(super) fn views(&self) -> Option<Views<'_>> {
        let lent = self.intermediate.iter().filter_map(IntermediateScan::lent);
        Some(Views::new(self.scan.as_ref()?).with(lent))
    }

    /// Standard deviation of a range of its points, metres: the largest of the scans that they
    /// come from. `None` without a scan.
    pub(super) fn range_sigma_m(&self) -> Option<f64> {
        let sigma_m = |scan: &LaserScan| scan.lidar().range_sigma_m;
        let lent = self.intermediate.iter().filter_map(IntermediateScan::lent);
        let lent = lent.map(|(_, scan)| sigma_m(scan));
        Some(lent.fold(sigma_m(self.scan.as_ref()?), f64::max))
    }

    /// Which lidar took one of the scans behind it; `None` for a vehicle's only one.
    pub fn lidar_of<'a>(&'a self, following: &'a IntermediateScan) -> Option<&'a LidarId> {
        following.companion_lidar().or(self.lidar.as_ref())
    }

    /// The scans behind it of the lidar that took its own.
    pub(super) fn own_intermediate(
        &self,
    ) -> impl DoubleEndedIterator<Item = &IntermediateScan> + Clone {
        let is_own = |following: &&IntermediateScan| following.companion.is_none();
        self.intermediate.iter().filter(is_own)
    }

    /// The newest scan of its trip up to its next keyframe: its own, or the last one of its lidar
    /// between that was not put off.
    pub(super) fn last_scan(&self, rule: &KeyframeRule) -> LastScan {
        let mut newest = self.own_intermediate().rev();
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
        let newest = self.own_intermediate().rev();
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
