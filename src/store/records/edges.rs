//! Edges of a pose graph.

use crate::geometry::{Information, Pose2};
use crate::graph::{EdgeKind, EdgeStatus};
use crate::ids::{BatchId, EdgeId, NodeId, VehicleId};

/// What two matched scans say beside the estimate that is optimised.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ClosureRecord {
    /// The all-points estimate of `from_from_to`; never optimised in fused mode.
    pub all_points_measurement: Pose2,
    /// Its information.
    pub all_points_information: Information,
    /// Share of the points with a counterpart.
    pub overlap: f64,
    /// Share of the counterparts that agree.
    pub inlier_share: f64,
    /// Root mean square distance of the agreeing points, metres.
    pub rmse_m: f64,
    /// eᵀΩe of the all-points estimate at the optimum when it was inserted.
    pub all_points_residual: f64,
}

/// Which edges to list.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct EdgeFilter {
    /// Only of this kind.
    pub kind: Option<EdgeKind>,
    /// Only in this state.
    pub status: Option<EdgeStatus>,
}

/// An edge as it is stored.
#[derive(Debug, Clone, PartialEq)]
pub struct EdgeRecord {
    /// Unique within the route.
    pub id: EdgeId,
    /// Its older node.
    pub from: NodeId,
    /// Its newer node.
    pub to: NodeId,
    /// What made it.
    pub kind: EdgeKind,
    /// Whether it is optimised.
    pub status: EdgeStatus,
    /// The upload it came with.
    pub batch_id: BatchId,
    /// `from_from_to`, as optimised.
    pub measurement: Pose2,
    /// Of the measurement.
    pub information: Information,
    /// eᵀΩe at the poses of its nodes; not stored, but computed when the edge is read.
    pub residual: f64,
    /// The block of the graph it lies in; `None` for bridges.
    pub subgraph_id: Option<i64>,
    /// What a loop closure added to the optimum F when it was inserted (paper: ΔF); `None` for
    /// odometry.
    pub delta_f: Option<f64>,
    /// For loop closures between scans.
    pub closure: Option<ClosureRecord>,
}

/// The part of an edge that a solve changes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EdgeChange {
    /// The edge.
    pub id: EdgeId,
    /// Whether it is optimised.
    pub status: EdgeStatus,
    /// The block of the graph it lies in.
    pub subgraph_id: Option<i64>,
}

/// Most archived closures that a worker's map keeps.
pub const ARCHIVED_CLOSURES_MAX: usize = 1_000;

/// A closure with an archived node.
#[derive(Debug, Clone, PartialEq)]
pub struct ArchivedClosure {
    /// The edge.
    pub id: EdgeId,
    /// Its older node.
    pub from: NodeId,
    /// Its newer node.
    pub to: NodeId,
    /// The last block of the graph that it lay in.
    pub subgraph_id: Option<i64>,
    /// What it added to the optimum F when it was inserted (paper: ΔF).
    pub delta_f: f64,
    /// Who drove the node with the larger id.
    pub vehicle_id: VehicleId,
    /// Whether it came as an edge, and no two scans were matched for it.
    pub given: bool,
}
