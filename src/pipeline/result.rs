//! What a job changed, as the store takes it.

use std::collections::BTreeMap;

use anyhow::Context;

use super::saved::{changed_edges, changed_nodes, count_known, edges_of, nodes_of};
use super::workspace::Workspace;
use crate::change::series::ClosureSample;
use crate::graph::{Edge, PoseGraph};
use crate::ids::{BatchId, EdgeId, NodeId, TripId, VehicleId};
use crate::mapping::{Closure, RouteMap};
use crate::model::BatchStatus;
use crate::scan::encode_scan;
use crate::store::{
    BatchOutcome, BatchRecord, ClaimedJob, ClosureRecord, EdgeChange, EdgeRecord,
    IntermediateRecord, JobResult, NewIntermediate, NodeChange, NodeRecord, NodeWithScan,
};

/// A batch that takes part in a job.
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

/// What a job added to the map, each with the place of its batch in `origins`.
#[derive(Default)]
pub(super) struct Added {
    pub nodes: BTreeMap<NodeId, AddedNode>,
    pub edges: BTreeMap<EdgeId, AddedEdge>,
    /// Scans between keyframes: the keyframe, and the place among its own.
    pub intermediate: Vec<(NodeId, usize)>,
}

impl Added {
    /// Whether the map is as it was.
    pub fn is_nothing(&self) -> bool {
        self.nodes.is_empty() && self.edges.is_empty() && self.intermediate.is_empty()
    }
}

/// A new node.
pub(super) struct AddedNode {
    pub origin: usize,
    /// What the vehicle calls it.
    pub client_id: Option<String>,
}

/// A new edge.
#[derive(Clone, Copy)]
pub(super) struct AddedEdge {
    pub origin: usize,
    /// What a closure added to F.
    pub delta_f: Option<f64>,
    /// For closures between scans.
    pub closure: Option<ClosureRecord>,
}

/// A batch's end, with nothing added.
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

/// The end of batches that all stay out of the map for one reason.
pub(super) fn kept_out(origins: &[Origin], status: BatchStatus, reason: &str) -> Vec<BatchOutcome> {
    let outcomes = origins.iter().map(|origin| BatchOutcome {
        reason: Some(reason.to_owned()),
        ..outcome_of(origin, status)
    });
    outcomes.collect()
}

/// Notes whose the trips of a job are.
pub(super) fn name_vehicles(workspace: &mut Workspace, origins: &[Origin]) {
    for origin in origins {
        let (trip, vehicle) = (origin.trip_id.clone(), origin.vehicle_id.clone());
        workspace.vehicles.insert(trip, vehicle);
    }
}

/// The result of what was added, without its outcomes; the workspace's record of what is saved is
/// brought up to date.
///
/// # Errors
/// If a scan cannot be encoded, or something new has no batch.
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
        let new = new.with_context(|| format!("node {} is of no batch", state.id))?;
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
        let new = new.with_context(|| format!("edge {} is of no batch", state.id))?;
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
    let given = added.edges.iter();
    let given = given.filter(|(_, new)| new.delta_f.is_some() && new.closure.is_none());
    workspace.given.extend(given.map(|(edge, _)| *edge));
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
    let scan = scan.with_context(|| format!("scan {place} behind node {node_id} is not there"))?;
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

/// What the store keeps of two matched scans.
pub(super) fn closure_record(closure: &Closure) -> ClosureRecord {
    ClosureRecord {
        all_points_measurement: closure.all_points_measurement,
        all_points_information: closure.all_points_information,
        overlap: closure.robust.overlap,
        inlier_share: closure.robust.inlier_share,
        rmse_m: closure.robust.rmse_m,
        all_points_residual: closure.all_points_residual,
    }
}
