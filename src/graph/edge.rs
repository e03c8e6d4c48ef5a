//! What a graph is made of: nodes, and the edges between them.

use crate::geometry::{Information, Pose2};
use crate::ids::{EdgeId, NodeId};

/// What made an edge.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EdgeKind {
    /// Two keyframes of one drive, one after the other.
    Odometry,
    /// A place seen again.
    LoopClosure,
}

/// Whether an edge takes part.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EdgeStatus {
    /// It is optimised.
    Active,
    /// It contradicts an accepted change; kept for the record.
    Retired,
    /// It contradicts the rest of the graph beyond belief; kept for the record.
    Quarantined,
}

/// A pose of the base in the map.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Node {
    /// Unique in the graph.
    pub id: NodeId,
    /// `map_from_base`.
    pub pose: Pose2,
}

/// A measured motion between two nodes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Edge {
    /// Unique in the graph.
    pub id: EdgeId,
    /// Node i.
    pub from: NodeId,
    /// Node j.
    pub to: NodeId,
    /// `i_from_j`.
    pub measurement: Pose2,
    /// Of the measurement, in the order (x, y, θ).
    pub information: Information,
    /// What made it.
    pub kind: EdgeKind,
    /// Whether it is optimised.
    pub status: EdgeStatus,
}
