//! The pose graph: nodes, edges, their stable ids.

mod pose_graph;

pub use pose_graph::{Edge, EdgeKind, EdgeStatus, GraphError, Node, PoseGraph};
