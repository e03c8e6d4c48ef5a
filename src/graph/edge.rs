//! Nodes, and the edges between them.

use crate::geometry::{Information, Pose2};
use crate::ids::{EdgeId, NodeId};
use crate::model::{EdgeKind, EdgeStatus};

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
    /// Odometry or loop closure.
    pub kind: EdgeKind,
    /// Whether it is optimised.
    pub status: EdgeStatus,
}
