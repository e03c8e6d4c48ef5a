//! What a checked batch of edges holds, and how much at most.

use crate::geometry::{Information, Pose2};
use crate::graph::EdgeKind;
use crate::ids::{NodeId, StampNs, TripId, VehicleId};

/// Most nodes in one batch.
pub const NODES_MAX: usize = 5_000;
/// Most edges in one batch.
pub const EDGES_MAX: usize = 20_000;
/// What names a node of the map by its number begins with this.
pub const MAP_PREFIX: &str = "map:";

/// One upload, checked.
#[derive(Debug, Clone, PartialEq)]
pub struct UploadedEdges {
    /// Who drove.
    pub vehicle_id: VehicleId,
    /// Which drive, if the sender says.
    pub trip_id: Option<TripId>,
    /// Up to [`NODES_MAX`], their names distinct.
    pub nodes: Vec<UploadedNode>,
    /// Up to [`EDGES_MAX`], no end twice in one of them.
    pub edges: Vec<UploadedEdge>,
    /// A JSON object of the sender's own, as its text.
    pub extensions: Option<String>,
    /// What was noticed, in alphabetical order: `clock_skew`, `late`, `simulated_time`.
    pub flags: Vec<String>,
}

/// A node as its vehicle knows it.
#[derive(Debug, Clone, PartialEq)]
pub struct UploadedNode {
    /// What the vehicle calls it.
    pub name: String,
    /// Where the vehicle takes itself to be.
    pub pose: Pose2,
    /// When it was there: as sent; where that is a simulated time or missing, when the batch came in,
    /// in the order of the batch.
    pub stamp: StampNs,
}

/// An end of an edge.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub enum NodeName {
    /// What the vehicle calls it.
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
    /// What made it.
    pub kind: EdgeKind,
}
