//! Nodes of a pose graph, their scans, and the scans between them.

use crate::geometry::{Pose2, PoseSigma};
use crate::ids::{BatchId, LidarId, NodeId, StampNs, TripId, VehicleId};
use crate::mapping::LOST_DRIFT_M;
use crate::scan::{CodecError, LaserScan, decode_scan};

/// A node as it is stored. Scans are the bytes of [`crate::scan::encode_scan`].
#[derive(Debug, Clone, PartialEq)]
pub struct NodeRecord {
    /// Unique within the route.
    pub id: NodeId,
    /// The upload it came with.
    pub batch_id: BatchId,
    /// The vehicle.
    pub vehicle_id: VehicleId,
    /// The trip.
    pub trip_id: TripId,
    /// When the scan was taken.
    pub stamp: StampNs,
    /// `map_from_base`.
    pub pose: Pose2,
    /// How uncertain the pose is, relative to the first node that the node is connected with;
    /// `None` where that is not known.
    pub sigma: Option<PoseSigma>,
    /// `odom_from_base` as the vehicle sent it.
    pub odom_from_base: Pose2,
    /// Way driven since the trip was last connected to the map, metres; [`LOST_DRIFT_M`] or more
    /// where the trip is not localised.
    pub drift_m: f64,
    /// Whether it is a reference: a node that later passes are matched with.
    pub reference: bool,
    /// Whether it takes part in the optimisation, or is archived.
    pub active: bool,
    /// The block of the graph it lies in; `None` outside every block with a loop closure.
    pub subgraph_id: Option<i64>,
    /// Its place in its trip: 0, 1, 2 …
    pub trip_order: u32,
    /// What the vehicle calls it, if it came with a batch of edges.
    pub client_id: Option<String>,
}

impl NodeRecord {
    /// Whether it is known where the node is: its trip was not lost there.
    pub fn is_localised(&self) -> bool {
        self.drift_m < LOST_DRIFT_M
    }
}

/// A node with its scan.
#[derive(Debug, Clone, PartialEq)]
pub struct NodeWithScan {
    /// The node.
    pub node: NodeRecord,
    /// The bytes of [`crate::scan::encode_scan`]; `None` if it came with a batch of edges.
    pub scan: Option<Vec<u8>>,
    /// Which of the vehicle's lidars took the scan; `None` for its only one.
    pub lidar: Option<LidarId>,
    /// The trip's scans between it and its next keyframe, in the order of time; none of a new
    /// node: a result brings them in [`super::JobResult::intermediate`].
    pub intermediate: Vec<IntermediateRecord>,
}

/// A scan that was taken after a keyframe and before the next one of its trip, as it is stored.
#[derive(Debug, Clone, PartialEq)]
pub struct IntermediateRecord {
    /// When it was taken.
    pub stamp: StampNs,
    /// Pose of the base in the frame of the keyframe's base.
    pub keyframe_from_base: Pose2,
    /// Pose of the base in the vehicle's own odometry frame.
    pub odom_from_base: Pose2,
    /// The lidar beside that of its keyframe that took it; `None` for a scan of the keyframe's.
    pub companion: Option<LidarId>,
    /// Whether its points count as the keyframe's; a companion's only.
    pub lends: bool,
    /// The bytes of [`crate::scan::encode_scan`]; `None` where it would repeat the scan before.
    pub scan: Option<Vec<u8>>,
}

impl NodeWithScan {
    /// Its own scan and those behind it that were kept, each with its stamp and `map_from_base`.
    ///
    /// # Errors
    /// [`CodecError`] if one does not decode.
    pub fn decoded_scans(&self) -> Result<Vec<(StampNs, Pose2, LaserScan)>, CodecError> {
        let own = self.scan.as_ref();
        let own = own.map(|scan| (self.node.stamp, self.node.pose, scan));
        let following = self.intermediate.iter().filter_map(|following| {
            let pose = self.node.pose.compose(&following.keyframe_from_base);
            Some((following.stamp, pose, following.scan.as_ref()?))
        });
        let decoded = own.into_iter().chain(following);
        let decoded = decoded.map(|(stamp, pose, scan)| Ok((stamp, pose, decode_scan(scan)?)));
        decoded.collect()
    }
}

/// A new scan between keyframes.
#[derive(Debug, Clone, PartialEq)]
pub struct NewIntermediate {
    /// The keyframe that it follows: a new node or one that is there.
    pub node_id: NodeId,
    /// Its place among those of the keyframe: they go on where those that are there end.
    pub place: u32,
    /// The scan.
    pub scan: IntermediateRecord,
}

/// Where a trip was when a scan was taken.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrajectoryPose {
    /// The keyframe that the scan is, or moves with.
    pub node_id: NodeId,
    /// Whether the scan is the keyframe's own, or one between keyframes.
    pub is_keyframe: bool,
    /// When the scan was taken.
    pub stamp: StampNs,
    /// `map_from_base`.
    pub pose: Pose2,
}

/// The part of a node that a solve or a decision changes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NodeChange {
    /// The node.
    pub id: NodeId,
    /// `map_from_base`.
    pub pose: Pose2,
    /// As [`NodeRecord::sigma`].
    pub sigma: Option<PoseSigma>,
    /// The block of the graph it lies in.
    pub subgraph_id: Option<i64>,
    /// As [`NodeRecord::drift_m`].
    pub drift_m: f64,
    /// Whether it is a reference: a node that later passes are matched with.
    pub reference: bool,
    /// Whether it takes part in the optimisation.
    pub active: bool,
}
