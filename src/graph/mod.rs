//! The pose graph: nodes, edges, their stable ids, and its biconnected blocks.

mod blocks;
mod carry;
mod pose_graph;

pub use crate::model::{EdgeKind, EdgeStatus};
pub use blocks::{Block, BlockIndex, Blocks, Standing};
pub use pose_graph::{Edge, GraphError, Node, PoseGraph};
