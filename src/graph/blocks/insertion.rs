//! Updates blocks when a node or an edge is added.

use std::collections::BTreeMap;

use super::{Block, BlockIndex, Blocks};
use crate::ids::EdgeId;

/// One of the two paths from an edge's ends towards the component's first node.
struct Path {
    at: usize,
    blocks: Vec<BlockIndex>,
}

/// The blocks between two nodes, and their node that is nearest to the component's first node.
struct Between {
    blocks: Vec<BlockIndex>,
    anchor: usize,
}

impl Blocks {
    /// Adds a node without edges.
    pub(in crate::graph) fn add_node(&mut self) {
        self.earlier.push(self.earlier.len());
        self.children.push(Vec::new());
        self.towards_first.push(None);
    }

    /// Adds the edge at an index, new or active again.
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
        let (anchor, child) = if first_from < first_to {
            (from, to)
        } else {
            (to, from)
        };
        self.reroot(child);
        self.earlier[first_from.max(first_to)] = first_from.min(first_to);
        let index = self.place(Block {
            anchor,
            nodes: vec![child],
            edges: vec![position],
            smallest_edge: id,
        });
        self.children[anchor].push(index);
        self.towards_first[child] = Some(index);
        self.block_of_edge[position] = Some(index);
    }

    /// Reserves the entry of an edge; an inactive one has no block.
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

    /// Makes a node the first of its component.
    fn reroot(&mut self, node: usize) {
        let mut below = node;
        let mut next = self.towards_first[node].take();
        while let Some(index) = next {
            let anchor = std::mem::replace(&mut self.blocks[index].anchor, below);
            // The node below becomes the anchor, and the anchor one of the nodes.
            let mut nodes = self.blocks[index].nodes.iter_mut();
            if let Some(place) = nodes.find(|place| **place == below) {
                *place = anchor;
            }
            self.detach(index, anchor);
            self.children[below].push(index);
            next = self.towards_first[anchor].replace(index);
            below = anchor;
        }
    }

    fn detach(&mut self, index: BlockIndex, anchor: usize) {
        let children = &mut self.children[anchor];
        if let Some(place) = children.iter().position(|&other| other == index) {
            children.swap_remove(place);
        }
    }

    /// Merges the blocks between two nodes of one component. The largest absorbs the others, so that a node or
    /// an edge changes its block at most log n times.
    fn join_between(&mut self, from: usize, to: usize) -> BlockIndex {
        let Between { blocks, anchor } = self.between(from, to);
        let size = |index: &BlockIndex| (self.blocks[*index].nodes.len(), *index);
        // There is a path, so there is a largest block on it.
        let largest = blocks.iter().copied().max_by_key(size).unwrap_or_default();
        if self.blocks[largest].anchor != anchor {
            self.detach(largest, self.blocks[largest].anchor);
            self.blocks[largest].anchor = anchor;
            self.children[anchor].push(largest);
        }
        for index in blocks {
            if index != largest {
                self.absorb(largest, index);
            }
        }
        largest
    }

    fn absorb(&mut self, largest: BlockIndex, index: BlockIndex) {
        self.detach(index, self.blocks[index].anchor);
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

    /// The blocks on the path between two nodes of one component. Alternates between both ends: at most twice
    /// as many steps as there are blocks on the longer side.
    fn between(&self, from: usize, to: usize) -> Between {
        let mut paths = [from, to].map(|at| Path {
            at,
            blocks: Vec::new(),
        });
        // How many blocks a path had passed when it reached a node or a block.
        let mut nodes = [BTreeMap::from([(from, 0)]), BTreeMap::from([(to, 0)])];
        let mut blocks = [BTreeMap::new(), BTreeMap::new()];
        for turn in 0.. {
            let (this, other) = (turn % 2, (turn + 1) % 2);
            let Some(index) = self.towards_first[paths[this].at] else {
                if self.towards_first[paths[other].at].is_none() {
                    break;
                }
                continue;
            };
            let anchor = self.blocks[index].anchor;
            let met_at: Option<&usize> = blocks[other].get(&index);
            let met = match met_at {
                Some(&behind) => Some(behind),
                None => {
                    paths[this].blocks.push(index);
                    blocks[this].insert(index, paths[this].blocks.len());
                    nodes[other].get(&anchor).copied()
                }
            };
            if let Some(behind) = met {
                let mut blocks = std::mem::take(&mut paths[this].blocks);
                blocks.extend_from_slice(&paths[other].blocks[..behind]);
                return Between { blocks, anchor };
            }
            nodes[this].insert(anchor, paths[this].blocks.len());
            paths[this].at = anchor;
        }
        Between {
            blocks: Vec::new(),
            anchor: from,
        }
    }
}
