//! What the store has of a map, beside the map as it is: only what differs is written.

use crate::geometry::angle_difference_rad;
use crate::graph::Blocks;
use crate::mapping::RouteMap;
use crate::store::{EdgeChange, NodeChange};

/// A node that moved by less than this is left where the store has it, metres and radians: a
/// solve moves every node of its block by a hair.
const STILL: f64 = 1e-8;
/// A residual that changed by less than this, and this share of it, is not written anew.
const RESIDUAL_STILL: f64 = 1e-6;

/// Puts nodes back that have hardly moved since they were saved, so that map and store agree to
/// the bit.
pub(super) fn hold_still(map: &mut RouteMap, saved: &[NodeChange]) {
    for saved in saved {
        let Some(node) = map.graph().node(saved.id) else {
            continue;
        };
        let way_m = (node.pose.translation() - saved.pose.translation()).norm();
        let turn_rad = angle_difference_rad(node.pose.theta, saved.pose.theta);
        if node.pose != saved.pose && way_m < STILL && turn_rad < STILL {
            map.set_pose(saved.id, saved.pose);
        }
    }
}

/// The part of every node that a solve changes, by id.
pub(super) fn nodes_of(map: &RouteMap) -> Vec<NodeChange> {
    let graph = map.graph();
    let blocks = Blocks::of(graph);
    let with_keyframes = graph.nodes().iter().zip(map.keyframes());
    let nodes = with_keyframes.map(|(node, keyframe)| NodeChange {
        id: node.id,
        pose: node.pose,
        subgraph_id: blocks.subgraph_of_node(graph, node.id).map(|id| id.0),
        reference: keyframe.reference,
        active: true,
    });
    nodes.collect()
}

/// The part of every edge that a solve changes, by id; residuals as they are saved if that is
/// good enough.
pub(super) fn edges_of(map: &RouteMap, saved: &[EdgeChange]) -> Vec<EdgeChange> {
    let graph = map.graph();
    let blocks = Blocks::of(graph);
    let mut saved = saved.iter().peekable();
    let edges = graph.edges().iter().enumerate().map(|(position, edge)| {
        while saved.next_if(|saved| saved.id < edge.id).is_some() {}
        let error = graph.error_of(edge);
        let residual = error.map_or(0.0, |error| edge.information.squared_norm(&error));
        let before = saved.next_if(|saved| saved.id == edge.id);
        let before = before.map(|saved| saved.residual);
        let is_still = |b: &f64| (b - residual).abs() < RESIDUAL_STILL * (1.0 + residual);
        EdgeChange {
            id: edge.id,
            status: edge.status,
            residual: before.filter(is_still).unwrap_or(residual),
            subgraph_id: blocks.subgraph_of_edge(position).map(|id| id.0),
        }
    });
    edges.collect()
}

/// How many of what is there now was there before: new ids are larger than all before them.
pub(super) fn count_known<T, I: Ord>(saved: &[T], now: &[T], id: impl Fn(&T) -> I) -> usize {
    match saved.last() {
        Some(last) => now.partition_point(|item| id(item) <= id(last)),
        None => 0,
    }
}

/// Nodes that were saved otherwise, and those that have left the map.
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

/// Edges that were saved otherwise. Those that have left the map stay as they are.
pub(super) fn changed_edges(saved: &[EdgeChange], now: &[EdgeChange]) -> Vec<EdgeChange> {
    let mut now = now.iter().peekable();
    let change = |saved: &EdgeChange| {
        let now = now.next_if(|now| now.id == saved.id)?;
        (now != saved).then_some(*now)
    };
    saved.iter().filter_map(change).collect()
}
