//! A route's map in memory, as it was last saved.

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};

use anyhow::{Context, anyhow};

use crate::change::series::ClosureSample;
use crate::graph::Edge;
use crate::ids::{EdgeId, RouteId, TripId, VehicleId};
use crate::mapping::{Keyframe, RouteMap, Weighting};
use crate::scan::decode_scan;
use crate::store::{
    AcceptedChange, AlertRecord, Detector, EdgeChange, EdgeRecord, NodeChange, NodeWithScan,
    RouteGraph, Stage, Store,
};

/// Most maps that are kept in memory between batches.
const KEPT_MAX: usize = 16;

/// A route's map with what the store has of it.
pub(super) struct Workspace {
    /// The store's revision that the map stands on.
    pub revision: i64,
    pub stage: Stage,
    /// What the map's weighting follows.
    pub detector: Detector,
    pub map: RouteMap,
    /// What the store has of each node, in the order of the graph.
    pub saved_nodes: Vec<NodeChange>,
    /// What the store has of each edge, in the order of the graph.
    pub saved_edges: Vec<EdgeChange>,
    /// ΔF of every closure, in the order of insertion.
    pub closures: Vec<ClosureSample>,
    /// Whose each trip is.
    pub vehicles: BTreeMap<TripId, VehicleId>,
    pub map_version: i64,
    /// Every alert of the route, the oldest first.
    pub alerts: Vec<AlertRecord>,
    /// What the map has taken in, in the order of acceptance: in these regions looks from before
    /// the change say nothing.
    pub accepted: Vec<AcceptedChange>,
}

impl Workspace {
    /// The map after its changes were committed.
    pub fn saved(mut self) -> Self {
        self.revision += 1;
        self
    }

    /// Puts the next revision of an alert in the place of the one before.
    pub fn replace_alert(&mut self, alert: &AlertRecord) {
        if let Some(old) = self.alerts.iter_mut().find(|old| old.id == alert.id) {
            *old = alert.clone();
        }
    }

    fn restore(graph: RouteGraph) -> anyhow::Result<Self> {
        let weighting = match graph.settings.detector {
            Detector::Fused => Weighting::Robust,
            Detector::Seed => Weighting::AllPointsIdentity,
        };
        let nodes: Vec<_> = graph
            .nodes
            .iter()
            .map(keyframe_of)
            .collect::<Result<_, _>>()?;
        let poses = graph.nodes.iter().map(|n| n.node.pose);
        let map = RouteMap::restore(
            weighting,
            poses.zip(nodes),
            graph.edges.iter().map(edge_of),
            graph.next_node_id,
            graph.next_edge_id,
        )
        .context("the stored graph does not fit together")?;
        let closures = graph.edges.iter().filter_map(|edge| {
            Some(ClosureSample {
                edge_id: edge.id,
                delta_f: edge.closure?.delta_f,
            })
        });
        Ok(Self {
            revision: graph.revision,
            stage: graph.stage,
            detector: graph.settings.detector,
            map,
            saved_nodes: graph.nodes.iter().map(node_change_of).collect(),
            saved_edges: graph.edges.iter().map(edge_change_of).collect(),
            closures: closures.collect(),
            vehicles: graph.nodes.iter().map(driver_of).collect(),
            map_version: graph.map_version,
            alerts: graph.alerts,
            accepted: graph.accepted,
        })
    }

    /// The closures of each block that its residual series counts, in the order of insertion.
    pub fn closures_by_subgraph(&self) -> BTreeMap<i64, Vec<ClosureSample>> {
        let subgraph_of: BTreeMap<EdgeId, i64> = self
            .saved_edges
            .iter()
            .filter_map(|edge| Some((edge.id, edge.subgraph_id?)))
            .collect();
        let mut closures: BTreeMap<i64, Vec<ClosureSample>> = BTreeMap::new();
        for closure in &self.closures {
            if let Some(&subgraph) = subgraph_of.get(&closure.edge_id)
                && self.is_in_baseline(closure.edge_id)
            {
                closures.entry(subgraph).or_default().push(*closure);
            }
        }
        closures
    }

    fn is_in_baseline(&self, edge: EdgeId) -> bool {
        let Some(edge) = self.map.graph().edge(edge) else {
            return false;
        };
        let has_left = |a: &AcceptedChange| a.leaves_baseline(edge.id, edge.from, edge.to);
        !self.accepted.iter().any(has_left)
    }
}

fn keyframe_of(record: &NodeWithScan) -> anyhow::Result<Keyframe> {
    let node = &record.node;
    let scan = decode_scan(&record.scan)
        .with_context(|| format!("the scan of node {} cannot be read", node.id))?;
    let (trip, stamp) = (node.trip_id.clone(), node.stamp);
    let mut keyframe = Keyframe::new(node.id, trip, stamp, node.odom_from_base, scan);
    keyframe.reference = node.reference;
    keyframe.drift_m = node.drift_m;
    Ok(keyframe)
}

fn driver_of(record: &NodeWithScan) -> (TripId, VehicleId) {
    let node = &record.node;
    (node.trip_id.clone(), node.vehicle_id.clone())
}

fn edge_of(record: &EdgeRecord) -> Edge {
    Edge {
        id: record.id,
        from: record.from,
        to: record.to,
        measurement: record.measurement,
        information: record.information,
        kind: record.kind,
        status: record.status,
    }
}

fn node_change_of(record: &NodeWithScan) -> NodeChange {
    NodeChange {
        id: record.node.id,
        pose: record.node.pose,
        subgraph_id: record.node.subgraph_id,
        reference: record.node.reference,
        active: record.node.active,
    }
}

fn edge_change_of(record: &EdgeRecord) -> EdgeChange {
    EdgeChange {
        id: record.id,
        status: record.status,
        residual: record.residual,
        subgraph_id: record.subgraph_id,
    }
}

/// The maps between batches. A map is out of here while a worker has it, and never comes back
/// from a failed attempt.
#[derive(Default)]
pub(super) struct Workspaces {
    kept: Mutex<Vec<(RouteId, Workspace)>>,
}

impl Workspaces {
    /// The route's map, from memory if it is up to date, else from the store.
    pub async fn take(&self, store: &Store, route: &RouteId) -> anyhow::Result<Workspace> {
        let record = store.route(route).await?;
        let record = record.ok_or_else(|| anyhow!("the route is gone"))?;
        if let Some(kept) = self.remove(route)
            && kept.revision == record.revision
            && kept.detector == record.settings.detector
        {
            return Ok(kept);
        }
        let graph = store.load_graph(route).await?;
        let graph = graph.ok_or_else(|| anyhow!("the route is gone"))?;
        tokio::task::spawn_blocking(move || Workspace::restore(graph)).await?
    }

    /// Brings a map in memory up to date after a decision that leaves the graph alone.
    pub fn note_decision(&self, base_revision: i64, alert: &AlertRecord) {
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        let of_route = kept.iter_mut().find(|(id, _)| *id == alert.route_id);
        if let Some((_, workspace)) = of_route
            && workspace.revision == base_revision
        {
            workspace.revision += 1;
            workspace.replace_alert(alert);
        }
    }

    /// Keeps a map whose changes are committed; the one longest unused makes room.
    pub fn put_back(&self, route: RouteId, workspace: Workspace) {
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        kept.retain(|(other, _)| *other != route);
        if kept.len() >= KEPT_MAX {
            kept.remove(0);
        }
        kept.push((route, workspace));
    }

    fn remove(&self, route: &RouteId) -> Option<Workspace> {
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        let place = kept.iter().position(|(other, _)| other == route)?;
        Some(kept.remove(place).1)
    }
}
