//! Biconnected blocks: the parts of a pose graph that can be solved on their own.
//!
//! A minimum of F separates exactly over the blocks: bridges have no error there, and blocks that share a cut
//! node do not influence each other's relative poses.

mod insertion;
mod search;
#[cfg(test)]
mod tests;

use crate::ids::EdgeId;

/// Index of a block in [`Blocks`]; valid until the graph's edges change.
pub type BlockIndex = usize;

/// The biconnected blocks of a graph's active edges (Hopcroft and Tarjan 1973). Two parallel
/// edges make a block; a bridge is a block of its own. Nodes and edges are given by their indices
/// in [`PoseGraph::nodes`](super::PoseGraph::nodes) and
/// [`PoseGraph::edges`](super::PoseGraph::edges).
///
/// [`PoseGraph::blocks`](super::PoseGraph::blocks) updates them while the graph grows: a new edge
/// merges the blocks on the path between its ends into one. That costs O(n log n) over a graph's life,
/// without the edges that join two components: each of these costs the path through the later component's
/// blocks to its first node.
#[derive(Debug, Clone, Default)]
pub struct Blocks {
    /// A block without edges is unused.
    blocks: Vec<Block>,
    free: Vec<BlockIndex>,
    block_of_edge: Vec<Option<BlockIndex>>,
    /// The child blocks of each node, away from its component's first node.
    children: Vec<Vec<BlockIndex>>,
    /// The block between each node and its component's first node.
    towards_first: Vec<Option<BlockIndex>>,
    /// Union-find: an earlier node of the same component; first nodes point to themselves.
    earlier: Vec<usize>,
}

/// One biconnected block.
#[derive(Debug, Clone)]
pub struct Block {
    /// Its node nearest to its component's first node: that node itself, or the cut node on the path there.
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

    /// The smallest edge id in it, which is stable while the block grows; `None` for a bridge, which closes no
    /// loop.
    pub fn subgraph_id(&self) -> Option<EdgeId> {
        (!self.is_bridge()).then_some(self.smallest_edge)
    }
}

impl Blocks {
    /// All blocks, in no particular order.
    pub fn iter(&self) -> impl Iterator<Item = &Block> {
        self.blocks.iter().filter(|block| !block.edges.is_empty())
    }

    /// The block at an index; `None` past the end.
    pub fn get(&self, index: BlockIndex) -> Option<&Block> {
        self.blocks.get(index)
    }

    /// The block of the edge at an index; `None` if it is not active.
    pub fn of_edge(&self, edge_position: usize) -> Option<BlockIndex> {
        self.block_of_edge.get(edge_position).copied().flatten()
    }

    /// The child blocks of the node at an index: those whose anchor it is.
    pub fn child_blocks(&self, node_position: usize) -> &[BlockIndex] {
        self.children.get(node_position).map_or(&[], Vec::as_slice)
    }

    /// All blocks of the node at an index.
    pub fn at_node(&self, node_position: usize) -> impl Iterator<Item = &Block> {
        self.indices_at(node_position)
            .map(|index| &self.blocks[index])
    }

    /// Whether the node at an index belongs to more than one block.
    pub fn is_cut_node(&self, node_position: usize) -> bool {
        self.indices_at(node_position).nth(1).is_some()
    }

    /// The id of the sub-graph of the edge at an index; `None` for bridges and
    /// inactive edges.
    pub fn subgraph_of_edge(&self, edge_position: usize) -> Option<EdgeId> {
        self.blocks[self.of_edge(edge_position)?].subgraph_id()
    }

    fn indices_at(&self, node_position: usize) -> impl Iterator<Item = BlockIndex> {
        let towards_first = self.towards_first.get(node_position).copied().flatten();
        towards_first
            .into_iter()
            .chain(self.child_blocks(node_position).iter().copied())
    }
}
