//! Nodes and edges that were measured elsewhere, and how they hang together.

use std::collections::VecDeque;

use super::route_map::RouteMap;
use crate::geometry::{Information, Pose2};
use crate::graph::EdgeKind;
use crate::ids::{NodeId, StampNs, TripId};

/// A node that comes without a scan.
#[derive(Debug, Clone, PartialEq)]
pub struct GivenNode {
    /// The trip it belongs to.
    pub trip: TripId,
    /// When the vehicle was there.
    pub stamp: StampNs,
    /// Where the vehicle takes itself to be. The first node of an empty map is put there, and
    /// the frame of the map is its frame.
    pub pose: Pose2,
}

/// An end of a given edge.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum End {
    /// The place of a node among the given ones.
    New(usize),
    /// A node of the map.
    Known(NodeId),
}

impl End {
    /// The node, where the given ones have become these.
    pub(super) fn among(self, nodes: &[NodeId]) -> NodeId {
        match self {
            Self::New(place) => nodes[place],
            Self::Known(id) => id,
        }
    }
}

/// A motion that was measured elsewhere.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GivenEdge {
    /// Node i.
    pub from: End,
    /// Node j.
    pub to: End,
    /// `i_from_j`.
    pub measurement: Pose2,
    /// Of the measurement; positive definite.
    pub information: Information,
    /// What made it.
    pub kind: EdgeKind,
}

/// What is to be added to a map.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct GivenGraph {
    /// In the order in which they become nodes of the map.
    pub nodes: Vec<GivenNode>,
    /// In the order in which they are merged.
    pub edges: Vec<GivenEdge>,
}

/// Where given nodes begin.
pub(super) struct Placing {
    /// `map_from_base` of each given node; `None` for those that nothing ties to the map.
    pub poses: Vec<Option<Pose2>>,
    /// Of each edge whether a node was placed by it.
    pub places: Vec<bool>,
}

impl RouteMap {
    /// The given nodes that no chain of given edges ties to the map, as places among them. The
    /// first node given to an empty map needs no tie.
    pub fn untied(&self, given: &GivenGraph) -> Vec<usize> {
        let poses = self.place(given).poses;
        (0..poses.len()).filter(|&k| poses[k].is_none()).collect()
    }

    /// Composes poses along the edges, from what is in the map; along odometry as far as it goes.
    pub(super) fn place(&self, given: &GivenGraph) -> Placing {
        let mut placing = Placing {
            poses: vec![None; given.nodes.len()],
            places: vec![false; given.edges.len()],
        };
        let mut at_node: Vec<Vec<usize>> = vec![Vec::new(); given.nodes.len()];
        let mut open = Open::default();
        for (k, edge) in given.edges.iter().enumerate() {
            for end in [edge.from, edge.to] {
                match end {
                    End::New(node) => at_node[node].push(k),
                    End::Known(_) => open.push(k, edge.kind),
                }
            }
        }
        if let Some(first) = given.nodes.first()
            && self.keyframes.is_empty()
        {
            placing.poses[0] = Some(first.pose);
            at_node[0]
                .iter()
                .for_each(|&k| open.push(k, given.edges[k].kind));
        }
        while let Some(k) = open.pop() {
            let edge = &given.edges[k];
            let [from, to] = [edge.from, edge.to].map(|end| self.pose_of_end(end, &placing.poses));
            let (node, pose) = match (from, to, edge.from, edge.to) {
                (Some(from), None, _, End::New(to)) => (to, from.compose(&edge.measurement)),
                (None, Some(to), End::New(from), _) => {
                    (from, to.compose(&edge.measurement.inverse()))
                }
                _ => continue,
            };
            placing.poses[node] = Some(pose);
            placing.places[k] = true;
            at_node[node]
                .iter()
                .for_each(|&k| open.push(k, given.edges[k].kind));
        }
        placing
    }

    fn pose_of_end(&self, end: End, poses: &[Option<Pose2>]) -> Option<Pose2> {
        match end {
            End::New(node) => poses[node],
            End::Known(id) => self.graph.node(id).map(|node| node.pose),
        }
    }
}

/// Edges that may place a node, odometry before closures.
#[derive(Default)]
struct Open {
    odometry: VecDeque<usize>,
    closures: VecDeque<usize>,
}

impl Open {
    fn push(&mut self, edge: usize, kind: EdgeKind) {
        match kind {
            EdgeKind::Odometry => self.odometry.push_back(edge),
            EdgeKind::LoopClosure => self.closures.push_back(edge),
        }
    }

    fn pop(&mut self) -> Option<usize> {
        let odometry = self.odometry.pop_front();
        odometry.or_else(|| self.closures.pop_front())
    }
}
