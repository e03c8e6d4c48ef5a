//! What a job added to the map, by the batch that brought it.

use std::collections::BTreeMap;

use crate::ids::{EdgeId, NodeId};
use crate::mapping::{Closure, Drive, Extension, RouteMap};
use crate::store::{BatchOutcome, ClosureRecord};

/// What a job added to the map.
#[derive(Default)]
pub(super) struct Added {
    pub nodes: BTreeMap<NodeId, AddedNode>,
    pub edges: BTreeMap<EdgeId, AddedEdge>,
    /// Scans between keyframes: the keyframe, and the scan's index among those attached to it.
    pub intermediate: Vec<(NodeId, usize)>,
}

impl Added {
    /// Whether the map was not extended.
    pub fn is_empty(&self) -> bool {
        self.nodes.is_empty() && self.edges.is_empty() && self.intermediate.is_empty()
    }
}

/// A new node.
pub(super) struct AddedNode {
    /// Index of its batch among the job's.
    pub origin: usize,
    /// The vehicle's name for it.
    pub client_id: Option<String>,
}

/// A new edge.
#[derive(Clone, Copy)]
pub(super) struct AddedEdge {
    /// Index of its batch among the job's.
    pub origin: usize,
    /// By how much a closure raised F.
    pub delta_f: Option<f64>,
    /// For closures between scans.
    pub closure: Option<ClosureRecord>,
}

/// What an extension added, by the batch that brought it: a node comes with its scan, an edge with its
/// newer node. `drives` are those of the job's batches.
pub(super) fn added_by(drives: &[Drive], extension: &Extension, map: &RouteMap) -> Added {
    let nodes = extension.nodes.iter().map(|node| {
        let node_added = AddedNode {
            origin: batch_of(drives, map, *node),
            client_id: None,
        };
        (*node, node_added)
    });
    let edges = extension.edges.iter().filter_map(|id| {
        let edge_added = AddedEdge {
            origin: batch_of(drives, map, map.graph().edge(*id)?.to),
            delta_f: None,
            closure: None,
        };
        Some((*id, edge_added))
    });
    let mut added = Added {
        nodes: nodes.collect(),
        edges: edges.collect(),
        intermediate: extension.intermediate.clone(),
    };
    for closure in &extension.closures {
        if let Some(edge) = added.edges.get_mut(&closure.edge) {
            *edge = added_closure(closure, edge.origin);
        }
    }
    added
}

/// A closure between scans, as an edge that the batch at `origin` added.
pub(super) fn added_closure(closure: &Closure, origin: usize) -> AddedEdge {
    AddedEdge {
        origin,
        delta_f: Some(closure.delta_f),
        closure: Some(closure_record(closure)),
    }
}

/// The index of the batch that brought a new node's scan.
fn batch_of(drives: &[Drive], map: &RouteMap, node: NodeId) -> usize {
    let position = map.graph().node_position(node).unwrap_or_default();
    let stamp = map.keyframes()[position].stamp;
    let holds = |drive: &Drive| {
        let scans = &drive.scans;
        scans.first().is_some_and(|first| first.stamp <= stamp)
            && scans.last().is_some_and(|last| stamp <= last.stamp)
    };
    drives.iter().position(holds).unwrap_or(drives.len() - 1)
}

/// Counts the nodes and closures that each batch added.
pub(super) fn count_added(outcomes: &mut [BatchOutcome], added: &Added) {
    for node in added.nodes.values() {
        outcomes[node.origin].nodes_added += 1;
    }
    for edge in added.edges.values().filter(|edge| edge.delta_f.is_some()) {
        outcomes[edge.origin].loop_closures += 1;
    }
}

/// What the store keeps of a match of two scans.
fn closure_record(closure: &Closure) -> ClosureRecord {
    ClosureRecord {
        all_points_measurement: closure.all_points_measurement,
        all_points_information: closure.all_points_information,
        overlap: closure.robust.overlap,
        inlier_share: closure.robust.inlier_share,
        rmse_m: closure.robust.rmse_m,
        all_points_residual: closure.all_points_residual,
    }
}
