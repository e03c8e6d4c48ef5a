//! What a checked batch of edges holds, and how much at most.

use crate::geometry::{Information, Pose2};
use crate::graph::EdgeKind;
use crate::ids::{NodeId, StampNs, TripId, VehicleId};

/// Most nodes in one batch.
pub const NODES_MAX: usize = 5_000;
/// Most edges in one batch.
pub const EDGES_MAX: usize = 20_000;
/// Prefix of a node of the map, given by its number.
pub const MAP_PREFIX: &str = "map:";

/// One upload, checked.
#[derive(Debug, Clone, PartialEq)]
pub struct UploadedEdges {
    /// The vehicle.
    pub vehicle_id: VehicleId,
    /// The trip, if the sender states it.
    pub trip_id: Option<TripId>,
    /// Up to [`NODES_MAX`], their names distinct.
    pub nodes: Vec<UploadedNode>,
    /// Up to [`EDGES_MAX`], each between two different nodes.
    pub edges: Vec<UploadedEdge>,
    /// A JSON object of the sender's own, as its text.
    pub extensions: Option<String>,
    /// Flags in alphabetical order: `clock_skew`, `late`, `simulated_time`.
    pub flags: Vec<String>,
}

/// A node as its vehicle states it.
#[derive(Debug, Clone, PartialEq)]
pub struct UploadedNode {
    /// The vehicle's name for it.
    pub name: String,
    /// The vehicle's own estimate of its pose.
    pub pose: Pose2,
    /// Its stamp as sent; if that is missing or simulated, the batch's arrival, in the order of the batch.
    pub stamp: StampNs,
}

/// An end of an edge.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub enum NodeName {
    /// The vehicle's name for it.
    Own(String),
    /// The map's own number.
    OfMap(NodeId),
}

impl std::fmt::Display for NodeName {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Own(name) => f.write_str(name),
            Self::OfMap(id) => write!(f, "{MAP_PREFIX}{id}"),
        }
    }
}

/// A measured motion.
#[derive(Debug, Clone, PartialEq)]
pub struct UploadedEdge {
    /// Node i.
    pub from: NodeName,
    /// Node j.
    pub to: NodeName,
    /// `i_from_j`.
    pub measurement: Pose2,
    /// Of the measurement; positive definite.
    pub information: Information,
    /// Odometry or loop closure.
    pub kind: EdgeKind,
}
