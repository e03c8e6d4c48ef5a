//! Accepting an alert's change into a map, and undoing it: pure computation, no waiting.

use anyhow::Context;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::result::changes_of;
use super::workspace::Workspace;
use crate::change::{AcceptedChange, AlertStatus, Finding, PendingChange};
use crate::geometry::Pose2;
use crate::graph::{EdgeKind, EdgeStatus};
use crate::ids::{AlertId, EdgeId, NodeId};
use crate::mapping::RouteMap;
use crate::render::{
    Decided, MAP_RESOLUTION_M, MapPicture, OccupancyGrid, PosedScan, untied_trips,
};
use crate::store::{Acceptance, AcceptanceChange, AlertRecord, MapDecision};

/// What an undo restores.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Undo {
    /// The alert's status before it was accepted.
    pub status: AlertStatus,
    /// Edges that were retired; they had been active.
    pub retired: Vec<EdgeId>,
    /// Nodes that became references or stopped being ones, with the flag they had.
    pub references: Vec<(NodeId, bool)>,
    /// Nodes that moved, with the pose they had: `map_from_base` as x, y, θ.
    pub poses: Vec<(NodeId, [f64; 3])>,
    /// Fingerprint of the map right after the acceptance.
    after: [u8; 32],
}

impl Undo {
    /// The nodes and edges that the undo restores.
    pub(super) fn named(&self) -> (Vec<NodeId>, Vec<EdgeId>) {
        let nodes = self.references.iter().map(|(node, _)| *node);
        (nodes.collect(), self.retired.clone())
    }
}

/// Accepts the changes of several alerts one after the other, as one next version of the map.
///
/// # Errors
/// If the picture of the present version cannot be drawn.
pub(super) fn accept(
    workspace: &mut Workspace,
    alerts: &[AlertRecord],
) -> anyhow::Result<MapDecision> {
    let superseded = picture_of(workspace)?;
    let before: Vec<Pose2> = poses_of(&workspace.map).collect();
    let mut acceptances = Vec::with_capacity(alerts.len());
    for alert in alerts {
        let (change, undo) = accept_change(workspace, alert);
        let undo = postcard::to_stdvec(&undo).context("what an undo restores cannot be written")?;
        acceptances.push(Acceptance { change, undo });
    }
    workspace.map_version += 1;
    let max_displacement_m = max_displacement_m(&workspace.map, &before);
    let (changed_nodes, changed_edges) = changes_of(workspace);
    Ok(MapDecision {
        accepted: AcceptanceChange::Added(acceptances),
        changed_nodes,
        changed_edges,
        superseded,
        max_displacement_m,
    })
}

/// Accepts the change of an alert into the map.
///
/// Its closures are retired, its nodes that show the new state become references in place of those that
/// show the old one, and the sub-graphs touched are re-optimised.
pub(super) fn accept_change(
    workspace: &mut Workspace,
    alert: &AlertRecord,
) -> (AcceptedChange, Undo) {
    let evidence = &alert.evidence;
    let retired = contradicting(&workspace.map, evidence);
    let (old, new) = nodes_by_state(&workspace.map, evidence);
    let before: Vec<Pose2> = poses_of(&workspace.map).collect();
    let statuses: Vec<_> = retired.iter().map(|e| (*e, EdgeStatus::Retired)).collect();
    workspace.map.restate_edges(&statuses);
    let references = workspace.map.hand_over_reference(&old, &new);
    let undo = Undo {
        status: alert.status,
        retired,
        references,
        poses: moved_from(&workspace.map, &before),
        after: fingerprint(&workspace.map),
    };
    let change = AcceptedChange {
        alert_id: alert.id,
        region: evidence.whole_region(),
        since: evidence.since,
        map_version: workspace.map_version + 1,
        nodes: evidence.nodes.clone(),
        first_edge_id: workspace.map.next_edge_id(),
    };
    workspace.accepted.push(change.clone());
    (change, undo)
}

/// Reads what an accepted change stored for its undo.
///
/// # Errors
/// If it cannot be read.
pub(super) fn read_undo(bytes: &[u8]) -> anyhow::Result<Undo> {
    postcard::from_bytes(bytes).context("what an undo restores cannot be read")
}

/// Undoes an accepted change, as the next version of the map.
///
/// # Errors
/// If the picture of the present version cannot be drawn.
pub(super) fn undo(
    workspace: &mut Workspace,
    alert: AlertId,
    undo: &Undo,
) -> anyhow::Result<MapDecision> {
    let superseded = picture_of(workspace)?;
    let before: Vec<Pose2> = poses_of(&workspace.map).collect();
    undo_change(workspace, alert, undo);
    workspace.map_version += 1;
    let max_displacement_m = max_displacement_m(&workspace.map, &before);
    let (changed_nodes, changed_edges) = changes_of(workspace);
    Ok(MapDecision {
        accepted: AcceptanceChange::Removed,
        changed_nodes,
        changed_edges,
        superseded,
        max_displacement_m,
    })
}

/// Undoes an accepted change.
///
/// If nothing has changed the map since, every pose is restored to the bit; else edges and references are
/// restored, and the sub-graphs touched are re-optimised.
pub(super) fn undo_change(workspace: &mut Workspace, alert: AlertId, undo: &Undo) {
    let map = &mut workspace.map;
    let untouched = fingerprint(map) == undo.after;
    for (node, reference) in &undo.references {
        map.set_reference(*node, *reference);
    }
    if untouched {
        for edge in &undo.retired {
            map.set_edge_status(*edge, EdgeStatus::Active);
        }
        for (node, [x, y, theta]) in &undo.poses {
            let (x, y, theta) = (*x, *y, *theta);
            map.set_pose(*node, Pose2 { x, y, theta });
        }
    } else {
        let retired = undo.retired.iter();
        let statuses: Vec<_> = retired.map(|e| (*e, EdgeStatus::Active)).collect();
        map.restate_edges(&statuses);
    }
    workspace.accepted.retain(|change| change.alert_id != alert);
}

/// The largest distance of a node from its earlier pose, metres. `before` is in the order of the graph.
pub(super) fn max_displacement_m(map: &RouteMap, before: &[Pose2]) -> f64 {
    let poses = poses_of(map).zip(before);
    let displaced = poses.map(|(now, before)| (now.x - before.x).hypot(now.y - before.y));
    displaced.fold(0.0, f64::max)
}

/// The map's picture as it stands.
pub(super) fn picture_of(workspace: &Workspace) -> anyhow::Result<MapPicture> {
    MapPicture::of_grid(&grid_of(workspace)).context("the map's picture cannot be drawn")
}

/// The map as an occupancy grid, without changes that are not accepted.
pub(super) fn grid_of(workspace: &Workspace) -> OccupancyGrid {
    let poses = poses_of(&workspace.map).zip(&workspace.saved_nodes);
    let keyframes = poses.zip(workspace.map.keyframes());
    let active = keyframes.filter(|((_, saved), keyframe)| saved.active && !keyframe.is_lost());
    let active: Vec<_> = active
        .map(|((pose, _), keyframe)| (pose, keyframe))
        .collect();
    let drifts_m = active.iter().map(|(_, k)| (&k.trip, k.drift_m));
    let untied = untied_trips(drifts_m);
    let posed_scans = active.iter().flat_map(|(pose, keyframe)| {
        let untied = untied.get(&keyframe.trip).copied();
        keyframe.taken_scans(*pose).map(move |taken| PosedScan {
            stamp: taken.stamp,
            map_from_base: taken.map_from_base,
            scan: taken.scan,
            untied,
        })
    });
    let alerts = workspace.alerts.iter();
    let pending = alerts.filter_map(|alert| PendingChange::of(alert.status, &alert.evidence));
    let pending: Vec<PendingChange> = pending.collect();
    let decided = Decided {
        accepted: &workspace.accepted,
        pending: &pending,
    };
    OccupancyGrid::from_posed_scans(posed_scans, decided, MAP_RESOLUTION_M)
}

/// The pose of every node, in the order of the graph.
pub(super) fn poses_of(map: &RouteMap) -> impl Iterator<Item = Pose2> + '_ {
    map.graph().nodes().iter().map(|node| node.pose)
}

/// The active closures among the alert's edges.
fn contradicting(map: &RouteMap, evidence: &Finding) -> Vec<EdgeId> {
    let edges = evidence.edges.iter().filter_map(|id| map.graph().edge(*id));
    let closures = edges
        .filter(|edge| edge.kind == EdgeKind::LoopClosure && edge.status == EdgeStatus::Active);
    closures.map(|edge| edge.id).collect()
}

/// The alert's nodes: those that show the old state, and those that show the new one.
fn nodes_by_state(map: &RouteMap, evidence: &Finding) -> (Vec<NodeId>, Vec<NodeId>) {
    let known = evidence.nodes.iter().filter_map(|node| {
        let position = map.graph().node_position(*node)?;
        Some((*node, map.keyframes()[position].stamp))
    });
    let (old, new): (Vec<_>, Vec<_>) = known.partition(|(_, stamp)| *stamp < evidence.since);
    let ids = |nodes: Vec<(NodeId, _)>| nodes.into_iter().map(|(node, _)| node).collect();
    (ids(old), ids(new))
}

fn moved_from(map: &RouteMap, before: &[Pose2]) -> Vec<(NodeId, [f64; 3])> {
    let nodes = map.graph().nodes().iter().zip(before);
    nodes
        .filter(|(node, before)| node.pose != **before)
        .map(|(node, before)| (node.id, [before.x, before.y, before.theta]))
        .collect()
}

/// A hash that distinguishes two states of a map: poses to the bit, references, edges and their status.
fn fingerprint(map: &RouteMap) -> [u8; 32] {
    let mut hash = Sha256::new();
    for (node, keyframe) in map.graph().nodes().iter().zip(map.keyframes()) {
        hash.update(node.id.0.to_le_bytes());
        for value in [node.pose.x, node.pose.y, node.pose.theta] {
            // SQLite does not keep the sign of a zero.
            hash.update((value + 0.0).to_le_bytes());
        }
        hash.update([u8::from(keyframe.reference)]);
    }
    for edge in map.graph().edges() {
        hash.update(edge.id.0.to_le_bytes());
        hash.update([edge.status as u8]);
    }
    hash.finalize().into()
}
