//! Keeping blocks while a graph grows.

use std::collections::BTreeMap;

use super::{Block, BlockIndex, Blocks};
use crate::ids::EdgeId;

/// One of the two ways up from an edge's ends, block by block.
struct Way {
    at: usize,
    blocks: Vec<BlockIndex>,
}

/// The blocks between two nodes, and the one of their nodes that is nearest to the component's
/// first.
struct Between {
    blocks: Vec<BlockIndex>,
    anchor: usize,
}

impl Blocks {
    /// A node came in, with no edge yet.
    pub(in crate::graph) fn add_node(&mut self) {
        self.earlier.push(self.earlier.len());
        self.hanging.push(Vec::new());
        self.towards_first.push(None);
    }

    /// The edge at a place came in, new or active again.
    pub(in crate::graph) fn add_edge(
        &mut self,
        position: usize,
        id: EdgeId,
        (from, to): (usize, usize),
    ) {
        self.cover_edge(position);
        let (first_from, first_to) = (self.first_of(from), self.first_of(to));
        if first_from == first_to {
            let index = self.join_between(from, to);
            let block = &mut self.blocks[index];
            block.edges.push(position);
            block.smallest_edge = block.smallest_edge.min(id);
            self.block_of_edge[position] = Some(index);
            return;
        }
        let (anchor, hung) = if first_from < first_to {
            (from, to)
        } else {
            (to, from)
        };
        self.hang_by(hung);
        self.earlier[first_from.max(first_to)] = first_from.min(first_to);
        let index = self.place(Block {
            anchor,
            nodes: vec![hung],
            edges: vec![position],
            smallest_edge: id,
        });
        self.hanging[anchor].push(index);
        self.towards_first[hung] = Some(index);
        self.block_of_edge[position] = Some(index);
    }

    /// Makes sure that there is a place for an edge; one that is not active has no block.
    pub(in crate::graph) fn cover_edge(&mut self, position: usize) {
        let covered = self.block_of_edge.len().max(position + 1);
        self.block_of_edge.resize(covered, None);
    }

    fn place(&mut self, block: Block) -> BlockIndex {
        let Some(index) = self.free.pop() else {
            self.blocks.push(block);
            return self.blocks.len() - 1;
        };
        self.blocks[index] = block;
        index
    }

    /// The first node of a node's component.
    fn first_of(&mut self, mut node: usize) -> usize {
        while self.earlier[node] != node {
            self.earlier[node] = self.earlier[self.earlier[node]];
            node = self.earlier[node];
        }
        node
    }

    /// Turns a component over, so that it hangs by this node instead of its first.
    fn hang_by(&mut self, node: usize) {
        let mut below = node;
        let mut next = self.towards_first[node].take();
        while let Some(index) = next {
            let anchor = std::mem::replace(&mut self.blocks[index].anchor, below);
            // The node below becomes the anchor, and the anchor one of the nodes.
            let mut nodes = self.blocks[index].nodes.iter_mut();
            if let Some(place) = nodes.find(|place| **place == below) {
                *place = anchor;
            }
            self.unhang(index, anchor);
            self.hanging[below].push(index);
            next = self.towards_first[anchor].replace(index);
            below = anchor;
        }
    }

    fn unhang(&mut self, index: BlockIndex, anchor: usize) {
        let hanging = &mut self.hanging[anchor];
        if let Some(place) = hanging.iter().position(|&other| other == index) {
            hanging.swap_remove(place);
        }
    }

    /// Makes the blocks between two nodes of one component one. The largest takes in the others,
    /// so that a node or an edge changes hands at most log n times.
    fn join_between(&mut self, from: usize, to: usize) -> BlockIndex {
        let Between { blocks, anchor } = self.between(from, to);
        let size = |index: &BlockIndex| (self.blocks[*index].nodes.len(), *index);
        // There is a way, so there is a largest block on it.
        let largest = blocks.iter().copied().max_by_key(size).unwrap_or_default();
        if self.blocks[largest].anchor != anchor {
            self.unhang(largest, self.blocks[largest].anchor);
            self.blocks[largest].anchor = anchor;
            self.hanging[anchor].push(largest);
        }
        for index in blocks {
            if index != largest {
                self.take_in(largest, index);
            }
        }
        largest
    }

    fn take_in(&mut self, largest: BlockIndex, index: BlockIndex) {
        self.unhang(index, self.blocks[index].anchor);
        let nodes = std::mem::take(&mut self.blocks[index].nodes);
        let edges = std::mem::take(&mut self.blocks[index].edges);
        for &node in &nodes {
            self.towards_first[node] = Some(largest);
        }
        for &edge in &edges {
            self.block_of_edge[edge] = Some(largest);
        }
        let smallest_edge = self.blocks[index].smallest_edge;
        let block = &mut self.blocks[largest];
        block.nodes.extend(nodes);
        block.edges.extend(edges);
        block.smallest_edge = block.smallest_edge.min(smallest_edge);
        self.free.push(index);
    }

    /// The blocks on the way between two nodes of one component. Goes up from both by turns, so
    /// that it takes at most twice as many steps as there are blocks on the longer side.
    fn between(&self, from: usize, to: usize) -> Between {
        let mut ways = [from, to].map(|at| Way {
            at,
            blocks: Vec::new(),
        });
        // How many blocks a way had behind it when it came to a node or to a block.
        let mut nodes = [BTreeMap::from([(from, 0)]), BTreeMap::from([(to, 0)])];
        let mut blocks = [BTreeMap::new(), BTreeMap::new()];
        for turn in 0.. {
            let (this, other) = (turn % 2, (turn + 1) % 2);
            let Some(index) = self.towards_first[ways[this].at] else {
                if self.towards_first[ways[other].at].is_none() {
                    break;
                }
                continue;
            };
            let anchor = self.blocks[index].anchor;
            let met_at: Option<&usize> = blocks[other].get(&index);
            let met = match met_at {
                Some(&behind) => Some(behind),
                None => {
                    ways[this].blocks.push(index);
                    blocks[this].insert(index, ways[this].blocks.len());
                    nodes[other].get(&anchor).copied()
                }
            };
            if let Some(behind) = met {
                let mut blocks = std::mem::take(&mut ways[this].blocks);
                blocks.extend_from_slice(&ways[other].blocks[..behind]);
                return Between { blocks, anchor };
            }
            nodes[this].insert(anchor, ways[this].blocks.len());
            ways[this].at = anchor;
        }
        Between {
            blocks: Vec::new(),
            anchor: from,
        }
    }
}
