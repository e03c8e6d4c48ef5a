//! Differences between a map and its saved state: only these are written.

use crate::mapping::RouteMap;
use crate::store::{EdgeChange, NodeChange};

/// The columns of every node that a solve may change, by id.
pub(super) fn nodes_of(map: &RouteMap) -> Vec<NodeChange> {
    let graph = map.graph();
    let with_keyframes = graph.nodes().iter().zip(map.keyframes());
    let with_sigmas = with_keyframes.zip(map.pose_sigmas());
    let nodes = with_sigmas.map(|((node, keyframe), sigma)| NodeChange {
        id: node.id,
        pose: node.pose,
        sigma,
        subgraph_id: graph.subgraph_of_node(node.id).map(|id| id.0),
        drift_m: keyframe.drift_m,
        reference: keyframe.reference,
        active: true,
    });
    nodes.collect()
}

/// The columns of every edge that a solve may change, by id.
pub(super) fn edges_of(map: &RouteMap) -> Vec<EdgeChange> {
    let graph = map.graph();
    let blocks = graph.blocks();
    let edges = graph.edges().iter().enumerate();
    let edges = edges.map(|(position, edge)| EdgeChange {
        id: edge.id,
        status: edge.status,
        subgraph_id: blocks.subgraph_of_edge(position).map(|id| id.0),
    });
    edges.collect()
}

/// How many of the present items were saved before; new ids are larger than all earlier ones.
pub(super) fn count_known<T, I: Ord>(saved: &[T], now: &[T], id: impl Fn(&T) -> I) -> usize {
    match saved.last() {
        Some(last) => now.partition_point(|item| id(item) <= id(last)),
        None => 0,
    }
}

/// Nodes that differ from their saved state, and those that were archived.
pub(super) fn changed_nodes(saved: &[NodeChange], now: &[NodeChange]) -> Vec<NodeChange> {
    let mut now = now.iter().peekable();
    let change = |saved: &NodeChange| match now.next_if(|now| now.id == saved.id) {
        Some(now) => (now != saved).then_some(*now),
        None => Some(NodeChange {
            active: false,
            ..*saved
        }),
    };
    saved.iter().filter_map(change).collect()
}

/// Edges that differ from their saved state. Nothing is written for archived ones.
pub(super) fn changed_edges(saved: &[EdgeChange], now: &[EdgeChange]) -> Vec<EdgeChange> {
    let mut now = now.iter().peekable();
    let change = |saved: &EdgeChange| {
        let now = now.next_if(|now| now.id == saved.id)?;
        (now != saved).then_some(*now)
    };
    saved.iter().filter_map(change).collect()
}
