//! The result of a job in the form in which the store saves it.

use anyhow::Context;

use super::added::{Added, AddedEdge, AddedNode};
use super::saved::{changed_edges, changed_nodes, count_known, edges_of, nodes_of};
use super::workspace::Workspace;
use crate::change::series::ClosureSample;
use crate::graph::{Edge, PoseGraph};
use crate::ids::{BatchId, NodeId, TripId, VehicleId};
use crate::mapping::RouteMap;
use crate::model::BatchStatus;
use crate::scan::encode_scan;
use crate::store::{
    BatchOutcome, BatchRecord, ClaimedJob, EdgeChange, EdgeRecord, IntermediateRecord, JobResult,
    NewIntermediate, NodeChange, NodeRecord, NodeWithScan,
};

/// A batch of a job.
#[derive(Clone)]
pub(super) struct Origin {
    pub batch_id: BatchId,
    pub vehicle_id: VehicleId,
    pub trip_id: TripId,
}

impl Origin {
    pub fn of(batch: &BatchRecord) -> Self {
        Self {
            batch_id: batch.id.clone(),
            vehicle_id: batch.vehicle_id.clone(),
            trip_id: batch.trip_id.clone(),
        }
    }
}

/// The outcome of a batch that added nothing.
pub(super) fn outcome_of(origin: &Origin, status: BatchStatus) -> BatchOutcome {
    BatchOutcome {
        batch_id: origin.batch_id.clone(),
        status,
        reason: None,
        flags: Vec::new(),
        nodes_added: 0,
        loop_closures: 0,
    }
}

/// The outcomes of batches that stay out of the map for one reason.
pub(super) fn kept_out(origins: &[Origin], status: BatchStatus, reason: &str) -> Vec<BatchOutcome> {
    let outcomes = origins.iter().map(|origin| BatchOutcome {
        reason: Some(reason.to_owned()),
        ..outcome_of(origin, status)
    });
    outcomes.collect()
}

/// Remembers the vehicles of a job's trips.
pub(super) fn name_vehicles(workspace: &mut Workspace, origins: &[Origin]) {
    for origin in origins {
        let (trip, vehicle) = (origin.trip_id.clone(), origin.vehicle_id.clone());
        workspace.vehicles.insert(trip, vehicle);
    }
}

/// The result of what was added, without outcomes. Updates the workspace's record of what is saved.
///
/// # Errors
/// If a scan cannot be encoded, or a new node or edge belongs to no batch.
pub(super) fn of_added(
    workspace: &mut Workspace,
    job: &ClaimedJob,
    origins: &[Origin],
    added: &Added,
) -> anyhow::Result<JobResult> {
    name_vehicles(workspace, origins);
    let nodes_now = nodes_of(&workspace.map);
    let edges_now = edges_of(&workspace.map);
    let old_nodes = count_known(&workspace.saved_nodes, &nodes_now, |node| node.id);
    let old_edges = count_known(&workspace.saved_edges, &edges_now, |edge| edge.id);
    let new_nodes = nodes_now[old_nodes..].iter().enumerate();
    let new_nodes = new_nodes.map(|(k, state)| {
        let new = added.nodes.get(&state.id);
        let new = new.with_context(|| format!("node {} belongs to no batch", state.id))?;
        node_record(
            &workspace.map,
            &origins[new.origin],
            new,
            old_nodes + k,
            state,
        )
    });
    let new_edges = edges_now[old_edges..].iter().enumerate();
    let new_edges = new_edges.map(|(k, state)| {
        let new = added.edges.get(&state.id);
        let new = new.with_context(|| format!("edge {} belongs to no batch", state.id))?;
        let graph = workspace.map.graph();
        let edge = &graph.edges()[old_edges + k];
        anyhow::Ok(edge_record(graph, edge, &origins[new.origin], new, state))
    });
    let new_scans = added.intermediate.iter();
    let new_scans = new_scans.map(|added| intermediate_record(&workspace.map, *added));
    let result = JobResult {
        job_id: job.job_id,
        generation: job.generation,
        route_id: job.route_id.clone(),
        base_revision: workspace.revision,
        outcomes: Vec::new(),
        nodes: new_nodes.collect::<Result<_, _>>()?,
        intermediate: new_scans.collect::<Result<_, _>>()?,
        edges: new_edges.collect::<Result<_, _>>()?,
        changed_nodes: changed_nodes(&workspace.saved_nodes, &nodes_now),
        changed_edges: changed_edges(&workspace.saved_edges, &edges_now),
        alerts: Vec::new(),
        calibrations: Vec::new(),
        clock_faults: Vec::new(),
        trip_start: None,
        stage: workspace.stage,
        input: job.input(),
        processed_at: job.at,
    };
    let closures = added.edges.iter().filter_map(|(edge, new)| {
        Some(ClosureSample {
            edge_id: *edge,
            delta_f: new.delta_f?,
        })
    });
    workspace.closures.extend(closures);
    let external = added.edges.iter();
    let external = external.filter(|(_, new)| new.delta_f.is_some() && new.closure.is_none());
    workspace.external.extend(external.map(|(edge, _)| *edge));
    workspace.saved_nodes = nodes_now;
    workspace.saved_edges = edges_now;
    Ok(result)
}

/// The nodes and edges that have changed since the workspace was last saved; none may be new. Updates the
/// workspace's record of what is saved.
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
    origin: &Origin,
    new: &AddedNode,
    position: usize,
    state: &NodeChange,
) -> anyhow::Result<NodeWithScan> {
    let keyframe = &map.keyframes()[position];
    let node = NodeRecord {
        id: keyframe.node,
        batch_id: origin.batch_id.clone(),
        vehicle_id: origin.vehicle_id.clone(),
        trip_id: keyframe.trip.clone(),
        stamp: keyframe.stamp,
        pose: state.pose,
        sigma: state.sigma,
        odom_from_base: keyframe.odom_from_base,
        drift_m: keyframe.drift_m,
        reference: state.reference,
        active: state.active,
        subgraph_id: state.subgraph_id,
        trip_order: keyframe.trip_order,
        client_id: new.client_id.clone(),
    };
    let scan = keyframe.scan.as_ref().map(encode_scan).transpose()?;
    Ok(NodeWithScan {
        node,
        scan,
        lidar: keyframe.lidar.clone(),
        intermediate: Vec::new(),
    })
}

fn intermediate_record(
    map: &RouteMap,
    (node_id, place): (NodeId, usize),
) -> anyhow::Result<NewIntermediate> {
    let keyframe = map.keyframe(node_id);
    let scan = keyframe.and_then(|keyframe| keyframe.intermediate.get(place));
    let scan = scan.with_context(|| format!("node {node_id} has no intermediate scan {place}"))?;
    Ok(NewIntermediate {
        node_id,
        place: u32::try_from(place)?,
        scan: IntermediateRecord {
            stamp: scan.stamp,
            keyframe_from_base: scan.keyframe_from_base,
            odom_from_base: scan.odom_from_base,
            companion: scan.companion_lidar().cloned(),
            lends: scan.lent().is_some(),
            scan: scan.scan.as_ref().map(encode_scan).transpose()?,
        },
    })
}

fn edge_record(
    graph: &PoseGraph,
    edge: &Edge,
    origin: &Origin,
    new: &AddedEdge,
    state: &EdgeChange,
) -> EdgeRecord {
    let error = graph.error_of(edge);
    EdgeRecord {
        id: edge.id,
        from: edge.from,
        to: edge.to,
        kind: edge.kind,
        status: edge.status,
        batch_id: origin.batch_id.clone(),
        measurement: edge.measurement,
        information: edge.information,
        residual: error.map_or(0.0, |error| edge.information.squared_norm(&error)),
        subgraph_id: state.subgraph_id,
        delta_f: new.delta_f,
        closure: new.closure,
    }
}
