//! The pose graph: nodes, edges, their stable ids, and its biconnected blocks.

mod blocks;
mod carry;
mod pose_graph;

pub use blocks::{Block, BlockIndex, Blocks};
pub use pose_graph::{Edge, EdgeKind, EdgeStatus, GraphError, Node, PoseGraph};
