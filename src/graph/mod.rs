//! The pose graph: nodes and edges with lasting ids, and its biconnected blocks.
//!
//! Knows nothing of scans, or of how poses are found: what a solver knows of a block is kept with it,
//! because blocks grow together here. Begin with [`PoseGraph::add_edge`].

mod blocks;
mod carry;
mod edge;
mod pose_graph;

pub use crate::model::{EdgeKind, EdgeStatus};
pub use blocks::{Block, BlockIndex, Blocks};
pub use edge::{Edge, Node};
pub use pose_graph::{GraphError, PoseGraph};
