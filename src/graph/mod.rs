//! The pose graph: nodes and edges with lasting ids, and its biconnected blocks.
//!
//! Must not know scans, or how poses are found. Begin with [`PoseGraph::add_edge`].

mod blocks;
mod edge;
mod pose_graph;
mod rigid_propagation;

pub use crate::model::{EdgeKind, EdgeStatus};
pub use blocks::{Block, BlockIndex, Blocks};
pub use edge::{Edge, Node};
pub use pose_graph::{GraphError, PoseGraph};
