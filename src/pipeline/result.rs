//! What a job changed, as the store takes it.

use std::collections::BTreeMap;

use jiff::Timestamp;

use super::saved::{changed_edges, changed_nodes, count_known, edges_of, nodes_of};
use super::workspace::Workspace;
use crate::change::series::ClosureSample;
use crate::graph::Edge;
use crate::ids::{BatchId, EdgeId, NodeId, VehicleId};
use crate::mapping::{Closure, Drive, Extension, RouteMap};
use crate::scan::encode_scan;
use crate::store::{
    ClaimedJob, ClosureRecord, EdgeChange, EdgeRecord, JobResult, NodeChange, NodeRecord,
    NodeWithScan,
};

/// A batch that takes part in a job.
pub(super) struct Origin {
    pub batch_id: BatchId,
    pub vehicle_id: VehicleId,
    pub drive: Drive,
}

/// The batch that a new node's scan came with, as a place in `origins`.
pub(super) fn origin_of(origins: &[Origin], map: &RouteMap, node: NodeId) -> usize {
    let position = map.graph().node_position(node).unwrap_or_default();
    let stamp = map.keyframes()[position].stamp;
    let holds = |origin: &Origin| {
        let scans = &origin.drive.scans;
        scans.first().is_some_and(|first| first.stamp <= stamp)
            && scans.last().is_some_and(|last| stamp <= last.stamp)
    };
    origins.iter().position(holds).unwrap_or(origins.len() - 1)
}

/// The result of an extension without its outcomes; the workspace's record of what is saved is
/// brought up to date.
///
/// # Errors
/// If a scan cannot be encoded.
pub(super) fn of_extension(
    workspace: &mut Workspace,
    job: &ClaimedJob,
    origins: &[Origin],
    extension: &Extension,
) -> anyhow::Result<JobResult> {
    for origin in origins {
        let (trip, vehicle) = (origin.drive.trip.clone(), origin.vehicle_id.clone());
        workspace.vehicles.insert(trip, vehicle);
    }
    let nodes_now = nodes_of(&workspace.map);
    let edges_now = edges_of(&workspace.map);
    let old_nodes = count_known(&workspace.saved_nodes, &nodes_now, |node| node.id);
    let old_edges = count_known(&workspace.saved_edges, &edges_now, |edge| edge.id);
    let closures: BTreeMap<EdgeId, &Closure> =
        extension.closures.iter().map(|c| (c.edge, c)).collect();
    let new_nodes = nodes_now[old_nodes..]
        .iter()
        .enumerate()
        .map(|(k, state)| node_record(&workspace.map, origins, old_nodes + k, state));
    let new_edges = edges_now[old_edges..].iter().enumerate().map(|(k, state)| {
        let edge = &workspace.map.graph().edges()[old_edges + k];
        edge_record(
            &workspace.map,
            origins,
            edge,
            state,
            closures.get(&edge.id).copied(),
        )
    });
    let result = JobResult {
        job_id: job.job_id,
        generation: job.generation,
        route_id: job.route_id.clone(),
        base_revision: workspace.revision,
        outcomes: Vec::new(),
        nodes: new_nodes.collect::<Result<_, _>>()?,
        edges: new_edges.collect(),
        changed_nodes: changed_nodes(&workspace.saved_nodes, &nodes_now),
        changed_edges: changed_edges(&workspace.saved_edges, &edges_now),
        alerts: Vec::new(),
        stage: workspace.stage,
        processed_at: Timestamp::now(),
    };
    workspace
        .closures
        .extend(extension.closures.iter().map(|c| ClosureSample {
            edge_id: c.edge,
            delta_f: c.delta_f,
        }));
    workspace.saved_nodes = nodes_now;
    workspace.saved_edges = edges_now;
    Ok(result)
}

/// What has changed since the workspace was last saved, no node or edge being new; its record of
/// what is saved is brought up to date.
pub(super) fn changes_of(workspace: &mut Workspace) -> (Vec<NodeChange>, Vec<EdgeChange>) {
    let nodes_now = nodes_of(&workspace.map);
    let edges_now = edges_of(&workspace.map);
    let changed_nodes = changed_nodes(&workspace.saved_nodes, &nodes_now);
    let changed_edges = changed_edges(&workspace.saved_edges, &edges_now);
    workspace.saved_nodes = nodes_now;
    workspace.saved_edges = edges_now;
    (changed_nodes, changed_edges)
}

fn node_record(
    map: &RouteMap,
    origins: &[Origin],
    position: usize,
    state: &NodeChange,
) -> anyhow::Result<NodeWithScan> {
    let keyframe = &map.keyframes()[position];
    let origin = &origins[origin_of(origins, map, keyframe.node)];
    let node = NodeRecord {
        id: keyframe.node,
        batch_id: origin.batch_id.clone(),
        vehicle_id: origin.vehicle_id.clone(),
        trip_id: keyframe.trip.clone(),
        stamp: keyframe.stamp,
        pose: state.pose,
        odom_from_base: keyframe.odom_from_base,
        drift_m: keyframe.drift_m,
        reference: state.reference,
        active: state.active,
        subgraph_id: state.subgraph_id,
        trip_order: keyframe.trip_order,
    };
    let scan = encode_scan(&keyframe.scan)?;
    Ok(NodeWithScan { node, scan })
}

fn edge_record(
    map: &RouteMap,
    origins: &[Origin],
    edge: &Edge,
    state: &EdgeChange,
    closure: Option<&Closure>,
) -> EdgeRecord {
    EdgeRecord {
        id: edge.id,
        from: edge.from,
        to: edge.to,
        kind: edge.kind,
        status: edge.status,
        batch_id: origins[origin_of(origins, map, edge.to)].batch_id.clone(),
        measurement: edge.measurement,
        information: edge.information,
        residual: state.residual,
        subgraph_id: state.subgraph_id,
        closure: closure.map(closure_record),
    }
}

fn closure_record(closure: &Closure) -> ClosureRecord {
    ClosureRecord {
        all_points_measurement: closure.all_points_measurement,
        all_points_information: closure.all_points_information,
        overlap: closure.robust.overlap,
        inlier_share: closure.robust.inlier_share,
        rmse_m: closure.robust.rmse_m,
        delta_f: closure.delta_f,
        all_points_residual: closure.all_points_residual,
    }
}
