//! Biconnected blocks: the parts of a pose graph that can be solved on their own.
//!
//! A minimum of F separates exactly over the blocks: a bridge has no error there, and two blocks
//! that share a cut node do not influence each other's relative poses.

mod growth;
mod search;
#[cfg(test)]
mod tests;

use crate::ids::EdgeId;

/// A place in [`Blocks`]; it is good until the graph's edges change.
pub type BlockIndex = usize;

/// The biconnected blocks of a graph's active edges (Hopcroft and Tarjan 1973). Two parallel
/// edges make a block; a bridge is a block of its own. Nodes and edges are named by their places
/// in [`PoseGraph::nodes`](super::PoseGraph::nodes) and
/// [`PoseGraph::edges`](super::PoseGraph::edges).
///
/// [`PoseGraph::blocks`](super::PoseGraph::blocks) keeps them while the graph grows: a new edge
/// joins the blocks on the way between its ends into one. Over a graph's life that costs n log n,
/// however it grows, but for the edges that join two components: each costs as much as the way
/// through the later one's blocks to its first node.
#[derive(Debug, Clone, Default)]
pub struct Blocks {
    /// A block without edges is a free place.
    blocks: Vec<Block>,
    free: Vec<BlockIndex>,
    block_of_edge: Vec<Option<BlockIndex>>,
    /// The blocks that hang off a node, away from its component's first node.
    hanging: Vec<Vec<BlockIndex>>,
    /// The block through which a node hangs on its component's first node.
    towards_first: Vec<Option<BlockIndex>>,
    /// A node of the same component that was added no later; first nodes name themselves.
    earlier: Vec<usize>,
}

/// One biconnected block.
#[derive(Debug, Clone)]
pub struct Block {
    /// Its node nearest to its component's first node: that node itself, or the cut node on the
    /// way there.
    pub anchor: usize,
    /// Its other nodes, in no particular order.
    pub nodes: Vec<usize>,
    /// Its edges, in no particular order.
    pub edges: Vec<usize>,
    smallest_edge: EdgeId,
}

impl Block {
    /// Whether it is a single edge that closes no loop.
    pub fn is_bridge(&self) -> bool {
        self.edges.len() == 1
    }

    /// The smallest edge id in it, a name that lasts while the block grows; `None` for a bridge,
    /// which closes no loop.
    pub fn subgraph_id(&self) -> Option<EdgeId> {
        (!self.is_bridge()).then_some(self.smallest_edge)
    }
}

impl Blocks {
    /// All blocks, in no particular order.
    pub fn iter(&self) -> impl Iterator<Item = &Block> {
        self.blocks.iter().filter(|block| !block.edges.is_empty())
    }

    /// The block at a place; `None` past the end.
    pub fn get(&self, index: BlockIndex) -> Option<&Block> {
        self.blocks.get(index)
    }

    /// The block of the edge at a place; `None` if it is not active.
    pub fn of_edge(&self, edge_position: usize) -> Option<BlockIndex> {
        self.block_of_edge.get(edge_position).copied().flatten()
    }

    /// The blocks that hang off the node at a place: it is their anchor.
    pub fn hanging_off(&self, node_position: usize) -> &[BlockIndex] {
        self.hanging.get(node_position).map_or(&[], Vec::as_slice)
    }

    /// All blocks that the node at a place belongs to.
    pub fn at_node(&self, node_position: usize) -> impl Iterator<Item = &Block> {
        self.indices_at(node_position)
            .map(|index| &self.blocks[index])
    }

    /// Whether the node at a place belongs to more than one block.
    pub fn is_cut_node(&self, node_position: usize) -> bool {
        self.indices_at(node_position).nth(1).is_some()
    }

    /// The name of the sub-graph that the edge at a place belongs to; `None` for bridges and
    /// inactive edges.
    pub fn subgraph_of_edge(&self, edge_position: usize) -> Option<EdgeId> {
        self.blocks[self.of_edge(edge_position)?].subgraph_id()
    }

    fn indices_at(&self, node_position: usize) -> impl Iterator<Item = BlockIndex> {
        let towards_first = self.towards_first.get(node_position).copied().flatten();
        towards_first
            .into_iter()
            .chain(self.hanging_off(node_position).iter().copied())
    }
}
